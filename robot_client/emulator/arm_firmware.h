#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "robot_client/emulator/arm_settings.h"
#include "robot_client/emulator/joint_planner.h"
#include "robot_client/emulator/other_modes.h"
#include "robot_client/emulator/piper_plant.h"
#include "robot_client/emulator/tool_path.h"
#include "robot_client/piper/firmware.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

struct FirmwareOptions {
  Firmware version = {1, 8, 9};
  double command_lag_s = 0.06;             // from a target's frame to its effect
  double gripper_range = kGripperOpening;  // [m], as configured; 0: never was
  JointVector gravity_feedforward{};       // share of PlantReading::gravity
};

// The main controller and the joints' drivers of a Piper: frames in, motor torques and frames out.
// What is public of the arm's behaviour is followed (docs/results/arm-emulator.md has the
// sources); what is not is marked there as assumed. Holds no MuJoCo and no clock: time is counted
// in steps of PiperPlant::kStep_s.
class ArmFirmware {
 public:
  struct Torques {
    JointVector motor{};      // [Nm]
    double finger_force = 0;  // [N]
  };

  explicit ArmFirmware(const FirmwareOptions& options);

  void Take(const CanFrame& frame);
  // One step: plans, servoes, and watches for stalls.
  Torques Step(const PlantReading& plant);
  // Frames that are due after the last step, replies first. Cleared by the call.
  void TakeReports(const PlantReading& plant, std::vector<CanFrame>& frames);

  // Faults from outside. joint 0 .. 5. They stay until Stop::kReset, silence and joint silence
  // until they are taken back.
  void RaiseDriverFault(int joint, DriverBit bit);
  void RaiseStatus(StatusCode code);                 // latched arm status, for example kCollision
  void SetJointSilent(int joint, bool silent);       // the joint no longer answers the controller
  void SetSilent(bool silent) { silent_ = silent; }  // no frames at all
  // The button on the arm: in teaching mode the joints have power, carry the arm's weight and take
  // no motion commands; afterwards they hold where they are, in standby.
  void SetTeaching(bool teaching);
  // As 0x470 does it: see ArmSettings::leader.
  void SetLeader();
  // Nothing holds the arm: a person may guide it.
  bool limp() const { return teaching_ || settings_.leader(); }
  void SetLimit(const JointLimit& limit) { settings_.SetLimit(limit); }

  bool enabled(int joint) const { return power_[joint].enabled; }
  const ArmStatus& status() const { return status_; }

 private:
  struct Power {
    bool enabled = false;
    int deaf = 0;  // enable frames that still go unheard
    uint8_t fault_bits = 0;
    bool silent = false;
    double stalled_s = 0;
    double integral = 0;  // of the servo [Nm]
  };
  struct Delayed {
    uint64_t due_step;
    CanFrame frame;
  };
  void TakeStop(Stop stop);
  void TakePower(const MotorPower& power);
  void TakeLimitQuery(const LimitQuery& query);
  void TakeJointConfig(const CanFrame& frame);
  bool SetZero(int motor);
  void ApplyTarget(const CanFrame& frame);
  void ApplyJointTargets(const JointPair& pair);
  void ApplyPoseTarget(const JointPair& pair);
  void ApplyArcPoint(int point);
  std::array<Range, kJoints> Limits() const;
  ToolTarget PlannedTool() const;
  void FollowPath();
  PlantReading InOwnZeros(PlantReading reading) const;
  double MaxSpeed(int joint) const;  // [rad/s]
  double ServoTorque(int joint, const PlantReading& reading);
  void WatchStall(int joint, double torque, const PlantReading& reading);
  double FingerForce(const PlantReading& reading) const;
  void UpdateStatus(const PlantReading& reading);
  void ReportFast(const PlantReading& reading, std::vector<CanFrame>& frames) const;
  void ReportState(const PlantReading& reading, std::vector<CanFrame>& frames) const;
  void CommandFollower(const PlantReading& reading, std::vector<CanFrame>& frames) const;
  void ReportDrivers(std::vector<CanFrame>& frames) const;

  const FirmwareOptions options_;
  uint64_t step_ = 0;
  std::array<Power, kJoints> power_;
  ArmSettings settings_;
  JointVector zero_{};       // of the joints, in the plant's angles [rad]
  double gripper_zero_ = 0;  // [m]
  std::array<JointPlanner, kJoints> planners_;
  std::array<bool, kJoints> beyond_limit_{};
  std::array<double, 6> pose_target_{};  // x y z [m], roll pitch yaw [rad], as far as received
  bool pose_unreachable_ = false;
  ToolPath path_;  // move modes L and C
  // The arc waits until the joints have brought the tool to its start.
  std::array<ToolTarget, 3> arc_points_;
  bool arc_waits_ = false;
  int last_arc_point_ = 0;
  std::optional<ToolTarget> line_goal_;  // of the present line, sent again and again by a stream
  std::array<std::optional<MitTarget>, kJoints> mit_;
  std::deque<Delayed> delayed_;
  ModeControl mode_;
  ArmStatus status_;
  StatusCode latched_ = StatusCode::kNormal;
  bool stopped_ = false;  // quick stop
  bool silent_ = false;
  bool teaching_ = false;
  GripperTarget gripper_target_;
  bool gripper_enabled_ = false;
  std::vector<CanFrame> replies_;
  PlantReading last_;
};

}  // namespace robostress::piper
