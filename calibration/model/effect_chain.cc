#include "calibration/model/effect_chain.h"

#include <algorithm>
#include <cmath>

namespace robostress::calibration {

namespace {

constexpr int kNewtonSteps = 8;
constexpr double kNewtonTolerance = 1e-13;  // [rad]

JointChain ChainOf(const JointModel& model) {
  JointChain chain(1);
  for (const EffectInstance& effect : model.effects) chain.Add(0, *effect.info, effect.values);
  return chain;
}

}  // namespace

EffectChain::EffectChain(const JointModel& model) : EffectChain(model, ChainOf(model)) {}

EffectChain::EffectChain(const JointModel& model, JointChain chain)
    : model_(model), chain_(std::move(chain)), position_offset_(model.position_offset) {
  needs_payload = chain_.reads() & kPayloadFields;
  needs_tilt = chain_.reads() & kTiltField;
  partner = PartnerOf(model);
  at_rows = model.input == JointInput::kInverse;
  size_t placed[5] = {};  // by stage
  for (const EffectInstance& effect : model.effects) {
    JointEffect* object =
        stage(effect.info->stage)[placed[static_cast<int>(effect.info->stage)]++].effect.get();
    has_state |= object->HasState();
    oscillates |= effect.info->type == "compliance";
    if (effect.info->type == "backlash") gaps_.push_back({object, effect.values[0]});
    if (effect.info->stage == EffectStage::kJoint)
      (object->HasState() ? with_memory : memoryless).push_back(object);
    if (effect.info->stage == EffectStage::kJoint && (object->Reads() & kDriveField))
      of_drive.push_back(object);
  }
}

EffectChain EffectChain::Copy() const {
  EffectChain copy(model_, chain_);
  copy.side_ = side_;
  return copy;
}

void EffectChain::Reset(const JointMoment& moment) {
  for (EffectStage s : {EffectStage::kDrive, EffectStage::kJoint, EffectStage::kTransmission})
    for (const JointChain::Link& link : stage(s)) link.effect->Reset(moment);
  side_ = 0;
}

double EffectChain::Drive(double torque, const JointMoment& moment) const {
  for (const JointChain::Link& link : stage(EffectStage::kDrive))
    torque = link.effect->Drive(torque, moment);
  return torque;
}

double EffectChain::Asked(double torque, double asked, const JointMoment& moment) const {
  const absl::Span<const JointChain::Link> links = stage(EffectStage::kDrive);
  std::vector<double> at(links.size());  // asked of each
  for (size_t i = 0; i < links.size(); ++i) {
    at[i] = asked;
    asked = links[i].effect->Drive(asked, moment);
  }
  for (size_t i = links.size(); i-- > 0;) torque = links[i].effect->Asked(torque, at[i], moment);
  return torque;
}

double EffectChain::Offset(const JointMoment& moment) {
  double sum = 0;
  for (const JointChain::Link& link : stage(EffectStage::kTransmission)) {
    const double part = link.effect->Offset(moment);
    sum += part;
    for (const Gap& gap : gaps_) {
      if (gap.effect != link.effect.get()) continue;
      side_ = std::abs(part) < (1 - 1e-9) * gap.half_width ? 0 : part < 0 ? 1 : -1;
    }
  }
  return sum;
}

double EffectChain::Reading(double q_link) const {
  return chain_.Reading(0, q_link) + position_offset_;
}

// Newton's method; exact at once where the reading is affine.
double EffectChain::LinkOf(double reading) const {
  double q_link = reading;
  for (int i = 0; i < kNewtonSteps; ++i) {
    const double step = (Reading(q_link) - reading) / chain_.ReadingSlope(0, q_link);
    q_link -= step;
    if (std::abs(step) < kNewtonTolerance) break;
  }
  return q_link;
}

}  // namespace robostress::calibration
