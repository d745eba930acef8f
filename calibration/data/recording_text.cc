#include "calibration/data/recording_text.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/data/log_units.h"

namespace robostress::calibration {
namespace {

constexpr double kLost = 1.5;            // in dt: a row is missing
constexpr double kRowsPerPeriod = 3;     // of a motion that rows still show
constexpr double kSlower = 1.4;          // times a position's period: commands are fewer
constexpr double kGainTolerance = 0.15;  // of a unit, from a velocity and a derivative
constexpr double kManyTurns = 8 * M_PI;  // [rad] angles beyond are rather in another unit
constexpr size_t kMostJoints = 64;       // that are printed
constexpr size_t kLongestText = 400;

// Names come from somebody else's file: no control character reaches the terminal.
std::string Printable(const std::string& text) {
  std::string result = text.substr(0, kLongestText);
  for (char& c : result)
    if (absl::ascii_iscntrl(static_cast<unsigned char>(c))) c = '?';
  return result;
}

std::string ClockText(const char* name, const StepCounts& clock) {
  const double dt = clock.Typical();
  if (dt == 0) return absl::StrFormat("    %s: no time passes\n", name);
  std::string text = absl::StrFormat(
      "    %s: every %.4g ms (5 %% to 95 %%: %.4g to %.4g ms), longest %.4g ms at %.2f s", name,
      dt * 1e3, clock.Quantile(0.05) * 1e3, clock.Quantile(0.95) * 1e3, clock.longest_s() * 1e3,
      clock.longest_at_s());
  if (const int64_t gaps = clock.LongerThan(kGapRows * dt); gaps > 0)
    absl::StrAppend(&text, ", ", gaps, " gaps over 5 rows");
  if (const int64_t lost = clock.LongerThan(kLost * dt) - clock.LongerThan(kGapRows * dt); lost > 0)
    absl::StrAppend(&text, ", ", lost, " times rows are missing");
  if (clock.backwards() > 0) absl::StrAppend(&text, ", ", clock.backwards(), " times backwards");
  if (clock.duplicates() > 0)
    absl::StrAppend(&text, ", ", clock.duplicates(), " times the same again");
  return text + "\n";
}

std::string ChannelText(const ChannelStatistics& channel) {
  const StepCounts& clock = channel.stamped > 0 ? channel.stamp : channel.log;
  const double dt = clock.Typical();
  std::string text = absl::StrFormat(
      "  %s  [%s]  %d rows, %.4g Hz, %.2f s%s\n", Printable(channel.description.name),
      Printable(channel.description.type), channel.rows, dt > 0 ? 1 / dt : 0, clock.total_s(),
      channel.description.decoded ? "" : "; not joints");
  if (!channel.description.decoded) return text;
  if (!channel.description.times.empty()) {
    absl::StrAppend(&text, "    times: ", Printable(channel.description.times),
                    "; jitter and gaps are not seen\n");
  } else {
    if (channel.stamped > 0) text += ClockText("stamps", channel.stamp);
    text += ClockText(channel.stamped > 0 ? "recorder" : "recorder (no stamps)", channel.log);
  }
  if (channel.position_sets.size() > 1)
    absl::StrAppend(&text, "    its messages hold ", channel.position_sets.size(),
                    " different sets of joints; rows are those with all of the chosen\n");
  if (!channel.description.caution.empty())
    absl::StrAppend(&text, "    note: ", channel.description.caution, "\n");
  return text;
}

// What numbers say against the unit that the recording's format gives them.
std::string UnitDoubt(const RecordingStatistics& statistics, const SignalStatistics& position,
                      double to_rad) {
  const double largest = std::max(std::abs(position.low), std::abs(position.high)) * to_rad;
  if (position.whole && position.span() > 100)
    return "whole numbers: counts of an encoder? then --unit FACTOR";
  const std::string& joint = position.description.joint;
  const bool no_unit = statistics.channels()[position.description.channel].description.unit.empty();
  if (no_unit && IsGripper(joint)) return "";
  if (largest > kManyTurns)
    return absl::StrCat(absl::StrFormat("values reach %.4g: degrees? then --unit deg", largest),
                        no_unit && largest <= 100
                            ? absl::StrCat("; percent of its way? then --unit ", joint, "=FACTOR")
                            : "");
  const int velocity = statistics.Find(position.description.channel, position.description.joint,
                                       JointQuantity::kVelocity);
  if (velocity < 0) return "";
  const SignalStatistics& logged = statistics.signals()[static_cast<size_t>(velocity)];
  const double gain = logged.square > 0 ? logged.along / logged.square : 0;
  if (gain == 0 || std::abs(gain - 1) < kGainTolerance) return "";
  const std::string unit = UnitOfRatio(gain, kGainTolerance);
  // A clock in milliseconds makes derivatives a thousandth of what they are.
  if (std::abs(gain / 1000 - 1) < kGainTolerance)
    return "velocity is 1000 times the position's derivative: is t in milliseconds? multiply t by "
           "0.001; else the velocity is in thousandths: multiply it by 0.001";
  if (!unit.empty()) return absl::StrCat("the velocity's numbers are ", unit);
  return absl::StrFormat("velocity is %.3g times the position's derivative", gain);
}

std::string UnitText(const RecordingStatistics& statistics, const RecordingPlan& plan) {
  std::string text = "Units\n";
  for (const ChannelStatistics& channel : statistics.channels()) {
    const RecordedChannel& description = channel.description;
    if (!description.decoded) continue;
    absl::StrAppend(&text, "  ", Printable(description.name), ": ",
                    description.unit.empty() ? "not known" : description.unit,
                    description.unit_because.empty() ? "" : ", because of ",
                    description.unit_because, "\n");
  }
  std::set<std::string> said;
  for (const SignalStatistics& signal : statistics.signals()) {
    if (signal.description.quantity != JointQuantity::kPosition || said.size() >= kMostJoints)
      continue;
    const auto planned = std::find_if(
        plan.joints.begin(), plan.joints.end(),
        [&](const PlannedJoint& joint) { return joint.name == signal.description.joint; });
    const std::string doubt =
        UnitDoubt(statistics, signal, planned == plan.joints.end() ? 1 : planned->to_rad);
    if (!doubt.empty() && said.insert(signal.description.joint).second)
      absl::StrAppend(&text, "    ", Printable(signal.description.joint), ": ", doubt, "\n");
  }
  return text;
}

std::string JointsText(const RecordingStatistics& statistics) {
  std::string text = "Joints\n";
  size_t printed = 0;
  for (const SignalStatistics& signal : statistics.signals()) {
    if (printed++ == kMostJoints) {
      absl::StrAppend(&text, "  and ", statistics.signals().size() - kMostJoints, " more\n");
      break;
    }
    absl::StrAppendFormat(
        &text, "  %-10s %-24s %10.4g to %-10.4g fastest %.4g /s, %d reversals%s\n",
        QuantityName(signal.description.quantity), Printable(signal.description.joint), signal.low,
        signal.high, signal.fastest, signal.reversals,
        signal.not_finite > 0
            ? absl::StrCat(", ", signal.not_finite, " of ", signal.count, " are no numbers")
            : "");
  }
  return text;
}

std::string CommandsText(const RecordingStatistics& statistics, const RecordingPlan& plan) {
  std::string text;
  std::set<size_t> channels;
  for (const PlannedJoint& joint : plan.joints) {
    if (joint.command < 0) continue;
    const RecordedSignal& command =
        statistics.signals()[static_cast<size_t>(joint.command)].description;
    channels.insert(command.channel);
    absl::StrAppend(&text, "  Command of ", joint.name, ": ",
                    Printable(statistics.channels()[command.channel].description.name), " ",
                    Printable(command.joint), ", because ", joint.command_because, ".\n");
  }
  for (const size_t index : channels) {
    const ChannelStatistics& channel = statistics.channels()[index];
    if (!channel.description.caution.empty())
      absl::StrAppend(&text, "  Of these commands: ", Printable(channel.description.caution),
                      ".\n");
    const StepCounts& clock = channel.stamped > 0 ? channel.stamp : channel.log;
    const double dt = clock.Typical();
    if (index != plan.channel && dt > kSlower * plan.dt)
      absl::StrAppendFormat(&text,
                            "  Commands come at %.4g Hz, positions at %.4g Hz: between, the last "
                            "is held. If the servo got more, record them at its rate.\n",
                            1 / dt, plan.rate_hz);
  }
  return text;
}

std::string LimitsText(const RecordingStatistics& statistics, const RecordingPlan& plan) {
  std::string text = "What this log can show\n";
  if (plan.rate_hz > 0)
    absl::StrAppendFormat(&text,
                          "  Rows at %.4g Hz show motion up to about %.3g Hz; what is faster is "
                          "hidden or looks slower than it is.\n",
                          plan.rate_hz, plan.rate_hz / kRowsPerPeriod);
  if (!statistics.channels().empty() && plan.rate_hz > 0)
    absl::StrAppend(
        &text, "  Positions: ", Printable(statistics.channels()[plan.channel].description.name),
        plan.channel_because.empty() ? "" : ", because ", Printable(plan.channel_because), ".\n");
  const bool commands = std::any_of(plan.joints.begin(), plan.joints.end(),
                                    [](const PlannedJoint& joint) { return joint.command >= 0; });
  const bool torques = std::any_of(plan.joints.begin(), plan.joints.end(),
                                   [](const PlannedJoint& joint) { return joint.tau >= 0; });
  if (!plan.joints.empty() && !torques)
    text += "  No torques: friction, payload and backlash show only through the servo's errors.\n";
  if (!plan.joints.empty() && !commands)
    text += "  No commands: how the servo follows is not seen.\n";
  text += CommandsText(statistics, plan);
  for (const SignalStatistics& signal : statistics.signals()) {
    if (signal.description.quantity != JointQuantity::kPosition || signal.count < 2 ||
        signal.reversals > 1 || signal.span() < kStill)
      continue;
    absl::StrAppend(&text, "  ", Printable(signal.description.joint),
                    " hardly turns round: friction and backlash need reversals.\n");
    break;
  }
  for (const std::string& sentence : plan.sentences)
    absl::StrAppend(&text, "  ", Printable(sentence), ".\n");
  return text;
}

}  // namespace

std::string DescribeRecording(const RecordingStatistics& statistics, const RecordingPlan& plan) {
  std::string text = absl::StrCat("Channels (", statistics.channels().size(), ")\n");
  for (const ChannelStatistics& channel : statistics.channels()) text += ChannelText(channel);
  text += UnitText(statistics, plan);
  text += JointsText(statistics);
  text += LimitsText(statistics, plan);
  for (const std::string& note : statistics.notes())
    absl::StrAppend(&text, "Note: ", Printable(note), "\n");
  if (statistics.notes_left_out() > 0)
    absl::StrAppend(&text, "Note: and ", statistics.notes_left_out(), " more\n");
  return text;
}

}  // namespace robostress::calibration
