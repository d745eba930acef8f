#include "calibration/data/recording_plan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/recordings/table_rows.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kPieces = 3;                               // a recording falls into so many
constexpr double kShortestPiece = 20, kLongestPiece = 300;  // [s]
constexpr double kNice = 0.005;        // a rate this near to a whole number is that number
constexpr double kWithCommands = 1.1;  // so many times a row counts beside its command
constexpr double kClearly = 3;         // times nearer is the command of a joint than of the next
constexpr double kSame = 1e-3;      // of a joint's span: so near is a command the position itself
constexpr double kNear = 0.2;       // of a joint's span: so far off is a command at most, RMS
constexpr int64_t kLeastRows = 50;  // of a log (measured_log.cc)

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
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  return most == channel.position_sets.end() ? std::vector<size_t>() : most->first;
}

double RootMean(const std::pair<double, int64_t>& sum) {
  return std::sqrt(sum.first / static_cast<double>(std::max<int64_t>(sum.second, 1)));
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
    for (const auto& [set, count] : statistics.channels()[i].position_sets)
      rows[i] = std::max(rows[i], weight[i] * static_cast<double>(count));
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

// How far the nearest position of another joint is from a command.
double NextNearest(const RecordingStatistics& statistics, const SignalStatistics& command,
                   const std::string& joint) {
  double next = std::numeric_limits<double>::infinity();
  for (const auto& [position, sum] : command.off) {
    if (statistics.signals()[position].description.joint != joint)
      next = std::min(next, RootMean(sum));
  }
  return next;
}

// The command with the joint's name, of the position's own rows or else of the most; or one without
// a name that stays near the joint, and clearly nearer than to the next. A command with the name
// that is far from the joint is none: it may be a step of the position.
void FindCommand(const RecordingStatistics& statistics, PlannedJoint* joint, RecordingPlan* plan) {
  const SignalStatistics& position = statistics.signals()[static_cast<size_t>(joint->q)];
  const bool moves = position.span() * plan->to_rad >= kStill;
  double nearest = kNear * position.span();
  std::pair<bool, int64_t> best;  // of those with the name
  std::string refused;
  for (size_t i = 0; i < statistics.signals().size(); ++i) {
    const SignalStatistics& signal = statistics.signals()[i];
    const auto off = signal.off.find(static_cast<size_t>(joint->q));
    if (signal.description.quantity != JointQuantity::kCommand || off == signal.off.end() ||
        signal.count < kLeastRows)
      continue;
    const double distance = RootMean(off->second);
    if (!absl::StartsWith(signal.description.joint, "[")) {
      if (moves && distance > kNear * position.span()) {
        refused = absl::StrFormat(
            "the command of %s in %s stays %.3g from a joint that spans %.3g: a step, another "
            "unit, or another joint's? It is not taken",
            signal.description.joint,
            statistics.channels()[signal.description.channel].description.name, distance,
            position.span());
        continue;
      }
      const std::pair quality(signal.description.channel == plan->channel, signal.count);
      if (quality <= best) continue;
      best = quality;
      joint->command = static_cast<int>(i);
      joint->command_because = "it has the joint's name";
      continue;
    }
    const double next = NextNearest(statistics, signal, position.description.joint);
    if (best.second > 0 || kClearly * distance > next || distance >= nearest) continue;
    nearest = distance;
    joint->command = static_cast<int>(i);
    joint->command_because =
        absl::StrFormat("it names no joint and stays %.3g from this one", distance);
    if (std::isfinite(next))
      absl::StrAppendFormat(&joint->command_because, ", %.3g from the next", next);
  }
  if (joint->command < 0 && !refused.empty()) plan->sentences.push_back(std::move(refused));
}

absl::StatusOr<std::vector<size_t>> ChosenPositions(const RecordingStatistics& statistics,
                                                    const RecordingOptions& options,
                                                    RecordingPlan* plan) {
  const std::vector<size_t> set = MostSet(statistics.channels()[plan->channel]);
  std::vector<size_t> chosen;
  for (const std::string& name : options.joints) {
    const auto found = std::find_if(set.begin(), set.end(), [&](size_t i) {
      return statistics.signals()[i].description.joint == name;
    });
    if (found == set.end()) {
      std::vector<std::string> known;
      for (const size_t i : set) known.push_back(statistics.signals()[i].description.joint);
      return absl::InvalidArgumentError(
          absl::StrCat("--joints: '", name, "' is not in ",
                       statistics.channels()[plan->channel].description.name,
                       "; there are: ", absl::StrJoin(known, ", ")));
    }
    if (std::find(chosen.begin(), chosen.end(), *found) != chosen.end())
      return absl::InvalidArgumentError(absl::StrCat("--joints: '", name, "' stands twice"));
    chosen.push_back(*found);
  }
  if (!chosen.empty()) return chosen;
  for (const size_t i : set) {
    const SignalStatistics& signal = statistics.signals()[i];
    const std::string& name = signal.description.joint;
    if (signal.span() * plan->to_rad < kStill) {
      plan->sentences.push_back(
          absl::StrFormat("%s stands still (it spans %.3g) and is not in the rig", name,
                          signal.span() * plan->to_rad));
    } else if (!IsPlainName(name)) {
      plan->sentences.push_back(
          absl::StrCat("joint '", name, "' is not in the rig: its name cannot stand in a table"));
    } else {
      chosen.push_back(i);
    }
  }
  return chosen;
}

// One input for all; joints that lack it are left out.
void ChooseInput(const RecordingStatistics& statistics, RecordingPlan* plan) {
  const auto commanded =
      std::count_if(plan->joints.begin(), plan->joints.end(),
                    [](const PlannedJoint& joint) { return joint.command >= 0; });
  const auto driven = std::count_if(plan->joints.begin(), plan->joints.end(),
                                    [](const PlannedJoint& joint) { return joint.tau >= 0; });
  plan->input = commanded > 0 ? JointInput::kPositionTarget : JointInput::kTorque;
  if (commanded == 0 && driven == 0) {
    plan->joints.clear();
    const bool asked = std::any_of(
        statistics.signals().begin(), statistics.signals().end(),
        [](const auto& s) { return s.description.quantity == JointQuantity::kCommand; });
    plan->why_none = absl::StrCat(
        asked ? "the recording's commands have not the names of these joints, or stay far from them"
              : "the recording has positions and neither the commands nor the torques that made "
                "them",
        "; record the controller's state (JointTrajectoryControllerState) or the ",
        asked ? "positions that the servos were sent" : "command's topic");
    return;
  }
  std::vector<PlannedJoint> kept;
  for (const PlannedJoint& joint : plan->joints) {
    if ((commanded > 0 ? joint.command : joint.tau) >= 0)
      kept.push_back(joint);
    else
      plan->sentences.push_back(absl::StrCat(
          joint.name, " has no ", commanded > 0 ? "command" : "torque", " and is not in the rig"));
  }
  plan->joints = std::move(kept);
}

void ChooseClock(const RecordingStatistics& statistics, const RecordingOptions& options,
                 RecordingPlan* plan) {
  const ChannelStatistics& channel = statistics.channels()[plan->channel];
  plan->by_stamp = channel.stamped == channel.rows;
  if (!plan->by_stamp && channel.stamped > 0)
    plan->sentences.push_back(
        absl::StrCat(channel.rows - channel.stamped, " of ", channel.rows,
                     " rows have no header.stamp; rows stand at the recorder's times"));
  if (plan->by_stamp && channel.stamp.steps() < channel.rows / 2) {
    plan->by_stamp = false;
    plan->sentences.push_back(absl::StrCat("header.stamp steps ", channel.stamp.steps(),
                                           " times in ", channel.rows,
                                           " rows; rows stand at the recorder's times"));
  }
  const StepCounts& clock = plan->by_stamp ? channel.stamp : channel.log;
  plan->dt = clock.Quantile(0.5);
  plan->made_up_rate_hz = options.rate_hz;
  plan->rate_hz = NiceRate(plan->dt > 0 ? 1 / plan->dt : 0);
  plan->longest_piece_s =
      std::clamp(clock.total_s() / kPieces + plan->dt, kShortestPiece, kLongestPiece);
}

}  // namespace

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
  ChooseClock(statistics, options, &plan);
  plan.to_rad = options.to_rad;
  if (options.to_rad == 0) {
    const std::string& unit = positions.description.unit;
    plan.to_rad = unit == "deg" ? M_PI / 180 : 1;
    if (unit != "rad" && unit != "deg") {
      plan.why_none = absl::StrCat("the unit of ", positions.description.name,
                                   " is not known; say it: --unit rad, --unit deg, or --unit "
                                   "FACTOR, which makes radians of its numbers");
      return plan;
    }
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
    joint.dq = statistics.Find(plan.channel, name, JointQuantity::kVelocity);
    joint.tau = statistics.Find(plan.channel, name, JointQuantity::kEffort);
    if (joint.tau >= 0 && statistics.signals()[static_cast<size_t>(joint.tau)].span() == 0)
      joint.tau = -1;  // drivers fill in zeros
    if (joint.dq >= 0 && statistics.signals()[static_cast<size_t>(joint.dq)].span() == 0)
      joint.dq = -1;
    FindCommand(statistics, &joint, &plan);
    plan.joints.push_back(std::move(joint));
  }
  if (plan.joints.empty()) {
    plan.why_none = absl::StrCat("no joint of ", positions.description.name, " moves");
    return plan;
  }
  ChooseInput(statistics, &plan);
  for (PlannedJoint& joint : plan.joints) {
    if (joint.command < 0) continue;
    joint.command_in_row =
        statistics.signals()[static_cast<size_t>(joint.command)].description.channel ==
        plan.channel;
  }
  return plan;
}

}  // namespace robostress::calibration
