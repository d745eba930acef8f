#include "calibration/effect_chain.h"

#include <algorithm>
#include <cmath>

namespace robostress::calibration {

EffectChain::EffectChain(const JointModel& model) : position_offset_(model.position_offset) {
  for (const EffectInstance& effect : model.effects) {
    objects_.push_back(effect.info->make());
    JointEffect* object = objects_.back().get();
    object->SetParameters(effect.values);
    by_stage_[static_cast<int>(effect.info->stage)].push_back(object);
    needs_payload |= effect.info->type == "payload";
    needs_tilt |= effect.info->type == "base_tilt";
    has_state |= object->HasState();
    if (effect.info->type == "backlash") gaps_.push_back({object, effect.values[0]});
    if (effect.info->stage == EffectStage::kJoint)
      (object->HasState() ? with_memory : memoryless).push_back(object);
    if (effect.partner >= 0) partner = effect.partner;
  }
}

void EffectChain::Reset(const JointMoment& moment) {
  for (EffectStage s : {EffectStage::kDrive, EffectStage::kJoint, EffectStage::kTransmission})
    for (JointEffect* effect : stage(s)) effect->Reset(moment);
  side_ = 0;
}

double EffectChain::Drive(double torque, const JointMoment& moment) const {
  for (JointEffect* effect : stage(EffectStage::kDrive)) torque = effect->Drive(torque, moment);
  return torque;
}

double EffectChain::Offset(const JointMoment& moment) {
  double sum = 0;
  for (JointEffect* effect : stage(EffectStage::kTransmission)) {
    const double part = effect->Offset(moment);
    sum += part;
    for (const Gap& gap : gaps_) {
      if (gap.effect != effect) continue;
      side_ = std::abs(part) < (1 - 1e-9) * gap.half_width ? 0 : part < 0 ? 1 : -1;
    }
  }
  return sum;
}

double EffectChain::Reading(double q_link) const {
  for (JointEffect* effect : stage(EffectStage::kSensor)) q_link = effect->Reading(q_link);
  return q_link + position_offset_;
}

double EffectChain::LinkOf(double reading) const {
  const double at_zero = Reading(0);
  return (reading - at_zero) / (Reading(1) - at_zero);
}

}  // namespace robostress::calibration
