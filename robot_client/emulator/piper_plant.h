#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <array>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/joint_errors/joint_chain.h"
#include "robot_client/emulator/wear_profile.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// What the arm's controller knows of its mechanics.
struct PlantReading {
  JointVector q{}, dq{};     // encoders at the joints [rad], [rad/s]
  JointVector gravity{};     // torque that holds the unloaded arm [Nm], the controller's model
  JointVector torque{};      // of the motors over the last step [Nm]
  double opening = 0;        // between the fingers [m]
  double opening_speed = 0;  // [m/s]
  double grip_force = 0;     // of each finger's drive [N], positive opens
};

// The arm's mechanics in MuJoCo, with the profile's execution errors: per step of kStep_s the
// torque stage of the motors (drive effects, friction as true stiction, loads), MuJoCo, then the
// position stage (backlash and compliance move the joint coordinates). The joint coordinate is the
// link's, and so is what the encoders read, up to the profile's sensor effects, unless it puts them
// on the motors.
class PiperPlant {
 public:
  static constexpr double kStep_s = 0.001;

  // `scene_xml` holds the names of piper_mjcf.h.
  static absl::StatusOr<std::unique_ptr<PiperPlant>> Create(const std::string& scene_xml,
                                                            const WearProfile& profile);
  // At rest at q [rad], fingers `opening` [m] apart, transmissions settled under gravity.
  void Reset(const JointVector& q, double opening);
  // Lying on its rest, as an arm does at power-on: the joints resist as if supported.
  void SetParked(bool parked) { parked_ = parked; }
  // What somebody does to the joints from outside [Nm] and to each finger [N], from now on.
  void Push(const JointVector& torque, double finger_force) {
    push_ = torque;
    finger_push_ = finger_force;
  }
  // One step under the motors' torques [Nm], within their limits, and the fingers' force [N].
  void Step(const JointVector& motor_torque, double finger_force);

  const PlantReading& reading() const { return reading_; }
  // Link angles without sensor effects [rad].
  JointVector link_angles() const;
  const mjModel& model() const { return *model_; }
  mjData& data() { return *data_; }
  const mjData& data() const { return *data_; }

 private:
  using Vector6 = Eigen::Matrix<double, kJoints, 1>;
  struct Free {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
    void operator()(mjData* data) const { mj_deleteData(data); }
  };
  PiperPlant() = default;
  absl::Status FindNames();
  Vector6 HoldingTorque(bool with_payload) const;
  std::array<JointMoment, kJoints> DescribeJoints() const;
  struct ChainPlant;
  void Read();

  std::unique_ptr<mjModel, Free> model_;
  std::unique_ptr<mjData, Free> data_;
  std::array<int, kJoints> joint_{}, qpos_{}, dof_{};
  std::array<int, 2> finger_qpos_{}, finger_dof_{};
  int payload_ = -1;  // body, -1 without one
  bool parked_ = false, motor_encoders_ = false;
  JointVector push_{};  // from outside
  double finger_push_ = 0;
  JointChain chain_{kJoints};
  PlantReading reading_;
};

}  // namespace robostress::piper
