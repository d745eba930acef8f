#pragma once

#include <memory>
#include <vector>

#include "calibration/model/joint_model.h"
#include "common/joint_errors/joint_chain.h"

namespace robostress::calibration {

// The chain of one joint as its model has it, with what fits ask of one. `model` outlives it.
class EffectChain {
 public:
  explicit EffectChain(const JointModel& model);
  // With the same hidden states.
  EffectChain Copy() const;

  absl::Span<const JointChain::Link> stage(EffectStage s) const { return chain_.effects(s); }
  // Drive, joint and transmission stage.
  void Reset(const JointMoment& moment);
  double Drive(double torque, const JointMoment& moment) const;
  // Its derivative by the torque asked for: 0 beyond a limit.
  double DriveSlope(double torque, const JointMoment& moment) const;
  // The torque asked of the motor where it makes `torque` (JointEffect::Asked).
  double Asked(double torque, double asked, const JointMoment& moment) const;
  // Link angle minus motor angle [rad].
  double Offset(const JointMoment& moment);
  double Reading(double q_link) const;
  // The link angle of a reading.
  double LinkOf(double reading) const;
  // The offset where the motor has turned on to `q`, `later` [s] after the last Offset.
  double OffsetAt(double q, double later = 0) const;
  // The motor's angle of a link angle, its state as at the last Offset, and what a link's velocity
  // is there of the motor's.
  double MotorOf(double q_link) const;
  double SpeedRatio(double q_motor) const;

  bool has_gap() const { return !gaps_.empty(); }
  // Whether the offset depends on where the motor is, and on nothing before.
  bool has_wave() const { return !waves_.empty(); }
  // Whether a state depends on a way that was gone long ago.
  bool remembers_way() const { return has_gap() || !with_memory.empty(); }
  // Whether a motor that moves with `dq` from where it was at the last Offset does not move the
  // link: it is within a backlash or turns away from the side that it pushed.
  bool MovesAlone(double dq) const { return has_gap() && side_ * dq <= 0; }

  std::vector<JointEffect*> with_memory, memoryless;  // of the joint stage
  std::vector<JointEffect*> of_drive;                 // those of both that read the motor's torque
  bool needs_payload = false, needs_tilt = false, has_state = false, oscillates = false;
  int partner = -1;
  bool at_rows = false;  // accelerations are those at a row and not until the next one

 private:
  struct Gap {
    const JointEffect* effect;
    double half_width;             // [rad]
    double motor = 0, offset = 0;  // [rad] at the last Offset
  };
  EffectChain(const JointModel& model, JointChain chain);
  double WavesAt(double q) const;

  const JointModel& model_;
  JointChain chain_;
  std::vector<Gap> gaps_;
  std::vector<JointEffect*> waves_;  // of the transmission, without a state
  double of_states_ = 0;             // the others' part of the last Offset [rad]
  double drift_ = 0;                 // of that part, where it oscillates [rad/s]
  double position_offset_ = 0;
  int side_ = 0;  // that the motor pushes: forwards 1, backwards -1; 0: within the gap
};

}  // namespace robostress::calibration
