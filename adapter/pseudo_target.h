#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/types.h"

// Pseudo-target of the executed steps (paper, Eq. corrected):
//
//   a_target_i = a_policy_i - eta_i
//
// eta is taken against (MethodOptions::target)
//   executed  the policy's own command: eta = dx - a_policy (paper). No fixed point when the arm's
//   tracking
//             gain is below 1: with dx = g a the target is (2 - g) a.
//   intent    the unadapted policy's command: eta = dx - a_base. Fixed point at dx = a_base.
//   nominal   what a nominal arm would have done with the same sent commands: eta = dx -
//   dx_nominal.
//             Clean is a fixed point for every command.
//   nominal_intent  what a nominal arm would have done with the unadapted policy's commands: eta =
//             dx - dx_nominal(a_base). Fixed point at dx = dx_nominal(a_base), which in Clean is
//             the unadapted policy itself, lag included.
//   sent      not Eq. 2 but feedback-error learning: on executed rows the command that was really
//             sent, correction included (before smoothing), and the unadapted policy's own on the
//             others. Fixed point where nothing is left to correct.
namespace robostress {

enum class TargetReference { kExecuted, kIntent, kNominal, kNominalIntent, kSent };

// Needs the unadapted policy's commands.
inline bool NeedsBase(TargetReference reference) {
  return reference == TargetReference::kIntent || reference == TargetReference::kNominalIntent ||
         reference == TargetReference::kSent;
}
// Against a nominal arm, which is an end-effector controller's.
inline bool NeedsNominalArm(TargetReference reference) {
  return reference == TargetReference::kNominal || reference == TargetReference::kNominalIntent;
}

// eta of every executed step [steps, action_dim], gripper 0, for the method's reference. `base`
// holds the unadapted policy's actions of the same rows [steps, action_dim] (NeedsBase; may be
// empty otherwise). `arm` is advanced along the chunk (NeedsNominalArm; may be null otherwise).
// Rows of masked steps are 0.
absl::StatusOr<Eigen::MatrixXd> ReferencedResidual(const ExecutedChunk& chunk,
                                                   TargetReference reference,
                                                   const ResidualOptions& options,
                                                   const Eigen::MatrixXf& base, NominalArm* arm);

// The whole chunk for target sent [K, action_dim]: `base` with the executed rows that are not
// masked as they were sent. Gripper entries are the unadapted policy's.
Eigen::MatrixXf SentTarget(const ExecutedChunk& chunk, const Eigen::MatrixXf& base);

// a_policy - eta, environment units [steps, action_dim]. The gripper entry is the policy's command.
Eigen::MatrixXf PseudoTarget(const ExecutedChunk& chunk, const Eigen::MatrixXd& residual);

}  // namespace robostress
