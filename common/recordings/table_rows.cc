#include "common/recordings/table_rows.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status SendRows(size_t channel, const std::vector<int64_t>& times_ns, bool stamped,
                      const std::vector<JointColumns>& columns, RowStream* rows) {
  std::vector<SignalValue> values;
  for (const JointColumns& group : columns) {
    for (const std::string& joint : group.joints) {
      RS_ASSIGN_OR_RETURN(const size_t signal, rows->Signal(channel, joint, group.quantity));
      values.push_back({signal, 0});
    }
  }
  for (size_t i = 0; i < times_ns.size(); ++i) {
    size_t k = 0;
    for (const JointColumns& group : columns) {
      const size_t width = group.joints.size();
      for (size_t j = 0; j < width; ++j) values[k++].value = group.values[i * width + j];
    }
    JointRow row;
    row.channel = channel;
    row.log_ns = row.stamp_ns = times_ns[i];
    row.stamped = stamped;
    row.values = values;
    RS_RETURN_IF_ERROR(rows->visitor().OnRow(row));
  }
  return absl::OkStatus();
}

std::vector<std::string> NumberedJoints(size_t count) {
  std::vector<std::string> names;
  for (size_t i = 0; i < count; ++i) names.push_back(absl::StrCat("joint_", i));
  return names;
}

std::string UnitOfStep(double step) {
  constexpr double kSlowest = 0.5;  // [s] arms are recorded faster
  if (step < kSlowest) return "";
  if (step < kSlowest * 1e3) return "milliseconds? multiply t by 0.001";
  if (step < kSlowest * 1e6) return "microseconds? multiply t by 1e-6";
  return "nanoseconds? multiply t by 1e-9";
}

std::vector<int64_t> TimesAtRate(size_t rows, double rate_hz) {
  std::vector<int64_t> times;
  for (size_t i = 0; i < rows; ++i)
    times.push_back(std::llround(static_cast<double>(i) * 1e9 / rate_hz));
  return times;
}

}  // namespace robostress
