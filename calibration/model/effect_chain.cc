#include "calibration/model/effect_chain.h"

#include <algorithm>
#include <cmath>

namespace robostress::calibration {

namespace {

std::vector<std::unique_ptr<JointEffect>> MakeEffects(const JointModel& model) {
  std::vector<std::unique_ptr<JointEffect>> objects;
  for (const EffectInstance& effect : model.effects) {
    objects.push_back(effect.info->make());
    objects.back()->SetParameters(effect.values);
  }
  return objects;
}

}  // namespace

EffectChain::EffectChain(const JointModel& model) : EffectChain(model, MakeEffects(model)) {}

EffectChain::EffectChain(const JointModel& model, std::vector<std::unique_ptr<JointEffect>> objects)
    : model_(model), objects_(std::move(objects)), position_offset_(model.position_offset) {
  for (size_t i = 0; i < objects_.size(); ++i) {
    const EffectInstance& effect = model.effects[i];
    JointEffect* object = objects_[i].get();
    by_stage_[static_cast<int>(effect.info->stage)].push_back(object);
    needs_payload |= effect.info->type == "payload";
    needs_tilt |= effect.info->type == "base_tilt";
    has_state |= object->HasState();
    oscillates |= effect.info->type == "compliance";
    if (effect.info->type == "backlash") gaps_.push_back({object, effect.values[0]});
    if (effect.info->stage == EffectStage::kJoint)
      (object->HasState() ? with_memory : memoryless).push_back(object);
    if (effect.partner >= 0) partner = effect.partner;
  }
}

EffectChain EffectChain::Copy() const {
  std::vector<std::unique_ptr<JointEffect>> objects;
  for (const std::unique_ptr<JointEffect>& object : objects_) objects.push_back(object->Clone());
  EffectChain copy(model_, std::move(objects));
  copy.side_ = side_;
  return copy;
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
