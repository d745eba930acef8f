#include "adapter/plausible_motion.h"

#include <cmath>
#include <utility>

#include "adapter/residual.h"
#include "common/so3.h"

namespace robostress {
namespace {

// Written so that what is not a number is not plausible either.
bool Within(const Eigen::Ref<const Eigen::VectorXd>& values, double limit) {
  return (values.array().abs() <= limit).all();
}

bool Plausible(const RobotState& state) {
  using Limit = PlausibleMotion;
  return Within(state.tool.p_base_tool, Limit::kPosition) && Within(state.q, Limit::kJoint) &&
         Within(state.dq, Limit::kJointSpeed) && std::abs(state.gripper) <= Limit::kGripper;
}

bool PlausibleStep(const RobotState& before, const RobotState& after) {
  using Limit = PlausibleMotion;
  if (!((after.tool.p_base_tool - before.tool.p_base_tool).norm() <= Limit::kDisplacement))
    return false;
  if (!(RotationBetween(before.tool.q_base_tool, after.tool.q_base_tool).norm() <=
        Limit::kRotation))
    return false;
  return before.q.size() != after.q.size() || Within(after.q - before.q, Limit::kJointStep);
}

bool PlausibleCommand(const Eigen::VectorXf& command) {
  return (command.array().abs() <= PlausibleMotion::kCommand).all();
}

}  // namespace

std::vector<bool> ImpossibleSteps(const ExecutedChunk& chunk) {
  std::vector<bool> impossible(chunk.steps.size());
  bool any = false, before_plausible = Plausible(chunk.steps[0].before);
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const RobotState& after = StateAfter(chunk, i);
    const bool after_plausible = Plausible(after);
    impossible[i] = !(before_plausible && after_plausible && PlausibleStep(step.before, after) &&
                      PlausibleCommand(step.policy_command) && PlausibleCommand(step.sent_command));
    any = any || impossible[i];
    before_plausible = after_plausible;
  }
  if (!any) impossible.clear();
  return impossible;
}

ExecutedChunk WithMasked(ExecutedChunk chunk, const std::vector<bool>& impossible) {
  if (impossible.empty()) return chunk;
  chunk.masked.resize(chunk.steps.size());
  for (size_t i = 0; i < impossible.size(); ++i) chunk.masked[i] = chunk.masked[i] || impossible[i];
  return chunk;
}

}  // namespace robostress
