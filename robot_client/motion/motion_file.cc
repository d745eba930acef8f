#include "robot_client/motion/motion_file.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/csv_table.h"
#include "common/status_macros.h"
#include "robot_client/demonstration/lerobot_reader.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMostBytes = uint64_t{512} << 20;  // of a table: five hours of a run

// PREFIXJ1 .., PREFIXgripper.
std::vector<std::string> ColumnsOf(const std::string& prefix, const ArmAxes& axes) {
  std::vector<std::string> columns;
  for (const std::string& axis : axes.names()) columns.push_back(prefix + axis);
  return columns;
}

// The motion of some rows of a table; `columns`: one per axis, which need not be there.
absl::StatusOr<Motion> MotionOfRows(const CsvTable& table, const std::vector<std::string>& columns,
                                    const std::vector<size_t>& rows, const ArmAxes& axes,
                                    std::string source) {
  Motion motion;
  motion.axes = axes;
  motion.source = std::move(source);
  RS_ASSIGN_OR_RETURN(const size_t time, table.Column("t"));
  for (const size_t row : rows) {
    RS_ASSIGN_OR_RETURN(const double t, table.Number(row, time));
    motion.t.push_back(t);
  }
  const double origin = motion.t.empty() ? 0 : motion.t.front();
  for (double& t : motion.t) t -= origin;
  motion.poses.resize(rows.size());
  for (int axis = 0; axis < axes.count(); ++axis) {
    const std::string& name = columns[static_cast<size_t>(axis)];
    motion.moves[axis] = table.Has(name);
    if (!motion.moves[axis]) continue;
    RS_ASSIGN_OR_RETURN(const size_t column, table.Column(name));
    for (size_t i = 0; i < rows.size(); ++i) {
      RS_ASSIGN_OR_RETURN(motion.poses[i][axis], table.Number(rows[i], column));
    }
  }
  return motion;
}

absl::StatusOr<Motion> ReadTable(const std::string& path, const ArmAxes& axes,
                                 const std::vector<std::string>& rig_names) {
  RS_ASSIGN_OR_RETURN(const CsvTable table, CsvTable::Read(path, kMostBytes));
  std::vector<size_t> rows(table.rows());
  for (size_t i = 0; i < rows.size(); ++i) rows[i] = i;
  // As the rigs of this arm name its joints, or as everything else here does.
  const std::vector<std::string>& names = table.names();
  std::vector<std::string> columns = ColumnsOf("q_cmd_", axes), of_rig = columns;
  for (size_t j = 0; j < rig_names.size() && j < of_rig.size(); ++j)
    of_rig[j] = "q_cmd_" + rig_names[j];
  const auto is_joint = [&](const std::string& name) {
    const auto joints_end = of_rig.begin() + axes.joints;
    return std::find(of_rig.begin(), joints_end, name) != joints_end;
  };
  if (std::any_of(names.begin(), names.end(), is_joint)) columns = of_rig;
  for (const std::string& name : names) {
    if (name != "t" && std::find(columns.begin(), columns.end(), name) == columns.end())
      return absl::InvalidArgumentError(absl::StrCat(
          path, ": column '", name, "' is none of t, ", absl::StrJoin(columns, ", "),
          columns == of_rig ? "" : absl::StrCat("; nor of ", absl::StrJoin(of_rig, ", ")),
          "; rename it or take it out, so that nothing is played that was meant otherwise"));
  }
  return MotionOfRows(table, columns, rows, axes, path);
}

std::string Listed(const std::set<std::string>& episodes) {
  return absl::StrJoin(episodes, ", ").substr(0, 200);
}

// What was sent to one arm is not played on another.
absl::Status CheckSent(const CsvTable& table, const std::string& path, const ArmAxes& axes) {
  ArmAxes sent{0, table.Has("sent_gripper")};
  while (table.Has(absl::StrCat("sent_J", sent.joints + 1))) ++sent.joints;
  if (sent.joints == axes.joints && sent.gripper == axes.gripper) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(path, ": is of an arm of ", sent.text(),
                                                 ", this one has ", axes.text(),
                                                 "; replay it on the arm that it was recorded of"));
}

absl::StatusOr<Motion> ReadRun(const std::string& folder, std::optional<int> episode,
                               const ArmAxes& axes) {
  const std::string path = folder + "/ticks.csv";
  RS_ASSIGN_OR_RETURN(const CsvTable table, CsvTable::Read(path, kMostBytes));
  RS_RETURN_IF_ERROR(CheckSent(table, path, axes));
  RS_ASSIGN_OR_RETURN(const size_t state, table.Column("state"));
  RS_ASSIGN_OR_RETURN(const size_t number, table.Column("episode"));
  std::set<std::string> episodes;
  std::vector<size_t> longest, way;
  for (size_t row = 0; row < table.rows(); ++row) {
    if (table.Text(row, state) == "RUN") episodes.emplace(table.Text(row, number));
    if (table.Text(row, state) == "MOVE") {
      way.push_back(row);
    } else {
      way.clear();
    }
    if (way.size() > longest.size()) longest = way;
  }
  if (episodes.empty() && !episode) {
    if (longest.empty())
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": the arm was never moved in this run"));
    return MotionOfRows(table, ColumnsOf("sent_", axes), longest, axes, path);
  }
  if (!episode && episodes.size() > 1)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": holds episodes ", Listed(episodes), "; say which with --episode N"));
  const std::string wanted = episode ? absl::StrCat(*episode) : *episodes.begin();
  if (episodes.count(wanted) == 0)
    return absl::NotFoundError(
        absl::StrCat(path, ": has no episode ", wanted,
                     episodes.empty() ? "" : absl::StrCat("; it holds ", Listed(episodes))));
  std::vector<size_t> rows;
  for (size_t row = 0; row < table.rows(); ++row) {
    const absl::string_view name = table.Text(row, state);
    if (table.Text(row, number) == wanted && (name == "RUN" || name == "HOLD")) rows.push_back(row);
  }
  return MotionOfRows(table, ColumnsOf("sent_", axes), rows, axes,
                      absl::StrCat(path, " episode ", wanted));
}

absl::StatusOr<Motion> ReadDataset(const std::string& folder, std::optional<int> episode,
                                   const ArmAxes& axes) {
  RS_ASSIGN_OR_RETURN(const LerobotReader set, LerobotReader::Open(folder, axes));
  if (!episode && set.episodes() != 1)
    return absl::InvalidArgumentError(absl::StrCat(
        folder, ": holds episodes 0 to ", set.episodes() - 1, "; say which with --episode N"));
  RS_ASSIGN_OR_RETURN(std::vector<ArmVector> actions, set.ReadActions(episode.value_or(0)));
  Motion motion;
  motion.axes = axes;
  motion.source = absl::StrCat(folder, " episode ", episode.value_or(0));
  for (size_t i = 0; i < actions.size(); ++i)
    motion.t.push_back(static_cast<double>(i) / set.rate_hz());
  motion.poses = std::move(actions);
  std::fill_n(motion.moves.begin(), axes.count(), true);
  return motion;
}

}  // namespace

absl::StatusOr<Motion> ReadMotion(const std::string& path, std::optional<int> episode,
                                  const ArmAxes& axes, const std::vector<std::string>& rig_names) {
  std::error_code ignored;
  if (!fs::exists(path, ignored)) return absl::NotFoundError(absl::StrCat(path, ": is not there"));
  if (fs::is_directory(path, ignored)) {
    for (const std::string& folder : {path, path + "/lerobot"}) {
      if (fs::exists(folder + "/meta/info.json", ignored))
        return ReadDataset(folder, episode, axes);
    }
    if (fs::exists(path + "/ticks.csv", ignored)) return ReadRun(path, episode, axes);
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": is neither a run (ticks.csv) nor a data set (meta/info.json, or lerobot/ in it)"));
  }
  if (episode)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": a file is one motion; leave --episode out"));
  if (fs::path(path).extension() != ".csv")
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": a motion is a .csv, a run's folder or a data set's folder"));
  return ReadTable(path, axes, rig_names);
}

}  // namespace robostress
