#pragma once

#include <atomic>
#include <deque>
#include <memory>
#include <string>

#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

enum class CameraFault { kNone, kDrop, kFreeze, kDelay, kCorrupt, kUnplug, kFuture };

// A camera with a fault that can be switched while it runs, for rehearsing what the client does:
//
//   drop     a share of the pictures never comes (which ones: a function of seed and stamp)
//   freeze   the same picture comes again and again with new stamps and sequence numbers
//   delay    every picture comes later
//   corrupt  a band of every picture is noise
//   unplug   nothing comes any more; status() says so
//   future   every picture is stamped ahead of the clock, as by a source that trusts its driver
class FaultySource : public FrameSource {
 public:
  FaultySource(std::unique_ptr<FrameSource> source, const Clock* clock, uint64_t seed = 0)
      : source_(std::move(source)), clock_(clock), seed_(seed) {}

  // `amount`: drop, share of pictures 0..1; delay and future, seconds 0..1; otherwise unused. From
  // `from_ns` of the clock on. Any thread.
  void Set(CameraFault fault, double amount = 0, int64_t from_ns = 0);

  const std::string& name() const override { return source_->name(); }
  absl::Status Start() override { return source_->Start(); }
  std::shared_ptr<const Frame> Latest() override;
  int64_t newest_stamp_ns() const override;
  absl::Status status() const override;
  uint64_t dropped() const override { return source_->dropped(); }

 private:
  CameraFault fault() const;  // now
  bool Drops(int64_t stamp_ns) const;

  const std::unique_ptr<FrameSource> source_;
  const Clock* const clock_;
  const uint64_t seed_;
  std::atomic<CameraFault> fault_{CameraFault::kNone};
  std::atomic<double> amount_{0};
  std::atomic<int64_t> from_ns_{0};
  mutable std::atomic<int64_t> last_stamp_ns_{0};     // of the last picture let through
  std::shared_ptr<const Frame> last_;                 // of Latest's thread
  std::deque<std::shared_ptr<const Frame>> history_;  // newest last, for delay
};

// "drop", "freeze", ...; INVALID_ARGUMENT lists them.
absl::Status ParseCameraFault(const std::string& text, CameraFault* fault);

}  // namespace robostress
