#pragma once

#include <array>
#include <vector>

#include "robot_client/arm_model.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// When an arm presses against something.
struct PressOptions {
  // [Nm] per joint, beyond what the model explains
  std::vector<double> excess = {6, 6, 6, 2.5, 2.5, 2.5};
  double excess_s = 0.1;    // for as long as this, or twice as much at once: the arm presses
  double payload_kg = 0.5;  // the heaviest thing that it may carry
  std::vector<double> friction = {0, 0, 0, 0, 0, 0};  // [Nm] of `robostress calibrate`
  std::vector<double> viscous = {0, 0, 0, 0, 0, 0};   // [Nm s/rad]
  double blocked_error = 0.06;   // [rad] a joint that is this far off its command ...
  double blocked_s = 0.6;        // ... most of this time ...
  double blocked_travel = 0.01;  // [rad] ... and moves no further than this is blocked

  template <class V>
  void Visit(V& v) {
    v.Field("excess", excess, "torque per joint beyond model and friction that is pressing [Nm]");
    v.Field("excess_s", excess_s, "for as long as this; twice the torque at once [s]");
    v.Field("payload_kg", payload_kg, "the heaviest thing that the gripper may carry [kg]");
    v.Field("friction", friction, "Coulomb friction per joint, from a calibration [Nm]");
    v.Field("viscous", viscous, "viscous friction per joint, from a calibration [Nm s/rad]");
    v.Field("blocked_error", blocked_error, "a joint this far off its command [rad] ...");
    v.Field("blocked_s", blocked_s, "... for most of this time [s] ...");
    v.Field("blocked_travel", blocked_travel,
            "... that moves no further than this is blocked [rad]");
  }
};

// The defaults are those of six joints: what still has them gets `joints` values, the last repeated
// or left out. What a person gave stays as it is.
void FitDefaults(int joints, PressOptions& options);

// Tells pressing from moving by the joints' torques and by where they get to. The first needs a
// model, and an arm that reports torques. Allocates nothing after construction. One thread.
class PressWatch {
 public:
  // `model` may be null. The options' vectors have `joints` values.
  PressWatch(const PressOptions& options, double period_s, const ArmModel* model, int joints);

  void Reset();
  // One tick with a fresh sample; `command`: the last one sent.
  void Take(const ArmSnapshot& arm, const ArmVector& command);

  // Torque [Nm] beyond what model, payload and friction explain, of the last sample; 0 where it
  // explains all.
  const ArmVector& excess() const { return excess_; }
  // By how much of its limit a joint's torque is beyond the model now, with its sign.
  double share(int joint) const { return excess_[joint] / options_.excess[joint]; }
  bool pressing() const { return pressing_; }  // for long enough
  bool blocked() const { return blocked_; }

 private:
  void WatchTorque(const ArmSnapshot& arm);
  void WatchTravel(const ArmSnapshot& arm, const ArmVector& command);

  static constexpr int kMostTicks = 1000;
  struct Tick {
    std::array<bool, kMostJoints> off{};
    std::array<double, kMostJoints> position{};
  };

  const PressOptions options_;
  const double period_s_;
  const ArmModel* const model_;
  const int joints_;
  ArmVector excess_{};
  double strained_s_ = 0;
  bool pressing_ = false, blocked_ = false;
  ArmVector last_velocity_{};
  int64_t last_stamp_ns_ = 0;  // 0: none
  std::vector<Tick> window_;
  int seen_ = 0;  // ticks in the window
  int next_ = 0;
};

}  // namespace robostress
