#include "robot_client/piper/arm_report_text.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "robot_client/piper/status_words.h"

namespace robostress::piper {
namespace {

constexpr double kDegrees = 180 / M_PI;
constexpr double kOld_s = 0.25;        // what is older is not what is now
constexpr double kMilliseconds = 1e3;  // per second

// A number in so many columns, or a dash where there is none.
std::string Cell(std::optional<double> value, int width, int digits) {
  return value ? absl::StrFormat("%*.*f", width, digits, *value)
               : absl::StrFormat("%*s", width, "-");
}

// Rounded to a tenth, without a negative zero.
double Tenths(double value) { return std::round(10 * value) / 10 + 0.0; }

template <class T, class Field>
std::optional<double> Of(const std::optional<T>& from, Field T::*field, double unit = 1) {
  return from ? std::optional(unit * static_cast<double>((*from).*field)) : std::nullopt;
}

std::string StatusText(const ArmReport& r) {
  if (r.unknown_status)
    return absl::StrFormat("status not known: control mode %d, code %d", (*r.unknown_status)[0],
                           (*r.unknown_status)[1]);
  if (!r.status) return "no status";
  const ArmStatus& s = *r.status;
  return absl::StrCat("control ", WordsOf(s.control), ", status ", WordsOf(s.code), ", move mode ",
                      WordsOf(s.move), ", teaching ", TeachWords(s.teach), ", ",
                      s.moving ? "on its way" : "at its target");
}

int Powered(const ArmReport& r) {
  return static_cast<int>(std::count_if(r.joints.begin(), r.joints.end(), [](const JointReport& j) {
    return j.driver && (j.driver->bits & kEnabled) != 0;
  }));
}

std::string AgeText(const AgeStatistics::Summary& age) {
  return absl::StrFormat("%.1f / %.1f / %.1f ms", kMilliseconds * age.mean_s,
                         kMilliseconds * age.p99_s, kMilliseconds * age.worst_s);
}

std::string QuestionText(const QuestionReport& q) {
  if (q.silent) return "none asked (--silent)";
  std::string text = absl::StrFormat("%d of %d answered", q.answered, q.questions);
  if (q.answers > 0)
    absl::StrAppendFormat(&text, ", an answer takes %.1f ms (worst %.1f)", kMilliseconds * q.mean_s,
                          kMilliseconds * q.worst_s);
  if (q.waits) text += "; none asked while another program commands the arm";
  return text;
}

std::string Joints(const ArmReport& r) {
  std::string text;
  if (r.sample_age_s > kOld_s)
    absl::StrAppendFormat(&text, "as they were %.1f s ago\n", r.sample_age_s);
  text +=
      "      angle   angle velocity  torque current  motor driver supply  power  target  faults\n"
      "      [deg]   [rad]  [rad/s]    [Nm]     [A]    [C]    [C]    [V]          [deg]\n";
  for (int j = 0; j < kJoints; ++j) {
    const JointReport& joint = r.joints[j];
    const std::optional<double> torque = joint.motion ? std::optional(joint.torque) : std::nullopt;
    const auto driver = joint.driver_age_s <= kOld_s ? joint.driver : std::nullopt;
    const std::string faults = driver ? DriverFaultWords(driver->bits) : "does not report";
    const std::optional<double> target = joint.target && r.other.commands_now
                                             ? std::optional(*joint.target * kDegrees)
                                             : std::nullopt;
    absl::StrAppend(&text, "J", j + 1, " ",
                    Cell(joint.angle ? std::optional(*joint.angle * kDegrees) : std::nullopt, 8, 2),
                    Cell(joint.angle, 8, 4), Cell(Of(joint.motion, &JointSpeed::velocity), 9, 3),
                    Cell(torque, 8, 2), Cell(Of(joint.motion, &JointSpeed::current), 8, 2),
                    Cell(Of(driver, &DriverStatus::motor_temperature), 7, 0),
                    Cell(Of(driver, &DriverStatus::driver_temperature), 7, 0),
                    Cell(Of(driver, &DriverStatus::supply_V), 7, 1),
                    absl::StrFormat("%7s", driver ? (driver->bits & kEnabled ? "on" : "off") : "-"),
                    Cell(target, 8, 2), faults.empty() ? "" : "  ", faults, "\n");
  }
  return text;
}

std::string GripperText(const ArmReport& r) {
  std::string text = "gripper  ";
  if (r.gripper) {
    absl::StrAppendFormat(&text, "opening %.1f mm, %.2f Nm, power %s, %s", 1e3 * r.gripper->opening,
                          r.gripper->effort, r.gripper->enabled ? "on" : "off",
                          r.gripper->homed ? "homed" : "not homed");
    if (r.gripper->errors != 0) absl::StrAppend(&text, ", ", GripperFaultWords(r.gripper->errors));
  } else {
    text += "does not report";
  }
  if (r.gripper_range) absl::StrAppendFormat(&text, ", range %.0f mm", 1e3 * *r.gripper_range);
  return text + "\n";
}

std::string Limits(const ArmReport& r) {
  std::string text =
      "      lower   upper    speed    acceleration  collision level\n"
      "      [deg]   [deg]  [rad/s]       [rad/s^2]  (0 is off)\n";
  for (int j = 0; j < kJoints; ++j) {
    const JointReport& joint = r.joints[j];
    const std::optional<double> level =
        r.collision_levels ? std::optional<double>((*r.collision_levels)[j]) : std::nullopt;
    absl::StrAppend(&text, "J", j + 1, " ",
                    Cell(Of(joint.limit, &JointLimit::lower, kDegrees), 8, 1),
                    Cell(Of(joint.limit, &JointLimit::upper, kDegrees), 8, 1),
                    Cell(Of(joint.limit, &JointLimit::max_speed), 9, 2),
                    Cell(Of(joint.acceleration, &JointAcceleration::max_acceleration), 16, 2),
                    Cell(level, 11, 0), "\n");
  }
  return text;
}

// Identifiers of one family in one cell: "0x2A5 200 200 200 (200)".
std::string Frames(const ArmReport& r) {
  std::string text = "frames per second (what a Piper sends in brackets)\n";
  struct Family {
    const char* name;
    size_t first, count;
  };
  static constexpr Family kFamilies[] = {{"status  0x2A1", 0, 1}, {"pose    0x2A2", 1, 3},
                                         {"angles  0x2A5", 4, 3}, {"gripper 0x2A8", 7, 1},
                                         {"speeds  0x251", 8, 6}, {"drivers 0x261", 14, 6}};
  for (const Family& family : kFamilies) {
    absl::StrAppend(&text, "  ", family.name);
    for (size_t i = 0; i < family.count && family.first + i < r.reports.size(); ++i)
      absl::StrAppendFormat(&text, " %.0f", r.reports[family.first + i].per_second);
    absl::StrAppendFormat(&text, " (%.0f)\n", r.reports[family.first].expected);
  }
  for (const FrameCount& count : r.unknown)
    absl::StrAppendFormat(&text, "  not of a Piper: 0x%03X %.0f\n", count.id, count.per_second);
  return text;
}

std::string Others(const OtherSender& other) {
  if (other.frames == 0) return "other senders  none commands this arm\n";
  std::vector<std::string> kinds;
  for (const FrameCount& command : other.commands)
    kinds.push_back(absl::StrFormat("0x%03X %d", command.id, command.total));
  const char* who = "";
  // robot_client sends targets at its control rate, the SDK's demos and a leader arm at 200.
  if (other.targets_per_second > 100) who = "; as the vendor's SDK or a leader arm does";
  if (other.targets_per_second > 10 && other.targets_per_second <= 60)
    who = "; as robot_client does";
  return absl::StrFormat(
      "other senders  %d commands, the last %.1f s ago: %s; targets %.0f per "
      "second%s\n",
      other.frames, other.last_s, absl::StrJoin(kinds, ", "), other.targets_per_second, who);
}

std::string Findings(const std::vector<Finding>& findings) {
  std::string text;
  for (const Finding& finding : findings)
    absl::StrAppend(&text, finding.error ? "WRONG    " : "WARNING  ", finding.text, "\n");
  if (!HasError(findings)) text += "well: nothing is wrong\n";
  return text;
}

// ---- JSON, written by hand: a dozen kinds of values, in a fixed order.

std::string Quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      absl::StrAppendFormat(&out, "\\u%04x", c);
    } else {
      out += c;
    }
  }
  return out + '"';
}
std::string Json(std::optional<double> value) {
  return value && std::isfinite(*value) ? absl::StrFormat("%.6g", *value) : "null";
}
std::string JsonBool(bool value) { return value ? "true" : "false"; }

std::string JsonJoint(const JointReport& joint, const std::optional<double>& level) {
  const auto& driver = joint.driver;
  return absl::StrCat(
      "{\"angle_rad\":", Json(joint.angle),
      ",\"velocity_rad_s\":", Json(Of(joint.motion, &JointSpeed::velocity)),
      ",\"torque_Nm\":", Json(joint.motion ? std::optional(joint.torque) : std::nullopt),
      ",\"current_A\":", Json(Of(joint.motion, &JointSpeed::current)),
      ",\"target_rad\":", Json(joint.target),
      ",\"motor_C\":", Json(Of(driver, &DriverStatus::motor_temperature)),
      ",\"driver_C\":", Json(Of(driver, &DriverStatus::driver_temperature)),
      ",\"supply_V\":", Json(Of(driver, &DriverStatus::supply_V)),
      ",\"enabled\":", driver ? JsonBool((driver->bits & kEnabled) != 0) : std::string("null"),
      ",\"faults\":", driver ? Quoted(DriverFaultWords(driver->bits)) : std::string("null"),
      ",\"lower_rad\":", Json(Of(joint.limit, &JointLimit::lower)),
      ",\"upper_rad\":", Json(Of(joint.limit, &JointLimit::upper)),
      ",\"max_speed_rad_s\":", Json(Of(joint.limit, &JointLimit::max_speed)),
      ",\"max_acceleration_rad_s2\":",
      Json(Of(joint.acceleration, &JointAcceleration::max_acceleration)),
      ",\"collision_level\":", Json(level), "}");
}

std::string JsonCounts(const std::vector<FrameCount>& counts) {
  return absl::StrCat(
      "[",
      absl::StrJoin(counts, ",",
                    [](std::string* out, const FrameCount& c) {
                      absl::StrAppendFormat(
                          out, "{\"id\":%d,\"total\":%d,\"per_second\":%.1f,\"expected\":%.0f}",
                          c.id, c.total, c.per_second, c.expected);
                    }),
      "]");
}

std::string JsonStatus(const ArmReport& r) {
  if (!r.status || r.unknown_status) return "null";
  const ArmStatus& s = *r.status;
  return absl::StrCat(
      "{\"control\":", Quoted(WordsOf(s.control)), ",\"code\":", static_cast<int>(s.code),
      ",\"words\":", Quoted(WordsOf(s.code)), ",\"move\":", Quoted(WordsOf(s.move)),
      ",\"teach\":", Quoted(TeachWords(s.teach)), ",\"moving\":", JsonBool(s.moving), "}");
}

std::string JsonGripper(const ArmReport& r) {
  return absl::StrCat(
      "{\"opening_m\":", Json(Of(r.gripper, &GripperStatus::opening)),
      ",\"effort_Nm\":", Json(Of(r.gripper, &GripperStatus::effort)),
      ",\"enabled\":", r.gripper ? JsonBool(r.gripper->enabled) : std::string("null"),
      ",\"homed\":", r.gripper ? JsonBool(r.gripper->homed) : std::string("null"), ",\"faults\":",
      r.gripper ? Quoted(GripperFaultWords(r.gripper->errors)) : std::string("null"),
      ",\"range_m\":", Json(r.gripper_range), "}");
}

std::string JsonMessages(const std::vector<Finding>& findings, bool errors) {
  std::vector<std::string> texts;
  for (const Finding& finding : findings) {
    if (finding.error == errors) texts.push_back(Quoted(finding.text));
  }
  return absl::StrCat("[", absl::StrJoin(texts, ","), "]");
}

}  // namespace

std::string ReportPage(const ArmReport& r, const std::vector<Finding>& findings) {
  if (r.frames + r.other.frames == 0)
    return absl::StrFormat("%s  %.1f s, %s\n%s", r.bus, r.seconds, CanStateName(r.health.state),
                           Findings(findings));
  double frames_per_second = 0;
  for (const FrameCount& count : r.reports) frames_per_second += count.per_second;
  return absl::StrCat(
      absl::StrFormat("%s  %.1f s\n", r.bus, r.seconds), "arm      firmware ",
      r.firmware ? FirmwareName(*r.firmware) : "not known", ", ", StatusText(r), "\n",
      absl::StrFormat("bus      %s, %.0f of 3040 frames per second, %d lost, %d error frames\n",
                      CanStateName(r.health.state), frames_per_second, r.health.overflows,
                      r.health.error_frames),
      absl::StrFormat("samples  %.0f per second, %d torn; age of the newest, mean / 99 %% / worst: "
                      "%s; worst so far %.1f ms\n",
                      r.samples_per_second, r.torn, AgeText(r.age), kMilliseconds * r.worst_age_s),
      "asked    ", QuestionText(r.questions), "\n\n", Joints(r), GripperText(r), "\n", Limits(r),
      "\n", Frames(r), Others(r.other), "\n", Findings(findings));
}

std::string ReportLine(const ArmReport& r, const std::vector<Finding>& findings) {
  const std::string angles =
      absl::StrJoin(r.joints, " ", [](std::string* out, const JointReport& joint) {
        absl::StrAppend(out, joint.angle ? Cell(Tenths(*joint.angle * kDegrees), 1, 1) : "-");
      });
  const auto errors =
      std::count_if(findings.begin(), findings.end(), [](const Finding& f) { return f.error; });
  return absl::StrFormat(
      "%.1f s  joints [deg] %s  power %d of 6  %s  age %s  %d wrong, %d warnings\n", r.seconds,
      angles, Powered(r), r.status && !r.unknown_status ? WordsOf(r.status->code) : "no status",
      AgeText(r.age), errors, findings.size() - static_cast<size_t>(errors));
}

std::string ReportJson(const ArmReport& r, const std::vector<Finding>& findings) {
  std::vector<std::string> joints;
  for (int j = 0; j < kJoints; ++j) {
    joints.push_back(JsonJoint(r.joints[j], r.collision_levels
                                                ? std::optional<double>((*r.collision_levels)[j])
                                                : std::nullopt));
  }
  const OtherSender& o = r.other;
  const QuestionReport& q = r.questions;
  return absl::StrCat(
      "{\"schema\":\"robostress.arm_report.v1\",\"bus\":", Quoted(r.bus),
      ",\"bus_state\":", Quoted(CanStateName(r.health.state)), ",\"bus_lost\":", r.health.overflows,
      ",\"bus_error_frames\":", r.health.error_frames, ",\"seconds\":", Json(r.seconds),
      ",\"window_s\":", Json(r.window_s),
      ",\"firmware\":", r.firmware ? Quoted(FirmwareName(*r.firmware)) : "null",
      ",\"status\":", JsonStatus(r), ",\"joints\":[", absl::StrJoin(joints, ","),
      "],\"gripper\":", JsonGripper(r), ",\"samples\":", r.samples, ",\"torn\":", r.torn,
      ",\"samples_per_second\":", Json(r.samples_per_second),
      ",\"age_mean_s\":", Json(r.age.mean_s), ",\"age_p99_s\":", Json(r.age.p99_s),
      ",\"age_worst_s\":", Json(r.age.worst_s), ",\"age_worst_so_far_s\":", Json(r.worst_age_s),
      ",\"frames\":", JsonCounts(r.reports), ",\"unknown_frames\":", JsonCounts(r.unknown),
      ",\"other_commands\":", JsonCounts(o.commands),
      ",\"other_commands_now\":", JsonBool(o.commands_now), ",\"questions\":", q.questions,
      ",\"answered\":", q.answered, ",\"asked_frames\":", q.asked,
      ",\"answer_mean_s\":", Json(q.mean_s), ",\"answer_worst_s\":", Json(q.worst_s),
      ",\"asking\":", JsonBool(!q.silent && !q.waits), ",\"wrong\":", JsonMessages(findings, true),
      ",\"warnings\":", JsonMessages(findings, false), ",\"well\":", JsonBool(!HasError(findings)),
      "}\n");
}

}  // namespace robostress::piper
