#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/arm_model.h"
#include "robot_client/bridge/arm_chain.h"
#include "robot_client/bridge/protocol.h"
#include "robot_client/robot_arm.h"

namespace robostress::bridge {

// How a driver's numbers become ours: ours = zero + scale * the driver's.
struct Conversion {
  double scale = 1;
  double zero = 0;
  double Ours(double drivers) const { return zero + scale * drivers; }
  double Drivers(double ours) const { return (ours - zero) / scale; }
};

enum class AxisUnit { kRadians, kDegrees, kMetres, kRange };

// An axis as its robot file describes it.
struct AxisOptions {
  std::string name;                    // as the driver calls it
  AxisUnit unit = AxisUnit::kRadians;  // of the driver's numbers
  double sign = 1;                     // -1: the driver counts the other way round
  double zero = 0;                     // [rad], [m] where the driver says 0
  std::vector<double> driver_range;    // with unit range: two of the driver's numbers ...
  std::vector<double> range;           // ... and what they are [rad], [m]
  double lower = 0, upper = 0;         // what the axis may be told [rad], [m]
  double velocity = 0;                 // at most [rad/s], [m/s]
  double acceleration = 0;             // [rad/s^2], [m/s^2]
  double press = 0;                    // [Nm] beyond the model that is pressing; 0: not said

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "as the driver calls the axis");
    v.Choice("unit", unit,
             {{"radians", AxisUnit::kRadians},
              {"degrees", AxisUnit::kDegrees},
              {"metres", AxisUnit::kMetres},
              {"range", AxisUnit::kRange}},
             "of the driver's numbers");
    v.Field("sign", sign, "-1: the driver counts the other way round");
    v.Field("zero", zero, "where the driver says 0 [rad], [m]");
    v.Field("driver_range", driver_range, "with unit range: two of the driver's numbers ...");
    v.Field("range", range, "... and what they are [rad], [m]");
    v.Field("lower", lower, "lowest that the axis is told [rad], [m]");
    v.Field("upper", upper, "highest [rad], [m]");
    v.Field("velocity", velocity, "most speed [rad/s], [m/s]");
    v.Field("acceleration", acceleration, "[rad/s^2], [m/s^2]");
    v.Field("press", press, "torque beyond the model that is pressing [Nm]");
  }
};

// What a driver must be able to do for this robot; a driver that says less is refused.
struct ExpectedDriver {
  bool stop = false;
  bool hold = true;
  bool torque_off = false;
  bool measures_velocity = false;
  bool measures_effort = false;
  bool on_silence = true;   // it holds, stops or takes the power off when this client is silent
  double watchdog_s = 0.5;  // ... after at most so long [s]

  template <class V>
  void Visit(V& v) {
    v.Field("stop", stop, "it has a stop that is more than holding");
    v.Field("hold", hold, "the arm keeps its place when no target comes");
    v.Field("torque_off", torque_off, "it can take the power off");
    v.Field("measures_velocity", measures_velocity, "it measures velocities");
    v.Field("measures_effort", measures_effort, "it measures torques [Nm]");
    v.Field("on_silence", on_silence, "it does something when the client is silent");
    v.Field("watchdog_s", watchdog_s, "... after at most so long [s]");
  }
};

// An arm behind a driver process: a robot file, as so101.yaml. Seven joints and a gripper at most.
struct BridgeRobot {
  std::string name;
  double rate_hz = 30;              // of the control loop
  std::vector<AxisOptions> joints;  // from the base on
  std::optional<AxisOptions> gripper;
  std::vector<double> home;  // a number per joint [rad], then the gripper [m]; empty: none
  ExpectedDriver driver;
  bool simulated = false;  // no arm that can hurt anybody
  std::optional<ModelOptions> model;
  WorkspaceOptions workspace;  // with a model; where no configuration says otherwise

  // Of what was read:
  ArmLimits limits;
  std::vector<Conversion> conversions;  // by place on the wire
  std::optional<ArmChain> chain;        // what LoadBridgeRobot read of the model

  // Torques are watched: there is a model, and the driver must measure them.
  bool watches_torque() const { return model && driver.measures_effort; }

  std::vector<std::string> names() const;  // joints, then the gripper
};

// INVALID_ARGUMENT names file, field, value and what it must be; NOT_FOUND: no such file. Load
// reads the model too, Parse opens no file.
absl::StatusOr<BridgeRobot> LoadBridgeRobot(const std::string& file);
absl::StatusOr<BridgeRobot> ParseBridgeRobot(const std::string& file, const std::string& yaml);
// Chooses what of a loaded model is watched, for the workspace and the home that are in force;
// nothing without a model. INVALID_ARGUMENT names a height that leaves nothing, value and remedy.
absl::Status ChooseWatched(const WorkspaceOptions& workspace, const std::vector<double>& home,
                           BridgeRobot& robot);

// What `expected` asks for and `welcome` does not have, in words; empty: nothing.
std::string Missing(const ExpectedDriver& expected, const Welcome& welcome);

}  // namespace robostress::bridge
