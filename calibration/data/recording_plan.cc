#include "calibration/data/recording_plan.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/data/recording_commands.h"
#include "common/recordings/table_rows.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kPieces = 3;                               // a recording falls into so many
constexpr double kShortestPiece = 20, kLongestPiece = 300;  // [s]
constexpr double kNice = 0.005;        // a rate this near to a whole number is that number
constexpr double kWithCommands = 1.1;  // so many times a row counts beside its command
constexpr double kSame = 1e-3;       // of a joint's span: so near is a command the position itself
constexpr double kNearlyAll = 0.98;  // of the rows

// Whether a name can stand in the header of a CSV file and in a rig.
bool IsPlainName(const std::string& name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '.' || c == '-' ||
           c == '/';
  });
}

// The names of the channel's rows that are most.
std::vector<size_t> MostSet(const ChannelStatistics& channel) {
  const auto most =
      std::max_element(channel.position_sets.begin(), channel.position_sets.end(),
                       [](const auto& a, const auto& b) { return a.second.rows < b.second.rows; });
  return most == channel.position_sets.end() ? std::vector<size_t>() : most->first;
}

// Of every channel its rows of positions, a few more where commands stand in the same rows: they
// are of the same time.
std::vector<double> RowsOfPositions(const RecordingStatistics& statistics) {
  std::vector<double> weight(statistics.channels().size(), 1), rows(weight.size(), 0);
  for (const SignalStatistics& signal : statistics.signals()) {
    if (signal.description.quantity == JointQuantity::kCommand)
      weight[signal.description.channel] = kWithCommands;
  }
  for (size_t i = 0; i < rows.size(); ++i) {
    for (const auto& [names, set] : statistics.channels()[i].position_sets)
      rows[i] = std::max(rows[i], weight[i] * static_cast<double>(set.rows));
  }
  return rows;
}

// Whether commands of another channel are this one's positions: so is a leader's arm in
// teleoperation, which the follower is asked to follow.
bool AreCommanded(const RecordingStatistics& statistics, size_t channel) {
  for (const SignalStatistics& command : statistics.signals()) {
    if (command.description.channel == channel) continue;
    for (const auto& [index, sum] : command.off) {
      const SignalStatistics& position = statistics.signals()[index];
      if (position.description.channel == channel && sum.second >= kLeastRows &&
          RootMean(sum) < kSame * position.span())
        return true;
    }
  }
  return false;
}

// Whether one of two channels holds all joints of the other.
bool HoldSameJoints(const RecordingStatistics& statistics, size_t a, size_t b) {
  const auto names = [&](size_t channel) {
    std::set<std::string> result;
    for (const size_t signal : MostSet(statistics.channels()[channel]))
      result.insert(statistics.signals()[signal].description.joint);
    return result;
  };
  const std::set<std::string> of_a = names(a), of_b = names(b);
  return !of_a.empty() && !of_b.empty() &&
         (std::includes(of_a.begin(), of_a.end(), of_b.begin(), of_b.end()) ||
          std::includes(of_b.begin(), of_b.end(), of_a.begin(), of_a.end()));
}

// The channel of the positions: --topic, or that with most rows, but not a leader's. -1: none has
// positions.
absl::StatusOr<int> ChannelOfPositions(const RecordingStatistics& statistics,
                                       const RecordingOptions& options, RecordingPlan* plan) {
  const std::vector<double> rows = RowsOfPositions(statistics);
  const auto name = [&](size_t i) { return statistics.channels()[i].description.name; };
  int best = -1;
  std::vector<std::string> known;
  for (size_t i = 0; i < rows.size(); ++i) {
    if (rows[i] == 0) continue;
    known.push_back(name(i));
    if (options.topic.empty() ? best < 0 || rows[i] > rows[static_cast<size_t>(best)]
                              : options.topic == name(i))
      best = static_cast<int>(i);
  }
  if (best < 0 && !options.topic.empty())
    return absl::InvalidArgumentError(absl::StrCat(
        "--topic: '", options.topic,
        "' holds no positions of joints; those that do: ", absl::StrJoin(known, ", ")));
  if (best < 0) return best;
  const auto first = static_cast<size_t>(best);
  if (options.topic.empty() && AreCommanded(statistics, first)) {
    double most = 0;
    for (size_t i = 0; i < rows.size(); ++i) {
      if (i == first || rows[i] <= std::max(most, static_cast<double>(kLeastRows)) ||
          !HoldSameJoints(statistics, first, i) || AreCommanded(statistics, i))
        continue;
      most = rows[i];
      best = static_cast<int>(i);
      plan->channel_because = absl::StrCat("what ", name(first), " holds is what is commanded");
    }
  }
  for (size_t i = 0; i < rows.size(); ++i) {
    if (rows[i] > 0 && i != static_cast<size_t>(best) &&
        HoldSameJoints(statistics, static_cast<size_t>(best), i))
      plan->sentences.push_back(
          absl::StrCat(name(i), " holds the same joints; --topic ", name(i), " takes those"));
  }
  return best;
}

double NiceRate(double rate) {
  const double nice = std::round(rate);
  return nice >= 1 && std::abs(rate / nice - 1) < kNice ? nice : rate;
}

// Factor to radians; 0: not known.
double ToRad(const RecordingStatistics& statistics, const RecordingOptions& options,
             const RecordingPlan& plan, const std::string& joint) {
  const auto own = options.to_rad_of.find(joint);
  if (own != options.to_rad_of.end()) return own->second;
  if (options.to_rad > 0) return options.to_rad;
  const std::string& unit = statistics.channels()[plan.channel].description.unit;
  return unit == "deg" ? M_PI / 180 : unit == "rad" ? 1 : 0;
}

absl::StatusOr<std::vector<size_t>> ChosenPositions(const RecordingStatistics& statistics,
                                                    const RecordingOptions& options,
                                                    RecordingPlan* plan) {
  const std::vector<size_t> set = MostSet(statistics.channels()[plan->channel]);
  std::vector<std::string> there;
  for (const size_t i : set) there.push_back(statistics.signals()[i].description.joint);
  for (const auto& [name, to_rad] : options.to_rad_of)
    if (std::find(there.begin(), there.end(), name) == there.end())
      return absl::InvalidArgumentError(absl::StrCat(
          "--unit: '", name, "' is not in ", statistics.channels()[plan->channel].description.name,
          "; there are: ", absl::StrJoin(there, ", ")));
  std::vector<size_t> chosen;
  for (const std::string& name : options.joints) {
    const auto found = std::find_if(set.begin(), set.end(), [&](size_t i) {
      return statistics.signals()[i].description.joint == name;
    });
    if (found == set.end())
      return absl::InvalidArgumentError(
          absl::StrCat("--joints: '", name, "' is not in ",
                       statistics.channels()[plan->channel].description.name,
                       "; there are: ", absl::StrJoin(there, ", ")));
    if (std::find(chosen.begin(), chosen.end(), *found) != chosen.end())
      return absl::InvalidArgumentError(absl::StrCat("--joints: '", name, "' stands twice"));
    chosen.push_back(*found);
  }
  if (!chosen.empty()) return chosen;
  const bool no_unit = statistics.channels()[plan->channel].description.unit.empty();
  for (const size_t i : set) {
    const SignalStatistics& signal = statistics.signals()[i];
    const std::string& name = signal.description.joint;
    const double to_rad = ToRad(statistics, options, *plan, name);
    if (no_unit && IsGripper(name) && options.to_rad_of.count(name) == 0) {
      plan->sentences.push_back(absl::StrCat(name,
                                             " is not in the rig, its numbers are seldom angles; ",
                                             "--unit ", name, "=FACTOR takes it"));
    } else if (to_rad == 0) {
      plan->sentences.push_back(absl::StrCat(name, " has no unit and is not in the rig; --unit ",
                                             name, "=FACTOR says it"));
    } else if (signal.span() * to_rad < kStill) {
      plan->sentences.push_back(absl::StrFormat(
          "%s stands still (it spans %.3g) and is not in the rig", name, signal.span() * to_rad));
    } else if (!IsPlainName(name)) {
      plan->sentences.push_back(
          absl::StrCat("joint '", name, "' is not in the rig: its name cannot stand in a table"));
    } else {
      chosen.push_back(i);
    }
  }
  return chosen;
}

// What drives each joint: what the rig that is taken over says, else one input for all. Joints that
// lack it are left out.
absl::Status ChooseInput(const RecordingStatistics& statistics, const RecordingOptions& options,
                         RecordingPlan* plan) {
  const bool commanded = std::any_of(plan->joints.begin(), plan->joints.end(),
                                     [](const auto& joint) { return joint.command >= 0; });
  std::vector<PlannedJoint> kept;
  std::string lacked;
  for (PlannedJoint& joint : plan->joints) {
    const auto declared = options.inputs.find(joint.name);
    joint.input = declared != options.inputs.end() ? declared->second
                  : commanded                      ? JointInput::kPositionTarget
                                                   : JointInput::kTorque;
    if (joint.input == JointInput::kTransmission)
      return absl::InvalidArgumentError(
          absl::StrCat("--rig: joint ", joint.name,
                       " has input: transmission, which compares q_motor and q_link; ",
                       "a recording has one position of a joint: write its logs yourself, or say "
                       "--joints without ",
                       "it"));
    const bool by_command = joint.input == JointInput::kPositionTarget;
    if ((by_command ? joint.command : joint.tau) >= 0) {
      kept.push_back(std::move(joint));
      continue;
    }
    lacked = by_command ? "command" : "torque";
    plan->sentences.push_back(
        absl::StrCat(joint.name, " has no ", lacked,
                     declared != options.inputs.end() ? ", which the rig asks for," : "",
                     " and is not in the rig"));
  }
  plan->joints = std::move(kept);
  if (!plan->joints.empty()) return absl::OkStatus();
  const bool asked =
      std::any_of(statistics.signals().begin(), statistics.signals().end(),
                  [](const auto& s) { return s.description.quantity == JointQuantity::kCommand; });
  if (!options.inputs.empty() && lacked == "torque") {
    plan->why_none =
        "the rig's joints are driven by torques, which the recording does not have; "
        "record efforts, or take a rig with input: position_target";
  } else if (asked) {
    plan->why_none =
        "the recording's commands have not the names of these joints, or stay far from them; "
        "record "
        "the positions that the servos were sent, or name the channel: --commands";
  } else {
    plan->why_none =
        "the recording has positions and neither the commands nor the torques that made them; "
        "record "
        "the controller's state (JointTrajectoryControllerState) or the command's topic";
  }
  return absl::OkStatus();
}

// By the rows of the chosen positions: on one topic others may come between.
void ChooseClock(const RecordingStatistics& statistics, const RecordingOptions& options,
                 RecordingPlan* plan) {
  const ChannelStatistics& channel = statistics.channels()[plan->channel];
  const PositionSet& set = channel.position_sets.at(MostSet(channel));
  plan->by_stamp = static_cast<double>(set.stamped) >= kNearlyAll * static_cast<double>(set.rows);
  if (set.stamped > 0 && set.stamped < set.rows)
    plan->sentences.push_back(
        absl::StrCat(set.rows - set.stamped, " of ", set.rows, " rows have no header.stamp; ",
                     plan->by_stamp ? "they are left out" : "rows stand at the recorder's times"));
  if (plan->by_stamp && set.stamp.steps() < set.stamped / 2) {
    plan->by_stamp = false;
    plan->sentences.push_back(absl::StrCat("header.stamp steps ", set.stamp.steps(), " times in ",
                                           set.rows, " rows; rows stand at the recorder's times"));
  }
  const StepCounts& clock = plan->by_stamp ? set.stamp : set.log;
  plan->dt = clock.Typical();
  plan->made_up_rate_hz = options.rate_hz;
  plan->rate_hz = NiceRate(plan->dt > 0 ? 1 / plan->dt : 0);
  plan->longest_piece_s =
      std::clamp(clock.total_s() / kPieces + plan->dt, kShortestPiece, kLongestPiece);
}

// A quantity of the joint's rows; -1 where there is none, where it is always the same, as a driver
// fills it in, or where some rows lack it.
int MeasuredBeside(const RecordingStatistics& statistics, const std::string& joint,
                   JointQuantity quantity, RecordingPlan* plan) {
  const int found = statistics.Find(plan->channel, joint, quantity);
  if (found < 0) return -1;
  const SignalStatistics& signal = statistics.signals()[static_cast<size_t>(found)];
  const ChannelStatistics& channel = statistics.channels()[plan->channel];
  const int64_t rows = channel.position_sets.at(MostSet(channel)).rows;
  const int64_t count = signal.count - signal.not_finite;
  if (signal.span() == 0) return -1;
  if (static_cast<double>(count) >= kNearlyAll * static_cast<double>(rows)) return found;
  plan->sentences.push_back(absl::StrCat(QuantityName(quantity), " of ", joint, " stands in ",
                                         count, " of ", rows, " rows and is left out"));
  return -1;
}

}  // namespace

bool IsGripper(const std::string& joint) {
  return absl::StrContains(absl::AsciiStrToLower(joint), "gripper");
}

absl::StatusOr<RecordingPlan> PlanRecording(const RecordingStatistics& statistics,
                                            const RecordingOptions& options) {
  RecordingPlan plan;
  RS_ASSIGN_OR_RETURN(const int channel, ChannelOfPositions(statistics, options, &plan));
  if (channel < 0) {
    plan.why_none = "no channel holds positions of joints that can be read";
    return plan;
  }
  plan.channel = static_cast<size_t>(channel);
  const ChannelStatistics& positions = statistics.channels()[plan.channel];
  RS_RETURN_IF_ERROR(CheckCommands(statistics, options));
  ChooseClock(statistics, options, &plan);
  if (ToRad(statistics, options, plan, "") == 0 && options.to_rad_of.empty()) {
    plan.why_none = absl::StrCat(
        "the unit of ", positions.description.name,
        " is not known; say it: --unit rad, --unit deg, ",
        "--unit FACTOR, which makes radians of its numbers, or --unit JOINT=FACTOR,JOINT=deg,... "
        "where joints differ");
    return plan;
  }
  const std::string unit_of_t = positions.description.times.empty() ? UnitOfStep(plan.dt) : "";
  if (plan.rate_hz < 1 || plan.rate_hz > 1e5) {
    plan.why_none = absl::StrFormat("rows come at %.4g Hz, a log has 1 to 100000%s%s", plan.rate_hz,
                                    unit_of_t.empty() ? "" : "; are times in ", unit_of_t);
    return plan;
  }
  if (!unit_of_t.empty())
    plan.sentences.push_back(
        absl::StrFormat("rows are %.4g s apart: are times in %s", plan.dt, unit_of_t));
  RS_ASSIGN_OR_RETURN(const std::vector<size_t> chosen,
                      ChosenPositions(statistics, options, &plan));
  for (const size_t signal : chosen) {
    const std::string& name = statistics.signals()[signal].description.joint;
    PlannedJoint joint;
    joint.name = name;
    joint.q = static_cast<int>(signal);
    joint.to_rad = ToRad(statistics, options, plan, name);
    if (joint.to_rad == 0)
      return absl::InvalidArgumentError(
          absl::StrCat("--joints: '", name, "' has no unit; say --unit ", name, "=FACTOR"));
    joint.dq = MeasuredBeside(statistics, name, JointQuantity::kVelocity, &plan);
    joint.tau = MeasuredBeside(statistics, name, JointQuantity::kEffort, &plan);
    FindCommand(statistics, options, &joint, &plan);
    plan.joints.push_back(std::move(joint));
  }
  if (plan.joints.empty()) {
    plan.why_none = absl::StrCat("no joint of ", positions.description.name, " moves");
    return plan;
  }
  RS_RETURN_IF_ERROR(ChooseInput(statistics, options, &plan));
  std::set<size_t> channels;
  for (PlannedJoint& joint : plan.joints) {
    if (joint.command < 0) continue;
    const size_t of = statistics.signals()[static_cast<size_t>(joint.command)].description.channel;
    joint.command_in_row = of == plan.channel;
    channels.insert(of);
  }
  for (const size_t of : channels) CompareClocks(statistics, options, of, &plan);
  return plan;
}

}  // namespace robostress::calibration
