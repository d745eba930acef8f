#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "robot_client/can/can_bus.h"
#include "robot_client/piper/age_statistics.h"
#include "robot_client/piper/firmware.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// What a monitor knows of one joint; nothing where the arm has not said it.
struct JointReport {
  std::optional<double> angle;       // [rad]
  std::optional<JointSpeed> motion;  // [rad/s], [A] as the arm reports it
  double torque = 0;                 // [Nm], from the current
  std::optional<double> target;      // [rad], of the last command of another sender
  std::optional<DriverStatus> driver;
  double driver_age_s = 0;  // of its last report
  std::optional<JointLimit> limit;
  std::optional<JointAcceleration> acceleration;
};

// Frames of one identifier.
struct FrameCount {
  uint16_t id = 0;
  uint64_t total = 0;     // since the monitor began
  double per_second = 0;  // over the report's window
  double expected = 0;    // per second; 0: only as an answer
  double last_s = 0;      // since the last one
};

// One kind of command that somebody else sends, by identifier.
struct OtherSender {
  std::vector<FrameCount> commands;
  uint64_t frames = 0;            // all of them
  double last_s = 0;              // since the last one
  double targets_per_second = 0;  // of 0x155, over the window
  bool commands_now = false;      // within the last second
};

struct QuestionReport {
  int questions = 0, answered = 0;  // different ones
  uint64_t asked = 0, answers = 0;  // frames, repeated ones with them
  double mean_s = 0, worst_s = 0;   // from a question to its answer
  bool silent = false;              // nothing is asked: --silent
  bool waits = false;               // nothing is asked while another program commands
};

// Everything that can be seen of an arm without moving or writing anything, at one moment.
struct ArmReport {
  std::string bus;
  CanHealth health;
  double seconds = 0;   // since the monitor began
  double window_s = 0;  // that rates and ages are of
  uint64_t frames = 0;  // of an arm, since the monitor began

  std::array<JointReport, kJoints> joints;
  std::optional<ArmStatus> status;                       // the last one that is understood
  std::optional<std::array<uint8_t, 2>> unknown_status;  // control mode and code of a newer one
  double status_age_s = 0;
  std::optional<GripperStatus> gripper;
  std::optional<double> gripper_range;  // [m]
  std::optional<std::array<int, kJoints>> collision_levels;
  std::optional<Firmware> firmware;

  std::vector<FrameCount> reports;  // that a Piper sends by itself, in order, also those missing
  std::vector<FrameCount> unknown;  // identifiers that no Piper sends
  uint64_t samples = 0, torn = 0;   // since the monitor began
  double samples_per_second = 0;
  AgeStatistics::Summary age;  // of the newest complete sample, over the window
  double sample_age_s = 0;     // of the newest one now; 0: there is none
  double worst_age_s = 0;      // since the monitor began

  OtherSender other;
  QuestionReport questions;
};

// Something that a person should know. An error: robot_client would refuse this arm, or it will not
// run well on it. A warning may be meant so.
struct Finding {
  bool error = true;
  std::string text;  // what, and what to do
};

// Errors first. An arm that says nothing has one finding, the likely causes.
std::vector<Finding> Diagnose(const ArmReport& report);
bool HasError(const std::vector<Finding>& findings);

// Reports that a Piper sends by itself: 14 identifiers at 200 per second and six at 40.
inline constexpr int kReports = 20;
std::array<FrameCount, kReports> ExpectedReports();

}  // namespace robostress::piper
