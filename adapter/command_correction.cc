#include "adapter/command_correction.h"

#include <utility>

#include "absl/algorithm/container.h"
#include "adapter/command_bounds.h"
#include "adapter/method_options.h"

namespace robostress {
namespace {

Eigen::VectorXd Of(const CommandCorrection::State& state, const std::string& name) {
  const auto found = state.find(name);
  return found == state.end() ? Eigen::VectorXd() : found->second;
}

}  // namespace

CommandCorrection::CommandCorrection(const MethodOptions& method, const ResidualOptions& residual,
                                     const NominalArmOptions& arm) {
  method.ForEachWay([&]<class Way>(const Way& way) {
    if constexpr (requires { typename Way::Corrector; })
      parts_.push_back(
          {Way::kWay.name, std::make_unique<typename Way::Corrector>(way, residual, arm)});
  });
  FindEnvelope();
}

CommandCorrection::CommandCorrection(const CommandCorrection& other) {
  for (const Part& part : other.parts_) parts_.push_back({part.name, part.corrector->Clone()});
  FindEnvelope();
}

CommandCorrection& CommandCorrection::operator=(CommandCorrection other) {
  parts_ = std::move(other.parts_);
  FindEnvelope();
  return *this;
}

void CommandCorrection::FindEnvelope() {
  envelope_ = nullptr;
  for (const Part& part : parts_)
    if (auto* envelope = dynamic_cast<Envelope*>(part.corrector.get())) envelope_ = envelope;
}

void CommandCorrection::StartEpisode() {
  for (const Part& part : parts_) part.corrector->StartEpisode();
}

void CommandCorrection::Observe(const ExecutedChunk& chunk) {
  const State before = state();
  if (envelope_ == nullptr) {
    for (const Part& part : parts_) part.corrector->Observe(chunk);
  } else {
    for (size_t i = 0; i < chunk.steps.size(); ++i) ObserveWithin(*envelope_, StepOf(chunk, i));
  }
  if (!Holds(state())) set_state(before);
}

void CommandCorrection::ObserveWithin(Envelope& envelope, ExecutedChunk step) {
  envelope.Observe(step);
  const bool held = envelope.held(), shortly = envelope.held_shortly();
  const std::vector<bool> masked = step.masked;
  for (const Part& part : parts_) {
    if (part.corrector.get() == &envelope) continue;
    step.masked = masked;
    if (held || (shortly && part.corrector->LearnsSlowly())) step.masked = {true};
    part.corrector->Observe(step);
    if (held) part.corrector->Forget(1 - Envelope::kForgotten);
  }
}

Eigen::VectorXd CommandCorrection::Value() const {
  Eigen::VectorXd value;
  for (const Part& part : parts_) {
    const Eigen::VectorXd correction = part.corrector->correction();
    if (value.size() == 0) value = Eigen::VectorXd::Zero(correction.size());
    if (correction.size() > 0) value += correction;
  }
  return value;
}

CommandCorrection::State CommandCorrection::state() const {
  State state;
  for (const Part& part : parts_) {
    Eigen::VectorXd values = part.corrector->State();
    if (values.size() > 0) state.emplace(part.name, std::move(values));
  }
  return state;
}

bool CommandCorrection::Holds(const State& state) const {
  for (const auto& [name, values] : state) {
    const auto is_it = [&name = name](const Part& part) { return part.name == name; };
    if (values.size() > 0 && absl::c_none_of(parts_, is_it)) return false;
  }
  return absl::c_all_of(
      parts_, [&state](const Part& part) { return part.corrector->Holds(Of(state, part.name)); });
}

bool CommandCorrection::set_state(const State& state) {
  if (!Holds(state)) return false;
  for (const Part& part : parts_) part.corrector->SetState(Of(state, part.name));
  return true;
}

NominalArmOptions NominalArmOf(const SessionSetting& setting, const MethodOptions& method) {
  NominalArmOptions options;
  options.goal_reference = setting.goal_reference;
  options.control_period_s = setting.control_period_s;
  options.panda_dynamics = method.panda_dynamics;
  options.translation_scale = setting.translation_scale;
  options.rotation_scale = setting.rotation_scale;
  return options;
}

ResidualOptions ResidualOf(const SessionSetting& setting, const MethodOptions& method) {
  ResidualOptions options = ResidualOptionsOf(
      method, ActsInJointSpace(setting) ? ResidualSpace::kJoint : ResidualSpace::kEndEffector);
  options.translation_scale = setting.translation_scale;
  options.rotation_scale = setting.rotation_scale;
  return options;
}

void CorrectCommands(const MethodOptions& method, const PolicySpec& policy,
                     const Eigen::VectorXd& correction, PredictedChunk& answer) {
  answer.actions = answer.policy_actions;
  const Eigen::Index arm = answer.actions.cols() - 1;
  if (method.gain != 1.0) answer.actions.leftCols(arm) *= static_cast<float>(method.gain);
  if (correction.size() > 0) {
    constexpr double kWidest = kWidestCommand;  // what does not fit in a float would be undefined
    answer.actions.leftCols(arm).rowwise() +=
        correction.head(arm).cwiseMax(-kWidest).cwiseMin(kWidest).cast<float>().transpose();
  }
  // After the last stage, whatever it was.
  if (method.gain != 1.0 || correction.size() > 0)
    BoundCommands(policy, answer.policy_actions, answer.actions);
}

void SmoothCommand(double smoothing, const Eigen::VectorXf& before, Eigen::VectorXf& command) {
  if (smoothing == 0) return;
  const Eigen::Index arm = command.size() - 1;
  const auto kept = static_cast<float>(smoothing);
  command.head(arm) *= 1 - kept;
  if (before.size() > 0) command.head(arm) += kept * before.head(arm);
}

}  // namespace robostress
