#include "common/joint_errors/effect_stack.h"

#include "common/check.h"
#include "common/joint_errors/effects/effect_library.h"

namespace robostress {

EffectStack& EffectStack::operator=(const EffectStack& other) {
  if (this == &other) return *this;
  effects_.clear();
  for (const Entry& entry : other.effects_)
    effects_.push_back({entry.joint, entry.stage, entry.effect->Clone()});
  has_ = other.has_;
  coupled_ = other.coupled_;
  offset_ = other.offset_;
  return *this;
}

void EffectStack::SetScenario(const Scenario& scenario) {
  effects_.clear();
  has_.fill(false);
  coupled_.fill(-1);
  offset_.setZero();
  for (const ScenarioEffect& listed : scenario.effects) {
    const auto info = FindEffect(listed.type);
    RS_CHECK(info.ok() && listed.joint >= 0 && listed.joint < kJoints &&
             listed.values.size() == (*info)->parameters.size());
    Entry entry{listed.joint, (*info)->stage, (*info)->make()};
    entry.effect->SetParameters(listed.values);
    has_[static_cast<int>(entry.stage)] = true;
    if (listed.coupled >= 0) coupled_[listed.joint] = listed.coupled;
    effects_.push_back(std::move(entry));
  }
}

void EffectStack::Reset(Moments moments) {
  for (Entry& entry : effects_) entry.effect->Reset(moments[entry.joint]);
  offset_.setZero();
  if (!has(EffectStage::kTransmission)) return;
  SumOffsets(moments);
  // Once more from the motor's side of that deflection.
  for (int j = 0; j < kJoints; ++j) moments[j].q -= offset_[j];
  for (Entry& entry : effects_) entry.effect->Reset(moments[entry.joint]);
  SumOffsets(moments);
}

EffectStack::Vector EffectStack::Drive(const Vector& asked, Moments& moments) {
  Vector torque = asked;
  for (const EffectStage stage : {EffectStage::kCommand, EffectStage::kDrive}) {
    if (!has(stage)) continue;
    for (Entry& entry : effects_) {
      if (entry.stage != stage) continue;
      double& value = torque[entry.joint];
      const JointMoment& moment = moments[entry.joint];
      value = stage == EffectStage::kCommand ? entry.effect->Command(value, moment)
                                             : entry.effect->Drive(value, moment);
    }
  }
  for (int j = 0; j < kJoints; ++j) moments[j].drive = torque[j];
  return torque;
}

EffectStack::JointTorques EffectStack::Torques(const Moments& moments) {
  JointTorques sum;
  for (Entry& entry : effects_) {
    if (entry.stage != EffectStage::kJoint) continue;
    const int j = entry.joint;
    sum.torque[j] += entry.effect->Torque(moments[j], sum.dry[j]);
    sum.inertia[j] += entry.effect->Inertia(moments[j]);
  }
  return sum;
}

void EffectStack::SumOffsets(const Moments& moments) {
  offset_.setZero();
  for (Entry& entry : effects_) {
    if (entry.stage == EffectStage::kTransmission)
      offset_[entry.joint] += entry.effect->Offset(moments[entry.joint]);
  }
}

EffectStack::Vector EffectStack::OffsetChange(const Moments& moments) {
  const Vector before = offset_;
  SumOffsets(moments);
  return offset_ - before;
}

double EffectStack::Reading(int joint, double q_link) const {
  for (const Entry& entry : effects_) {
    if (entry.stage == EffectStage::kSensor && entry.joint == joint)
      q_link = entry.effect->Reading(q_link);
  }
  return q_link;
}

}  // namespace robostress
