#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "common/clock.h"
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

// Whether a stamp lies further ahead of the client's clock than a driver's rounding puts it: then
// the clock it was taken from is wrong, and such a picture would count as fresh for ever.
inline constexpr int64_t kMostAhead_ns = 20'000'000;
inline bool FromTheFuture(int64_t stamp_ns, int64_t now_ns) {
  return stamp_ns > now_ns && stamp_ns - now_ns > kMostAhead_ns;
}
// Why a source passes such a picture over; names camera and lead.
absl::Status FutureStampError(const std::string& camera, int64_t stamp_ns, int64_t now_ns);

// A camera as the client sees it: the newest picture, and how old it is. Old pictures are never
// queued. A picture from the future is passed over, so that the camera becomes stale, and status()
// says why.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const std::string& name() const = 0;
  // Begins delivery; an error says what to plug in or correct. Once.
  virtual absl::Status Start() = 0;
  // The newest picture, or null before the first. Does not wait for the next one. Immutable and
  // shared. One thread (the policy link's).
  virtual std::shared_ptr<const Frame> Latest() = 0;
  // Stamp of the picture that Latest would give; 0 before the first. Cheap: it makes no picture,
  // waits for nobody and allocates nothing. Any thread.
  virtual int64_t newest_stamp_ns() const = 0;
  // Why nothing comes, where the source knows.
  virtual absl::Status status() const = 0;
  // Pictures that came damaged and were passed over. Any thread.
  virtual uint64_t dropped() const { return 0; }
};

// What the control loop asks of a client's cameras; they outlive it.
class FrameStamps : public CameraStamps {
 public:
  // With a clock, a camera whose stamp is from the future counts as one that has delivered nothing,
  // whatever its source thinks of it.
  explicit FrameStamps(std::vector<FrameSource*> cameras, const Clock* clock = nullptr)
      : cameras_(std::move(cameras)), clock_(clock) {}
  int64_t Oldest() const override {
    int64_t oldest = std::numeric_limits<int64_t>::max();
    for (const FrameSource* camera : cameras_) {
      const int64_t stamp = camera->newest_stamp_ns();
      const bool ahead = clock_ != nullptr && FromTheFuture(stamp, clock_->now_ns());
      oldest = std::min(oldest, ahead ? 0 : stamp);
    }
    return oldest;
  }

 private:
  const std::vector<FrameSource*> cameras_;
  const Clock* const clock_;
};

}  // namespace robostress
