#include "robot_client/piper/arm_report.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/statistics.h"
#include "robot_client/piper/limit_check.h"
#include "robot_client/piper/status_words.h"

namespace robostress::piper {
namespace {

constexpr double kRateTolerance = 0.1;
constexpr double kRateWindow_s = 0.5;  // below, a rate says nothing
constexpr double kOldAge_s = 0.05;     // WatchdogOptions::arm_hold_s as delivered
constexpr double kStatusAge_s = 0.2;   // as PiperArm has it
constexpr double kSupplyDifference_V = 3;

class Diagnosis {
 public:
  explicit Diagnosis(const ArmReport& report) : r_(report) {}

  std::vector<Finding> Run() {
    Bus();
    Others();
    if (r_.frames == 0) {
      Silence();
    } else {
      Samples();
      Status();
      Drivers();
      Firmware();
      Limits();
      Gripper();
      Rates();
    }
    std::stable_sort(findings_.begin(), findings_.end(),
                     [](const Finding& a, const Finding& b) { return a.error > b.error; });
    return std::move(findings_);
  }

 private:
  template <class... Parts>
  void Error(const Parts&... parts) {
    findings_.push_back({true, absl::StrCat(parts...)});
  }
  template <class... Parts>
  void Warn(const Parts&... parts) {
    findings_.push_back({false, absl::StrCat(parts...)});
  }
  // Targets without samples: the arm itself sends them.
  bool Leader() const { return r_.samples_per_second == 0 && r_.other.targets_per_second > 0; }
  // Whether a missing answer says something about the arm.
  bool Asked() const { return !r_.questions.silent && !r_.questions.waits; }

  void Bus() {
    const std::string advice = BusAdvice(r_.bus, r_.health);
    if (!advice.empty()) Error("bus: ", advice);
    if (r_.health.overflows > 0)
      Warn("bus: ", r_.health.overflows,
           " frames were lost on this machine because it was busy; close other programs");
  }

  void Others() {
    if (r_.other.frames == 0) return;
    if (Leader())
      return Error("the arm is in leader mode, or only a leader arm is connected: commands come (",
                   "0x155 ", absl::StrFormat("%.0f", r_.other.targets_per_second),
                   " times per second) and no joint angles; set it to follower mode with the "
                   "vendor's tool, then power it off and on");
    if (r_.other.commands_now)
      Warn(
          "another program or a leader arm commands this arm; a second robot_client refuses to "
          "start beside it");
    for (const FrameCount& command : r_.other.commands) {
      if (command.id >= kLeaderFollower)
        Warn(
            absl::StrFormat("somebody has sent 0x%03X %d times, which gives or takes power or "
                            "changes the arm's settings",
                            command.id, command.total));
    }
  }

  void Silence() {
    if (Leader()) return;
    Error(
        "nothing comes from an arm: is its power on (the switch, the emergency stop)? Is CAN_H "
        "on CAN_H and the bus at 1 Mbit/s with 120 ohm at both ends? An arm in leader mode "
        "sends no angles");
  }

  void Samples() {
    if (r_.samples_per_second == 0 && !Leader())
      return Error("no complete joint sample comes: ", r_.samples == 0 ? "" : "they have stopped; ",
                   r_.unknown.empty()
                       ? "power the arm off and on, check the cable"
                       : "identifiers that a Piper as delivered does not use come (below): its "
                         "identifiers may be moved (0x470); set them back with the vendor's tool");
    const double torn = static_cast<double>(r_.torn);
    if (r_.torn > 0 && torn > 0.01 * static_cast<double>(r_.samples))
      Error(r_.torn, " of ", r_.samples + r_.torn,
            " joint samples were torn (one of their three frames was lost): check cable, "
            "terminators and the load of the bus");
    if (r_.age.p99_s > kOldAge_s)
      Error(
          absl::StrFormat("the newest joint sample is often old (99 %%: %.0f ms): robot_client "
                          "holds at %.0f ms; is this machine or the bus overloaded?",
                          1e3 * r_.age.p99_s, 1e3 * kOldAge_s));
    else if (r_.age.worst_s > kOldAge_s)
      Warn(absl::StrFormat("once no joint sample came for %.0f ms: robot_client would have held",
                           1e3 * r_.age.worst_s));
  }

  void Status() {
    if (r_.unknown_status)
      Error("the arm reports a status that is not known: control mode ", (*r_.unknown_status)[0],
            ", code ", (*r_.unknown_status)[1], "; robot_client does not run beside it");
    if (!r_.status || r_.status_age_s > kStatusAge_s) {
      if (!r_.unknown_status && !Leader())
        Error("the arm's status (0x2A1) does not come; power it off and on");
      return;
    }
    const ArmStatus& s = *r_.status;
    if (s.code != StatusCode::kNormal) Error("status: ", WordsOf(s.code), StatusRemedy(s.code));
    if (s.control == ControlMode::kTeach || s.teach != 0)
      Error("the arm is being taught (control mode '", WordsOf(s.control), "', teaching '",
            TeachWords(s.teach), "'): end it with the button on the arm");
    else if (s.control != ControlMode::kStandby && s.control != ControlMode::kCan)
      Error("the arm takes its commands from elsewhere: control mode '", WordsOf(s.control),
            "'; set it to CAN with the vendor's tool");
    for (int j = 0; j < kJoints; ++j) {
      if (s.joint_bus >> j & 1)
        Error("J", j + 1,
              " does not answer the arm's controller: check the cable inside the arm, "
              "power it off and on");
      if (s.joint_limit >> j & 1)
        Error("J", j + 1,
              " stands at or beyond its limit: move it back by hand, with the power off "
              "and the arm supported");
    }
  }

  static std::string StatusRemedy(StatusCode code) {
    switch (code) {
      case StatusCode::kEmergencyStop:
        return "; support the arm, then `robot_client`, `quit limp`, which lets it fall, or cut "
               "its power";
      case StatusCode::kTargetLimit:
        return "; a target within the limits ends it";
      case StatusCode::kCollision:
        return "; free the arm, then cut its power and give it again: it falls, support it";
      default:
        return "; power the arm off and on (it falls: support it)";
    }
  }

  void Drivers() {
    std::vector<std::string> off, missing;
    std::vector<double> supplies;
    for (int j = 0; j < kJoints; ++j) {
      const std::string name = absl::StrCat("J", j + 1);
      const std::optional<DriverStatus>& driver = r_.joints[j].driver;
      if (!driver || r_.joints[j].driver_age_s > kStatusAge_s) {
        missing.push_back(name);
        continue;
      }
      supplies.push_back(driver->supply_V);
      if (!(driver->bits & kEnabled)) off.push_back(name);
      if (const std::string words = DriverFaultWords(driver->bits); !words.empty())
        Error(name, "'s driver reports: ", words,
              "; support the arm and power it off and on, let a hot motor cool first");
    }
    if (!missing.empty())
      Error("no report of the driver of ", absl::StrJoin(missing, ", "),
            " (0x261 to 0x266): no power on it, or its cable is loose");
    if (!off.empty() && off.size() + missing.size() < kJoints)
      Error("only some joints have power; without it: ", absl::StrJoin(off, ", "),
            ". These can fall: support the arm; `enable` in robot_client gives it to all");
    Supplies(supplies);
  }

  void Supplies(std::vector<double> supplies) {
    if (supplies.size() < 3) return;
    const double median = UpperMedian(std::move(supplies));
    for (int j = 0; j < kJoints; ++j) {
      const std::optional<DriverStatus>& driver = r_.joints[j].driver;
      if (driver && std::abs(driver->supply_V - median) > kSupplyDifference_V)
        Error(absl::StrFormat("J%d has %.1f V where the others have %.1f V: a loose connector?",
                              j + 1, driver->supply_V, median));
    }
  }

  void Firmware() {
    if (!r_.firmware) {
      if (Asked()) Error("the arm does not say its firmware (no \"S-V\" in the answer to 0x4AF)");
      return;
    }
    if (*r_.firmware < kOldestFirmware)
      Error("firmware ", FirmwareName(*r_.firmware), " is older than ",
            FirmwareName(kOldestFirmware), ": update it with the vendor's tool");
  }

  void Limits() {
    std::vector<std::string> unanswered;
    for (int j = 0; j < kJoints; ++j) {
      const JointReport& joint = r_.joints[j];
      if (!joint.limit || !joint.acceleration) {
        unanswered.push_back(absl::StrCat("J", j + 1));
      } else if (absl::Status fit = CheckJointLimit(*joint.limit, *joint.acceleration); !fit.ok()) {
        Error(std::string(fit.message()));
      }
    }
    if (!unanswered.empty() && Asked())
      Error("no answer about the limits of ", absl::StrJoin(unanswered, ", "),
            " (0x472): power the arm off and on, check the cable to it");
    if (!r_.collision_levels) return;
    std::vector<std::string> zeros;
    for (int j = 0; j < kJoints; ++j) {
      if ((*r_.collision_levels)[j] == 0) zeros.push_back(absl::StrCat("J", j + 1));
    }
    if (!zeros.empty())
      Warn("the arm's own collision protection is off on ", absl::StrJoin(zeros, ", "),
           " (level 0, as delivered): collision_level: 5 in lab.yaml switches it on");
  }

  void Gripper() {
    if (r_.gripper_range == 0.0)
      Error(
          "the gripper's range is not configured (0x47E answers 0 mm), so its opening is not "
          "reported: set 70 or 100 mm once with the vendor's tool");
    if (!r_.gripper) return;
    if (const std::string words = GripperFaultWords(r_.gripper->errors); !words.empty())
      Error("the gripper reports: ", words, "; power the arm off and on");
  }

  void Rates() {
    if (r_.window_s < kRateWindow_s || Leader()) return;
    std::vector<std::string> off;
    for (const FrameCount& report : r_.reports) {
      if (std::abs(report.per_second - report.expected) > kRateTolerance * report.expected)
        off.push_back(
            absl::StrFormat("0x%03X %.0f (%.0f)", report.id, report.per_second, report.expected));
    }
    if (!off.empty())
      Warn("frames per second differ from what a Piper sends (in brackets): ",
           absl::StrJoin(off, ", "));
  }

  const ArmReport& r_;
  std::vector<Finding> findings_;
};

}  // namespace

std::vector<Finding> Diagnose(const ArmReport& report) { return Diagnosis(report).Run(); }

bool HasError(const std::vector<Finding>& findings) {
  return std::any_of(findings.begin(), findings.end(), [](const Finding& f) { return f.error; });
}

std::array<FrameCount, kReports> ExpectedReports() {
  std::array<FrameCount, kReports> reports;
  int count = 0;
  const auto add = [&](int first, int number, double rate) {
    for (int i = 0; i < number; ++i)
      reports[count++] = {static_cast<uint16_t>(first + i), 0, 0, rate, 0};
  };
  add(kArmStatus, 1, 200);
  add(kEndPose, 3, 200);
  add(kJointAngles, 3, 200);
  add(kGripper, 1, 200);
  add(kJointSpeed, kJoints, 200);
  add(kDriver, kJoints, 40);
  return reports;
}

}  // namespace robostress::piper
