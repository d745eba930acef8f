#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// The numbers of a data set that LerobotDataset recorded (lerobot_dataset.h). Pictures are not
// read. Errors name file, field, value and remedy.
class LerobotReader {
 public:
  // `directory` holds meta/info.json. Refuses a set of another program, whose actions may mean
  // anything, and one of an arm with other axes.
  static absl::StatusOr<LerobotReader> Open(const std::string& directory, const ArmAxes& axes = {});

  int64_t episodes() const { return episodes_; }
  double rate_hz() const { return rate_hz_; }
  // Absolute targets, joints [rad] and opening [m], tick by tick.
  absl::StatusOr<std::vector<ArmVector>> ReadActions(int64_t episode) const;

 private:
  std::string directory_;
  ArmAxes axes_;
  int64_t episodes_ = 0;
  double rate_hz_ = 0;
};

}  // namespace robostress
