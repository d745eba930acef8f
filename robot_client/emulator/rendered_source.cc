#include "robot_client/emulator/rendered_source.h"

#include <utility>

namespace robostress::piper {

RenderedSource::RenderedSource(std::string name, std::string camera, PiperPlant* plant,
                               ViewRenderer* renderer, const Clock* clock, double rate_hz)
    : name_(std::move(name)),
      camera_(std::move(camera)),
      plant_(plant),
      renderer_(renderer),
      clock_(clock),
      period_ns_(static_cast<int64_t>(1e9 / rate_hz)) {}

absl::Status RenderedSource::Start() {
  start_ns_ = clock_->now_ns();
  Latest();
  return status_;
}

int64_t RenderedSource::newest_stamp_ns() const { return start_ns_ + Index() * period_ns_; }

std::shared_ptr<const Frame> RenderedSource::Latest() {
  const auto sequence = static_cast<uint64_t>(Index()) + 1;
  if (frame_ != nullptr && frame_->sequence == sequence) return frame_;
  absl::StatusOr<Image> image = renderer_->Render(plant_->data(), camera_);
  status_ = image.status();
  if (!image.ok()) return frame_;
  auto frame = std::make_shared<Frame>();
  frame->image = *std::move(image);
  frame->stamp_ns = newest_stamp_ns();
  frame->sequence = sequence;
  return frame_ = std::move(frame);
}

}  // namespace robostress::piper
