#pragma once

#include <cstdint>

#include "common/types.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// Magnitude of the joint-space residual (paper, sec:residual-magnitude and sec:supp_real), gripper
// excluded, in the form of the paper's simulated rows:
//
//   residual = sqrt( sum ||q_{t+1} - q_ref_t||^2 / sum ||q_ref_t - q_chunk||^2 )
//
// q_ref: the policy's target before any correction; q_chunk: the joints at the start of the chunk,
// which is what the checkpoint's displacements are counted from.
struct JointResidual {
  double eta_sq = 0;           // sum of ||q_{t+1} - q_ref_t||^2 [rad^2]
  double displacement_sq = 0;  // sum of ||q_ref_t - q_chunk||^2 [rad^2]
  int64_t steps = 0;

  // Masked steps are left out of both sums.
  void Add(const ExecutedChunk& chunk, const ArmVector& chunk_start);
  double value() const;  // 0 before the first step
};

}  // namespace robostress
