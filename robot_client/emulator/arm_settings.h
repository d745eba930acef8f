#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// Limits of the tool's motion in move modes L and C, as delivered.
struct ToolLimits {
  double velocity = 0.5;              // [m/s]
  double angular_velocity = 1.5;      // [rad/s]
  double acceleration = 0.8;          // [m/s^2]
  double angular_acceleration = 2.0;  // [rad/s^2]
};

// What a Piper keeps in its flash, and the frames that write it and ask for it: 0x470, 0x474, 0x475
// (acceleration), 0x477, 0x479, 0x47A, 0x47D. Every write is acknowledged with 0x476.
class ArmSettings {
 public:
  explicit ArmSettings(double gripper_range);  // [m]; 0: never configured

  // False for a frame that is none of these.
  bool Take(const CanFrame& frame, std::vector<CanFrame>& replies);

  const JointLimit& limit(int joint) const { return limits_[joint]; }
  void SetLimit(const JointLimit& limit) { limits_[limit.joint] = limit; }
  double acceleration(int joint) const { return accelerations_[joint]; }  // [rad/s^2]
  const ToolLimits& tool() const { return tool_; }
  double gripper_range() const { return gripper_range_; }  // [m]

  // Leader ("teaching input arm"): the arm commands others and falls silent itself.
  bool leader() const { return leader_; }
  void SetLeader(bool leader) { leader_ = leader; }
  // What is added to the identifiers of its feedback (0x2Ax), of the commands that it obeys (0x15x)
  // and of those that it sends as a leader: 0, 0x10 or 0x20.
  uint16_t feedback_offset() const { return offsets_[0]; }
  uint16_t command_offset() const { return offsets_[1]; }
  uint16_t leader_offset() const { return offsets_[2]; }

 private:
  void Restore();  // limits, speeds and accelerations of the joints as delivered
  void TakeLimits(const CanFrame& frame);
  void TakeAcceleration(const CanFrame& frame);
  void TakeParameters(const CanFrame& frame, std::vector<CanFrame>& replies);
  void TakeToolLimits(const CanFrame& frame);
  void TakeRole(const CanFrame& frame);
  void Answer(int query, std::vector<CanFrame>& replies) const;

  std::array<JointLimit, kJoints> limits_;
  JointVector accelerations_{};
  ToolLimits tool_;
  std::array<uint8_t, kJoints> collision_levels_{};  // protection off, as delivered
  uint8_t teaching_range_ = 100, teaching_friction_ = 1;
  double gripper_range_;
  bool leader_ = false;
  std::array<uint16_t, 3> offsets_{};
};

}  // namespace robostress::piper
