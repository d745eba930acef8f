#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

struct SyntheticSourceOptions {
  std::string name;
  int width = 320, height = 240;  // [px]; at least 64 x 8
  double rate_hz = 30;
  double exposure_age_s = 0.01;  // [s] between a picture's stamp and its arrival
};

// A camera that is not there: a moving pattern whose first rows carry the picture's sequence number
// in blocks of black and white, so that order, latency and loss can be read from what a policy got.
class SyntheticSource : public FrameSource {
 public:
  SyntheticSource(SyntheticSourceOptions options, const Clock* clock);

  const std::string& name() const override { return options_.name; }
  absl::Status Start() override;
  std::shared_ptr<const Frame> Latest() override;
  int64_t newest_stamp_ns() const override;
  absl::Status status() const override { return absl::OkStatus(); }

 private:
  int64_t NewestIndex() const;  // -1 before the first picture

  const SyntheticSourceOptions options_;
  const Clock* const clock_;
  const int64_t period_ns_, age_ns_;
  int64_t start_ns_ = 0;
  std::shared_ptr<const Frame> frame_;
};

// The number in a synthetic picture; DATA_LOSS where a block is neither black nor white.
absl::StatusOr<uint64_t> SequenceIn(const Image& image);

}  // namespace robostress
