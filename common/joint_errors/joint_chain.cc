#include "common/joint_errors/joint_chain.h"

#include <algorithm>

#include "common/check.h"

namespace robostress {

using enum EffectStage;

JointChain::JointChain(int joints, const JointErrorOptions& options)
    : options_(options),
      severity_(joints),
      coupled_(joints, -1),
      sum_(joints),
      inertia_(joints),
      dry_(joints),
      at_errors_(joints) {
  RS_CHECK(joints >= 1);
  errors_.offset.resize(joints);
  effects_.offset.resize(joints);
}

void JointChain::SetScenario(const Scenario& scenario, int horizon) {
  JointChain chain(joints(), options_);
  chain.severity_.SetScenario(scenario, horizon);
  const absl::Span<const PaperError> errors = PaperErrors();
  for (size_t i = 0; i < errors.size(); ++i) {
    for (int j = 0; j < joints() && scenario.*errors[i].on; ++j)
      chain.Place(chain.errors_, errors[i].stage,
                  Link(j, errors[i].make(options_), static_cast<int>(i)));
  }
  chain.SetErrorParameters();
  for (const ScenarioEffect& listed : scenario.effects) {
    const auto info = FindEffect(listed.type);
    RS_CHECK(info.ok());
    chain.Add(listed.joint, **info, listed.values, listed.coupled);
  }
  *this = std::move(chain);
}

void JointChain::Add(int joint, const EffectInfo& info, absl::Span<const double> values,
                     int coupled) {
  RS_CHECK(joint >= 0 && joint < joints() && coupled < joints() &&
           values.size() == info.parameters.size());
  Link link(joint, info.make(), -1);
  link.effect->SetParameters(values);
  if (coupled >= 0) coupled_[joint] = coupled;
  Place(effects_, info.stage, std::move(link));
}

void JointChain::Place(Part& part, EffectStage stage, Link link) {
  reads_ |= link.effect->Reads();
  part.of(stage).push_back(std::move(link));
}

void JointChain::SetErrorParameters() {
  for (const EffectStage stage : {kJoint, kTransmission}) {
    for (Link& link : errors_.of(stage)) {
      const PaperError& error = PaperErrors()[link.error];
      const double factor = severity_.factors()[link.joint].*error.factor;
      if (factor == link.factor) continue;
      link.factor = factor;
      error.set(severity_.parameters()[link.joint], options_, *link.effect);
    }
  }
}

void JointChain::Reset(Part& part, std::vector<JointMoment> moments) const {
  const auto reset = [&] {
    for (std::vector<Link>& stage : part.stages) {
      for (Link& link : stage) link.effect->Reset(moments[link.joint]);
    }
    std::fill(part.offset.begin(), part.offset.end(), 0.0);
    for (Link& link : part.of(kTransmission)) {
      link.offset = link.effect->Offset(moments[link.joint]);
      part.offset[link.joint] += link.offset;
    }
  };
  reset();
  if (part.of(kTransmission).empty()) return;
  // Once more from the motor's side of that deflection.
  for (int j = 0; j < joints(); ++j) moments[j].q -= part.offset[j];
  reset();
}

void JointChain::Reset(absl::Span<const JointMoment> joints) {
  severity_.Reset();
  SetErrorParameters();
  std::vector<JointMoment> at_errors(joints.begin(), joints.end()), at_effects = at_errors;
  if (options_.offset_start != OffsetStart::kEquilibrium) {
    for (JointMoment& moment : at_errors) moment.drive = 0;
  }
  Reset(errors_, at_errors);
  for (size_t j = 0; j < joints.size(); ++j) at_effects[j].q -= errors_.offset[j];
  Reset(effects_, at_effects);
  if (!has_effects(kTransmission)) return;
  // What the effects turn lies between the paper's gap and the joint coordinate.
  for (size_t j = 0; j < joints.size(); ++j) at_errors[j].q -= effects_.offset[j];
  Reset(errors_, at_errors);
}

void JointChain::BeginSubStep(double h) {
  if (severity_.BeginSubStep(h)) SetErrorParameters();
}

void JointChain::Drive(absl::Span<JointMoment> moments, absl::Span<double> torque) {
  for (Link& link : effects_.of(kCommand))
    torque[link.joint] = link.effect->Command(torque[link.joint], moments[link.joint]);
  for (Link& link : effects_.of(kDrive))
    torque[link.joint] = link.effect->Drive(torque[link.joint], moments[link.joint]);
  for (size_t j = 0; j < torque.size(); ++j) moments[j].drive = torque[j];
}

void JointChain::AddTorques(absl::Span<const JointMoment> moments, absl::Span<double> torque) {
  std::fill(inertia_.begin(), inertia_.end(), 0.0);
  std::fill(dry_.begin(), dry_.end(), DryFriction());
  if (has_effects(kJoint)) {
    std::fill(sum_.begin(), sum_.end(), 0.0);
    for (Link& link : effects_.of(kJoint)) {
      const JointMoment& moment = moments[link.joint];
      sum_[link.joint] += link.effect->Torque(moment, dry_[link.joint]);
      inertia_[link.joint] += link.effect->Inertia(moment);
    }
    for (size_t j = 0; j < torque.size(); ++j) torque[j] += sum_[j];
  }
  for (Link& link : errors_.of(kJoint))
    torque[link.joint] += link.effect->Torque(moments[link.joint], dry_[link.joint]);
  sticks_ = false;
  for (size_t j = 0; j < torque.size(); ++j)
    sticks_ |= inertia_[j] != 0 || dry_[j].forward > 0 || dry_[j].backward > 0;
}

void JointChain::MoveErrors(absl::Span<const double> q, absl::Span<const double> load, double h,
                            absl::Span<double> change) {
  if (!has_errors(kTransmission)) return;
  for (int j = 0; j < joints(); ++j) {
    JointMoment& moment = at_errors_[j];
    moment.h = h;
    moment.q = q[j] - effects_.offset[j] - errors_.offset[j];
    moment.drive = load[j];
    sum_[j] = 0;
  }
  for (Link& link : errors_.of(kTransmission)) {
    link.offset = link.effect->Offset(at_errors_[link.joint]);
    sum_[link.joint] += link.offset;
  }
  for (size_t j = 0; j < change.size(); ++j) change[j] += sum_[j] - errors_.offset[j];
  errors_.offset = sum_;
}

void JointChain::MoveEffects(absl::Span<const JointMoment> moments, absl::Span<double> change) {
  if (!has_effects(kTransmission)) return;
  std::fill(sum_.begin(), sum_.end(), 0.0);
  for (Link& link : effects_.of(kTransmission)) {
    link.offset = link.effect->Offset(moments[link.joint]);
    sum_[link.joint] += link.offset;
  }
  for (size_t j = 0; j < change.size(); ++j) change[j] += sum_[j] - effects_.offset[j];
  effects_.offset = sum_;
}

double JointChain::error_offset(PaperErrorKind kind, int joint) const {
  for (const Link& link : errors_.of(kTransmission)) {
    if (link.error == kind && link.joint == joint) return link.offset;
  }
  return 0;
}

double JointChain::Reading(int joint, double q_link) const {
  for (const Link& link : effects_.of(kSensor)) {
    if (link.joint == joint) q_link = link.effect->Reading(q_link);
  }
  return q_link;
}

double JointChain::ReadingSlope(int joint, double q_link) const {
  double slope = 1;
  for (const Link& link : effects_.of(kSensor)) {
    if (link.joint != joint) continue;
    slope *= link.effect->ReadingSlope(q_link);
    q_link = link.effect->Reading(q_link);
  }
  return slope;
}

bool JointChain::any_effects() const {
  return std::any_of(effects_.stages.begin(), effects_.stages.end(),
                     [](const std::vector<Link>& stage) { return !stage.empty(); });
}

}  // namespace robostress
