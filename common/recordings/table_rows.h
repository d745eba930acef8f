#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// Columns of joints, of a table or a dataset's episode, that stand in rows of one channel.
struct JointColumns {
  JointQuantity quantity = JointQuantity::kPosition;
  std::vector<std::string> joints;
  std::vector<double> values;  // [rows * joints], row by row
};

// Sends the rows of an episode; row i was taken at times_ns[i], which are stamps or, where
// `stamped` is false, made up from a rate.
absl::Status SendRows(size_t channel, const std::vector<int64_t>& times_ns, bool stamped,
                      const std::vector<JointColumns>& columns, RowStream* rows);

// "joint_0", "joint_1" ...: for joints without names.
std::vector<std::string> NumberedJoints(size_t count);

// The unit that times may have whose rows are `step` apart, as a question with the factor:
// "milliseconds? multiply t by 0.001". Empty: seconds, rows come at more than 2 Hz.
std::string UnitOfStep(double step);

// i / rate_hz [ns].
std::vector<int64_t> TimesAtRate(size_t rows, double rate_hz);

}  // namespace robostress
