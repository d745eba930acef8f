#pragma once

#include <memory>
#include <string>

#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"
#include "robot_client/emulator/piper_plant.h"
#include "robot_client/emulator/view_renderer.h"

namespace robostress::piper {

// A camera of an emulated scene in the emulator's own thread, for simulated time: a picture is
// drawn when it is asked for, at most `rate_hz` times per second, of the scene as it stands then.
class RenderedSource : public FrameSource {
 public:
  // `name`: the policy's; `camera`: the scene's (piper_base_view). `plant`, `renderer` (which
  // several sources may share) and `clock` outlive it.
  RenderedSource(std::string name, std::string camera, PiperPlant* plant, ViewRenderer* renderer,
                 const Clock* clock, double rate_hz = 30);

  const std::string& name() const override { return name_; }
  absl::Status Start() override;  // draws the first picture
  std::shared_ptr<const Frame> Latest() override;
  // A camera that is drawn on demand is never older than a period.
  int64_t newest_stamp_ns() const override;
  absl::Status status() const override { return status_; }

 private:
  int64_t Index() const { return (clock_->now_ns() - start_ns_) / period_ns_; }

  const std::string name_, camera_;
  PiperPlant* const plant_;
  ViewRenderer* const renderer_;
  const Clock* const clock_;
  const int64_t period_ns_;
  int64_t start_ns_ = 0;
  std::shared_ptr<const Frame> frame_;
  absl::Status status_;
};

}  // namespace robostress::piper
