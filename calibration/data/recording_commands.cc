#include "calibration/data/recording_commands.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/recordings/joint_messages.h"

namespace robostress::calibration {
namespace {

constexpr double kClearly = 3;  // times nearer is the command of a joint than of the next
constexpr double kNear = 0.2;   // of a joint's span: so far off is a command at most, RMS
// Stamps that are so far from the positions', by the recorder's times, and always as far, are of
// another clock [s]: the way to the recorder takes less, or varies. Half of it at most may vary.
constexpr double kTwoClocks = 0.2;
constexpr double kSoonAfter = 0.01, kVaries = 0.05;  // [s] worth a word

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

// How many of the first parts of two topics' names are the same, without the last.
int SharedNamespace(const std::string& a, const std::string& b) {
  const std::vector<std::string> parts = absl::StrSplit(a, '/'), others = absl::StrSplit(b, '/');
  int shared = 0;
  for (size_t i = 0; i + 1 < std::min(parts.size(), others.size()); ++i) {
    if (parts[i] != others[i]) break;
    ++shared;
  }
  return shared;
}

// A command that has a joint's name.
struct NamedCommand {
  int signal = -1;
  int64_t count = 0;
  // Whether it stands in the position's rows, what its topic's name shares, how near it is.
  std::tuple<bool, int, double> quality;
};

}  // namespace

double RootMean(const std::pair<double, int64_t>& sum) {
  return std::sqrt(sum.first / static_cast<double>(std::max<int64_t>(sum.second, 1)));
}

void FindCommand(const RecordingStatistics& statistics, const RecordingOptions& options,
                 PlannedJoint* joint, RecordingPlan* plan) {
  const SignalStatistics& position = statistics.signals()[static_cast<size_t>(joint->q)];
  const RecordedChannel& positions = statistics.channels()[plan->channel].description;
  const bool moves = position.span() * joint->to_rad >= kStill;
  double nearest = kNear * position.span();
  std::vector<NamedCommand> named;
  std::string refused;
  for (size_t i = 0; i < statistics.signals().size(); ++i) {
    const SignalStatistics& signal = statistics.signals()[i];
    const auto off = signal.off.find(static_cast<size_t>(joint->q));
    if (signal.description.quantity != JointQuantity::kCommand || off == signal.off.end() ||
        signal.count < kLeastRows)
      continue;
    const RecordedChannel& channel = statistics.channels()[signal.description.channel].description;
    if (!options.commands.empty() && channel.name != options.commands) continue;
    const bool in_row = signal.description.channel == plan->channel;
    const double distance = RootMean(off->second);
    if (!absl::StartsWith(signal.description.joint, "[")) {
      const bool said = !options.commands.empty() ||
                        (in_row && KindOfType(channel.type) == JointMessageKind::kControllerState);
      if (moves && !said && distance > kNear * position.span()) {
        refused = absl::StrFormat(
            "the command of %s in %s stays %.3g from a joint that spans %.3g: a step, another "
            "unit, or another joint's? It is not taken; --commands %s takes it",
            signal.description.joint, channel.name, distance, position.span(), channel.name);
        continue;
      }
      named.push_back({static_cast<int>(i),
                       signal.count,
                       {in_row, SharedNamespace(channel.name, positions.name), -distance}});
      continue;
    }
    const double next = NextNearest(statistics, signal, position.description.joint);
    const bool far = distance >= nearest && options.commands.empty();
    if (kClearly * distance > next || far) continue;
    nearest = distance;
    joint->command = static_cast<int>(i);
    joint->command_because =
        absl::StrFormat("it names no joint and stays %.3g from this one", distance);
    if (std::isfinite(next))
      absl::StrAppendFormat(&joint->command_because, ", %.3g from the next", next);
  }
  int64_t most = 0;
  for (const NamedCommand& command : named) most = std::max(most, command.count);
  const NamedCommand* best = nullptr;
  for (const NamedCommand& command : named) {
    const bool counts = std::get<0>(command.quality) || 2 * command.count >= most;
    if (counts && (best == nullptr || command.quality > best->quality)) best = &command;
  }
  if (best != nullptr) {
    joint->command = best->signal;
    joint->command_because = "it has the joint's name";
    const auto rank = [](const NamedCommand& command) {
      return std::pair(std::get<0>(command.quality), std::get<1>(command.quality));
    };
    const auto alike = std::count_if(named.begin(), named.end(), [&](const NamedCommand& command) {
      return rank(command) == rank(*best);
    });
    if (named.size() > 1)
      absl::StrAppend(&joint->command_because, " and, of ", named.size(), " that do, ",
                      alike > 1                    ? "stays nearest"
                      : std::get<0>(best->quality) ? "stands in the positions' rows"
                                                   : "has the topic that is nearest by its name");
  } else if (joint->command < 0 && !refused.empty()) {
    plan->sentences.push_back(std::move(refused));
  }
}

void CompareClocks(const RecordingStatistics& statistics, const RecordingOptions& options,
                   size_t index, RecordingPlan* plan) {
  const ChannelStatistics& channel = statistics.channels()[index];
  const auto ahead = channel.ahead.find(plan->channel);
  if (index == plan->channel || !plan->by_stamp || channel.stamped == 0 ||
      ahead == channel.ahead.end())
    return;
  const double by_s = ahead->second.Quantile(0.5);
  const double varies = ahead->second.Quantile(0.9) - ahead->second.Quantile(0.1);
  using Times = RecordingOptions::CommandTimes;
  const bool other = std::abs(by_s) > kTwoClocks && varies < 0.5 * std::abs(by_s);
  const bool by_recorder =
      options.command_times == Times::kChosen ? other : options.command_times == Times::kRecorder;
  if (by_recorder) plan->by_recorder.insert(index);
  if (std::abs(by_s) < kSoonAfter && varies < kVaries && !by_recorder) return;
  plan->sentences.push_back(absl::StrFormat(
      "stamps of %s are %.3f s %s those of %s, by the recorder's times%s: %s? Its commands stand "
      "by "
      "%s; --command-times %s says otherwise",
      channel.description.name, std::abs(by_s), by_s > 0 ? "ahead of" : "behind",
      statistics.channels()[plan->channel].description.name,
      varies < kVaries ? "" : absl::StrFormat(", give or take %.3f s", varies / 2),
      other ? "two clocks" : "two clocks, or the way to the recorder",
      by_recorder ? "the recorder's times" : "their stamps", by_recorder ? "stamps" : "recorder"));
}

absl::Status CheckCommands(const RecordingStatistics& statistics, const RecordingOptions& options) {
  if (options.commands.empty()) return absl::OkStatus();
  std::set<std::string> known;
  for (const SignalStatistics& signal : statistics.signals()) {
    if (signal.description.quantity == JointQuantity::kCommand)
      known.insert(statistics.channels()[signal.description.channel].description.name);
  }
  if (known.count(options.commands) > 0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "--commands: '", options.commands, "' holds no commands of joints; those that do: ",
      known.empty() ? "none" : absl::StrJoin(known, ", ")));
}

}  // namespace robostress::calibration
