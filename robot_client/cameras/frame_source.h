#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "common/types.h"
#include "robot_client/control/watchdogs.h"

namespace robostress {

// One picture of a camera.
struct Frame {
  Image image;            // RGB
  int64_t stamp_ns = 0;   // when it was exposed or, where the camera does not say, when it arrived;
                          // the client's clock
  uint64_t sequence = 0;  // grows with every new picture; gaps are pictures that were lost
};

// A camera as the client sees it: the newest picture, and how old it is. Old pictures are never
// queued.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const std::string& name() const = 0;
  // Begins delivery; an error says what to plug in or correct. Once.
  virtual absl::Status Start() = 0;
  // The newest picture, or null before the first. Does not wait for the next one. Immutable and
  // shared. One thread (the policy link's).
  virtual std::shared_ptr<const Frame> Latest() = 0;
  // Stamp of the picture that Latest would give; 0 before the first. Cheap: it makes no picture.
  // The same thread as Latest.
  virtual int64_t newest_stamp_ns() const = 0;
  // Why nothing comes, where the source knows.
  virtual absl::Status status() const = 0;
};

// What the control loop asks of a client's cameras; they outlive it.
class FrameStamps : public CameraStamps {
 public:
  explicit FrameStamps(std::vector<FrameSource*> cameras) : cameras_(std::move(cameras)) {}
  int64_t Oldest() const override {
    int64_t oldest = std::numeric_limits<int64_t>::max();
    for (const FrameSource* camera : cameras_) oldest = std::min(oldest, camera->newest_stamp_ns());
    return oldest;
  }

 private:
  const std::vector<FrameSource*> cameras_;
};

}  // namespace robostress
