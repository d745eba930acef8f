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
namespace robostress {

enum class TargetReference { kExecuted, kIntent, kNominal };

// eta of every executed step [steps, action_dim], gripper 0, for the method's reference. `base`
// holds the unadapted policy's actions of the same rows [steps, action_dim] (intent only; may be
// empty otherwise). `arm` is advanced along the chunk (nominal only; may be null otherwise). Rows
// of masked steps are 0.
absl::StatusOr<Eigen::MatrixXd> ReferencedResidual(const ExecutedChunk& chunk,
                                                   TargetReference reference,
                                                   const ResidualOptions& options,
                                                   const Eigen::MatrixXf& base, NominalArm* arm);

// a_policy - eta, environment units [steps, action_dim]. The gripper entry is the policy's command.
Eigen::MatrixXf PseudoTarget(const ExecutedChunk& chunk, const Eigen::MatrixXd& residual);

}  // namespace robostress
