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
  // The torque asked of the motor where it makes `torque` (JointEffect::Asked).
  double Asked(double torque, double asked, const JointMoment& moment) const;
  // Link angle minus motor angle [rad].
  double Offset(const JointMoment& moment);
  double Reading(double q_link) const;
  // The link angle of a reading.
  double LinkOf(double reading) const;

  bool has_gap() const { return !gaps_.empty(); }
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
    double half_width;  // [rad]
  };
  EffectChain(const JointModel& model, JointChain chain);

  const JointModel& model_;
  JointChain chain_;
  std::vector<Gap> gaps_;
  double position_offset_ = 0;
  int side_ = 0;  // that the motor pushes: forwards 1, backwards -1; 0: within the gap
};

}  // namespace robostress::calibration
