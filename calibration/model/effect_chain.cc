#include "calibration/model/effect_chain.h"

#include <algorithm>
#include <cmath>

namespace robostress::calibration {

namespace {

constexpr int kNewtonSteps = 8;
constexpr double kNewtonTolerance = 1e-13;  // [rad]
constexpr double kRatioStep = 1e-5;         // [rad]
constexpr double kTorqueStep = 1e-6;        // [Nm]
constexpr double kLeastSpeedRatio = 0.1;

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
    if (effect.info->stage == EffectStage::kTransmission && !object->HasState())
      waves_.push_back(object);
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
  for (size_t i = 0; i < gaps_.size(); ++i) {
    copy.gaps_[i].motor = gaps_[i].motor;
    copy.gaps_[i].offset = gaps_[i].offset;
  }
  copy.of_states_ = of_states_;
  copy.drift_ = drift_;
  return copy;
}

void EffectChain::Reset(const JointMoment& moment) {
  for (EffectStage s : {EffectStage::kDrive, EffectStage::kJoint, EffectStage::kTransmission})
    for (const JointChain::Link& link : stage(s)) link.effect->Reset(moment);
  side_ = 0;
  Offset(moment);
  drift_ = 0;
}

double EffectChain::Drive(double torque, const JointMoment& moment) const {
  for (const JointChain::Link& link : stage(EffectStage::kDrive))
    torque = link.effect->Drive(torque, moment);
  return torque;
}

double EffectChain::DriveSlope(double torque, const JointMoment& moment) const {
  if (stage(EffectStage::kDrive).empty()) return 1;
  const double step = kTorqueStep * std::max(1.0, std::abs(torque));
  return (Drive(torque + step, moment) - Drive(torque - step, moment)) / (2 * step);
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
  const double before = of_states_;
  of_states_ = 0;
  for (const JointChain::Link& link : stage(EffectStage::kTransmission)) {
    const double part = link.effect->Offset(moment);
    sum += part;
    if (link.effect->HasState()) of_states_ += part;
    for (Gap& gap : gaps_) {
      if (gap.effect != link.effect.get()) continue;
      gap.motor = moment.q, gap.offset = part;
      side_ = std::abs(part) < (1 - 1e-9) * gap.half_width ? 0 : part < 0 ? 1 : -1;
    }
  }
  if (oscillates && moment.h > 0) drift_ = (of_states_ - before) / moment.h;
  return sum;
}

double EffectChain::WavesAt(double q) const {
  JointMoment moment;
  moment.q = q;
  double sum = 0;
  for (JointEffect* wave : waves_) sum += wave->Offset(moment);
  return sum;
}

double EffectChain::OffsetAt(double q, double later) const {
  double sum = of_states_ + later * drift_ + WavesAt(q);
  // Within a gap the link stays where it was.
  for (const Gap& gap : gaps_)
    sum += std::clamp(gap.motor + gap.offset - q, -gap.half_width, gap.half_width) - gap.offset;
  return sum;
}

double EffectChain::SpeedRatio(double q_motor) const {
  if (!has_wave()) return 1;
  const double slope =
      (WavesAt(q_motor + kRatioStep) - WavesAt(q_motor - kRatioStep)) / (2 * kRatioStep);
  return std::max(kLeastSpeedRatio, 1 + slope);
}

// Newton's method. A link that stands still or goes back while the motor turns has no such inverse:
// the slope is bounded.
double EffectChain::MotorOf(double q_link) const {
  double q = q_link - of_states_;
  for (int i = 0; i < kNewtonSteps && has_wave(); ++i) {
    const double step = (q + of_states_ + WavesAt(q) - q_link) / SpeedRatio(q);
    q -= step;
    if (std::abs(step) < kNewtonTolerance) break;
  }
  return q;
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
