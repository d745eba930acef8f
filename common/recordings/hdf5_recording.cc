#include "common/recordings/hdf5_recording.h"

#include <algorithm>
#include <filesystem>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/hdf5_file.h"
#include "common/json_text.h"
#include "common/recordings/table_rows.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int64_t kMostRows = int64_t{1} << 20;  // of an episode
constexpr int64_t kMostWidth = 128;
constexpr double kAlohaHz = 50;   // DT of ALOHA's constants.py
constexpr double kLiberoHz = 20;  // control_freq of LIBERO's environments

absl::Status Wrong(const Hdf5File& file, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(file.path(), ": ", what));
}

// A dataset [rows, joints]; empty where it is not there.
absl::StatusOr<JointColumns> Columns(const Hdf5File& file, const std::string& name,
                                     JointQuantity quantity) {
  JointColumns columns;
  columns.quantity = quantity;
  if (!file.Has(name)) return columns;
  RS_ASSIGN_OR_RETURN(const Hdf5Dataset dataset, file.Describe(name));
  if (dataset.shape.size() != 2 || dataset.shape[1] < 1 || dataset.shape[1] > kMostWidth)
    return Wrong(file,
                 absl::StrCat(name, " is [", absl::StrJoin(dataset.shape, ","),
                              "], must be [rows, joints] with up to ", kMostWidth, " joints"));
  // A row with a number that is none is counted and left out, as in every recording.
  RS_ASSIGN_OR_RETURN(columns.values, file.ReadDoubles(name, {-1, dataset.shape[1]}, kMostRows,
                                                       Hdf5File::NotFinite::kKept));
  columns.joints = NumberedJoints(static_cast<size_t>(dataset.shape[1]));
  return columns;
}

// Sends an episode's columns, those that are there; all must have as many rows.
absl::Status SendEpisode(const Hdf5File& file, const std::string& episode, size_t channel,
                         double rate_hz, std::vector<JointColumns> columns, RowStream* rows) {
  std::vector<JointColumns> present;
  size_t count = 0;
  for (JointColumns& group : columns) {
    if (group.joints.empty()) continue;
    const size_t length = group.values.size() / group.joints.size();
    if (!present.empty() && length != count)
      return Wrong(file,
                   absl::StrCat(episode, ": ", QuantityName(group.quantity), " has ", length,
                                " rows, ", QuantityName(present[0].quantity), " has ", count));
    count = length;
    present.push_back(std::move(group));
  }
  rows->visitor().OnEpisode(episode);
  return SendRows(channel, TimesAtRate(count, rate_hz), false, present, rows);
}

// Two ViperX arms of seven: six joints and the gripper.
void NameAlohaJoints(std::vector<JointColumns>* columns) {
  static constexpr const char* kNames[] = {"waist",       "shoulder",     "elbow",  "forearm_roll",
                                           "wrist_angle", "wrist_rotate", "gripper"};
  for (JointColumns& group : *columns) {
    if (group.joints.size() != 14) continue;
    for (size_t i = 0; i < 14; ++i)
      group.joints[i] = absl::StrCat(i < 7 ? "left_" : "right_", kNames[i % 7]);
  }
}

absl::Status ReadAloha(const Hdf5File& file, double rate_hz, RowStream* rows) {
  const double rate = rate_hz > 0 ? rate_hz : kAlohaHz;
  RecordedChannel description;
  description.name = "observations";
  description.type = "ALOHA";
  description.unit = "rad";
  description.unit_because = "ALOHA's servos (a gripper's is a share of its opening)";
  description.caution = "an action is the leader's position, asked of the follower's servos";
  description.times = absl::StrFormat("rows at %.4g Hz, %s", rate,
                                      rate_hz > 0 ? "as --rate-hz says" : "as ALOHA's code has it");
  description.decoded = true;
  RS_ASSIGN_OR_RETURN(const size_t channel, rows->Channel(description));
  std::vector<JointColumns> columns;
  for (const auto& [name, quantity] : {std::pair("observations/qpos", JointQuantity::kPosition),
                                       std::pair("observations/qvel", JointQuantity::kVelocity),
                                       std::pair("observations/effort", JointQuantity::kEffort),
                                       std::pair("action", JointQuantity::kCommand)}) {
    RS_ASSIGN_OR_RETURN(JointColumns group, Columns(file, name, quantity));
    columns.push_back(std::move(group));
  }
  if (columns[3].joints.size() != columns[0].joints.size()) {
    rows->visitor().OnNote(absl::StrCat(file.path(), ": action has ", columns[3].joints.size(),
                                        " columns, qpos ", columns[0].joints.size(),
                                        "; it is not taken for a command"));
    columns.pop_back();
  }
  NameAlohaJoints(&columns);
  const std::string episode = std::filesystem::path(file.path()).filename().string();
  return SendEpisode(file, episode, channel, rate, std::move(columns), rows);
}

// control_freq of the environment that a robomimic file names; 0: it names none.
double ControlFrequency(const Hdf5File& file) {
  const auto text = file.StringAttribute("data", "env_args");
  const auto json = text.ok() ? ParseJsonObject(*text) : text.status();
  if (!json.ok()) return 0;
  const auto arguments = json->find("env_kwargs");
  if (arguments == json->end() || !arguments->is_object()) return 0;
  const auto rate = arguments->find("control_freq");
  return rate != arguments->end() && rate->is_number() ? rate->get<double>() : 0;
}

// "demo_10" behind "demo_9".
std::vector<std::string> SortedDemos(std::vector<std::string> names) {
  const auto key = [](const std::string& name) {
    int64_t number = 0;
    if (!absl::SimpleAtoi(name.substr(name.rfind('_') + 1), &number)) number = -1;
    return std::pair(number, name);
  };
  std::sort(names.begin(), names.end(),
            [&](const auto& a, const auto& b) { return key(a) < key(b); });
  return names;
}

absl::Status ReadRobomimic(const Hdf5File& file, double rate_hz, RowStream* rows) {
  const double stated = ControlFrequency(file);
  const double rate = rate_hz > 0 ? rate_hz : stated > 0 ? stated : kLiberoHz;
  if (rate < 1 || rate > 1e5)
    return Wrong(file, absl::StrCat("data@env_args: control_freq is ", rate,
                                    ", must be 1 to 100000; say it with --rate-hz"));
  RecordedChannel description;
  description.name = "obs";
  description.type = "robomimic or LIBERO";
  description.unit = "rad";
  description.unit_because = "robosuite's joints";
  description.caution =
      "actions are motions asked of the tool's controller, not commands to joints";
  description.times = absl::StrFormat("rows at %.4g Hz, %s", rate,
                                      rate_hz > 0  ? "as --rate-hz says"
                                      : stated > 0 ? "control_freq of data@env_args"
                                                   : "as LIBERO has it; the file does not say");
  description.decoded = true;
  RS_ASSIGN_OR_RETURN(const size_t channel, rows->Channel(description));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> demos, file.Children("data"));
  bool any = false;
  for (const std::string& demo : SortedDemos(demos)) {
    const std::string obs = absl::StrCat("data/", demo, "/obs/");
    std::vector<JointColumns> columns;
    for (const auto& [name, quantity] : {std::pair("robot0_joint_pos", JointQuantity::kPosition),
                                         std::pair("joint_states", JointQuantity::kPosition),
                                         std::pair("robot0_joint_vel", JointQuantity::kVelocity)}) {
      RS_ASSIGN_OR_RETURN(JointColumns group, Columns(file, obs + name, quantity));
      const bool again = quantity == JointQuantity::kPosition && !columns.empty();
      if (!group.joints.empty() && !again) columns.push_back(std::move(group));
    }
    if (columns.empty()) continue;
    any = true;
    RS_RETURN_IF_ERROR(SendEpisode(file, demo, channel, rate, std::move(columns), rows));
  }
  if (any) return absl::OkStatus();
  return Wrong(file,
               "data holds no demo with obs/robot0_joint_pos or obs/joint_states; extract its "
               "observations with robomimic's dataset_states_to_obs.py");
}

}  // namespace

bool IsHdf5Name(const std::string& name) {
  return absl::EndsWith(name, ".hdf5") || absl::EndsWith(name, ".h5");
}

absl::Status ReadHdf5Recording(const std::string& path, double rate_hz, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const Hdf5File file, Hdf5File::Open(path));
  if (file.Has("observations/qpos")) return ReadAloha(file, rate_hz, rows);
  if (file.Has("data")) return ReadRobomimic(file, rate_hz, rows);
  return Wrong(file, "holds neither observations/qpos (ALOHA) nor data (robomimic, LIBERO)");
}

}  // namespace robostress
