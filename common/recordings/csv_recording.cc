#include "common/recordings/csv_recording.h"

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/csv_table.h"
#include "common/recordings/table_rows.h"
#include "common/statistics.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kMostSeconds = 4e9;  // 2096; differences of nanoseconds fit in 64 bits

// The longest prefix decides: q_cmd_ before q_. Nothing is sent of the first of these.
constexpr std::pair<const char*, int> kPrefixes[] = {
    {"q_motor_", -1},
    {"q_link_", -1},
    {"q_cmd_", static_cast<int>(JointQuantity::kCommand)},
    {"q_", static_cast<int>(JointQuantity::kPosition)},
    {"dq_", static_cast<int>(JointQuantity::kVelocity)},
    {"tau_", static_cast<int>(JointQuantity::kEffort)}};

// What a cell that is empty or says nan holds is no number, and its row is counted and left out, as
// in every recording.
absl::StatusOr<std::vector<double>> Readings(const CsvTable& table, const std::string& name) {
  RS_ASSIGN_OR_RETURN(const size_t column, table.Column(name));
  std::vector<double> values(table.rows(), std::numeric_limits<double>::quiet_NaN());
  for (size_t row = 0; row < table.rows(); ++row) {
    const absl::string_view text = table.Text(row, column);
    if (text.empty() || absl::EqualsIgnoreCase(text, "nan")) continue;
    RS_ASSIGN_OR_RETURN(values[row], table.Number(row, column));
  }
  return values;
}

// Of the steps from row to row.
double MedianStep(const std::vector<double>& t) {
  std::vector<double> steps;
  for (size_t i = 1; i < t.size(); ++i) steps.push_back(t[i] - t[i - 1]);
  return steps.empty() ? 0 : UpperMedian(std::move(steps));
}

}  // namespace

absl::Status ReadCsvRecording(const std::string& path, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const CsvTable table, CsvTable::Read(path));
  std::vector<JointColumns> columns;
  for (const std::string& name : table.names()) {
    for (const auto& [prefix, quantity] : kPrefixes) {
      if (!absl::StartsWith(name, prefix)) continue;
      if (quantity >= 0) {
        JointColumns column{
            static_cast<JointQuantity>(quantity), {name.substr(std::string(prefix).size())}, {}};
        RS_ASSIGN_OR_RETURN(column.values, Readings(table, name));
        columns.push_back(std::move(column));
      }
      break;
    }
  }
  if (columns.empty() || !table.Has("t"))
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": columns t [s] and q_JOINT are needed, and tau_JOINT or q_cmd_JOINT; it has ",
        absl::StrJoin(table.names(), ", ")));
  RS_ASSIGN_OR_RETURN(const std::vector<double> seconds, table.Numbers("t"));
  std::vector<int64_t> times;
  for (size_t i = 0; i < seconds.size(); ++i) {
    if (std::abs(seconds[i]) > kMostSeconds)
      return absl::InvalidArgumentError(absl::StrCat(table.Place(i), ": t is ", seconds[i],
                                                     ", must be seconds up to ", kMostSeconds, "; ",
                                                     UnitOfStep(MedianStep(seconds))));
    times.push_back(std::llround(seconds[i] * 1e9));
  }
  RS_ASSIGN_OR_RETURN(const size_t channel, rows->Channel({"table", "CSV", "", "rad",
                                                           "the form of a rig's logs", "", true}));
  return SendRows(channel, times, true, columns, rows);
}

}  // namespace robostress
