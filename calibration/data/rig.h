#pragma once

#include <array>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::calibration {

// What a joint's logs drive and what is compared.
enum class JointInput {
  kPositionTarget,  // q_cmd_<joint> drives the declared servo; q_<joint> is compared
  kTorque,          // tau_<joint> drives the joint; q_<joint> is compared
  kInverse,         // tau_<joint> is predicted from the measured motion q_<joint>
  kTransmission,    // q_link_<joint> is predicted from q_motor_<joint> (and tau_<joint>)
};

// The side of the transmission that the servo reads.
enum class ServoFeedback { kLink, kMotor };

// The side of the transmission whose velocity dq_<joint> is.
enum class VelocitySide {
  kReading,  // of q_<joint>: taken where the data show that it is its derivative
  kMotor,    // of the motor: taken as it is; a gap or a spring may lie between it and q_<joint>
};

struct Servo {
  enum class Type {
    kPd,       // torque = kp (q_cmd - q) - kd dq, within torque_limit
    kDcMotor,  // V = kp (q_cmd - q) within vin; torque = kt / R (V - kt dq)
  };
  Type type = Type::kPd;
  double kp = 0;                                                  // [Nm/rad]; of a DC motor [V/rad]
  double kd = 0;                                                  // [Nm s/rad]
  double torque_limit = std::numeric_limits<double>::infinity();  // [Nm]
  double kt = 0;                                                  // [Nm/A]
  double R = 0;                                                   // [ohm]
  double vin = 0;                                                 // [V]
  ServoFeedback feedback = ServoFeedback::kLink;
};

// An effect that the declared model has.
struct DeclaredEffect {
  std::string type;                          // of the effect library
  std::map<std::string, double> parameters;  // what is not listed has the library's start
  std::vector<std::string> fit;              // parameters that are estimated
  std::string partner;                       // of a coupled effect: the joint that it reads
};

struct RigJoint {
  std::string name;
  JointInput input = JointInput::kPositionTarget;
  VelocitySide velocity = VelocitySide::kReading;
  Servo servo;
  std::string enable;  // column that is 0 where the drive is off; empty: always on
  // Values of ModelParameterNames() that differ from the model's, or have none there.
  std::map<std::string, double> parameters;
  std::vector<std::string> fit;  // of ModelParameterNames(), and command_shift, force_lag
  std::vector<DeclaredEffect> effects;
};

enum class LogRole { kFit, kHeldOut, kTransfer };

struct RigLog {
  std::string file;  // resolved
  LogRole role = LogRole::kFit;
  std::string condition;
  // What differed in this run: "<joint>.servo.kp", "<joint>.<model parameter>",
  // "<joint>.<effect>.<parameter>", "<joint>.known_mass" [kg] at the payload's place.
  std::map<std::string, double> overrides;
};

inline constexpr char kKnownMass[] = "known_mass";

enum class Folds { kAuto, kCondition, kLog, kBlock };

// The error that is reported.
struct Metric {
  enum class Type { kRms, kMeanAbsolute };
  Type type = Type::kRms;
  double window_s = 0.5;  // free runs are restarted every so often; 0: the whole log
  std::string unit;       // "rad", "m", "mm", "mdeg" ...; empty: the joint's own
};

// A rig file (../shared design, "The measured-data loop"): a model, what is known of its joints,
// and logs.
struct Rig {
  std::string file;
  std::string name;
  std::string model;  // MJCF or URDF, resolved
  // In the frame of the model's base [m/s^2], of an arm that is not mounted upright; else the
  // model's own, of a URDF 0 0 -9.81.
  std::optional<std::array<double, 3>> gravity;
  double rate_hz = 0;
  std::vector<RigJoint> joints;
  std::vector<RigLog> logs;
  Metric metric;
  Folds folds = Folds::kAuto;
};

// Parameters of the declared model that `fit` may name beside those of effects.
const std::vector<std::string>& ModelParameterNames();

// Errors name file, key path, value and what is allowed. File names may hold environment variables,
// as in ${ROBOSTRESS_MEASURED_DATA}/log.csv.
enum class RigLogs { kNeeded, kNone };  // kNone: a rig that nothing was recorded of yet is one
absl::StatusOr<Rig> ReadRig(const std::string& file, RigLogs logs = RigLogs::kNeeded);
std::string WriteRig(const Rig& rig);
// `path` as a file in `folder` names it. A folder that is reached by a link has other parents than
// its name says.
std::string RelativePath(const std::string& path, const std::string& folder);
// "new.csv,elbow.known_mass=0.3": a log to fit beside those of `rig`, its file as the caller's
// folder has it, and its overrides. Errors name what is wrong and what is allowed.
absl::StatusOr<RigLog> ParseRigLog(const std::string& text, const Rig& rig);

}  // namespace robostress::calibration
