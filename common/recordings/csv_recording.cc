#include "common/recordings/csv_recording.h"

#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/csv_table.h"
#include "common/recordings/table_rows.h"
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
        RS_ASSIGN_OR_RETURN(column.values, table.Numbers(name));
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
      return absl::InvalidArgumentError(
          absl::StrCat(table.Place(i), ": t is ", seconds[i], ", must be seconds"));
    times.push_back(std::llround(seconds[i] * 1e9));
  }
  RS_ASSIGN_OR_RETURN(const size_t channel, rows->Channel({"table", "CSV", "", "rad",
                                                           "the form of a rig's logs", "", true}));
  return SendRows(channel, times, true, columns, rows);
}

}  // namespace robostress
