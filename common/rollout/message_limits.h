#pragma once

#include <cstddef>

#include "common/rollout/policy_endpoint.h"

// How large a message may be that carries what a policy takes: what is longer is nonsense, and is
// refused before it is held. A function of what the policy declares, the same for every wire.
namespace robostress {

// What a message may hold at most; far above what a policy uses, far below what hurts a server.
struct WireLimits {
  static constexpr int kName = 256;          // bytes of a name
  static constexpr int kInstruction = 4096;  // bytes
  static constexpr int kMethodYaml = 65536;  // bytes
  static constexpr int kViews = 16;
  static constexpr int kImageSide = 4096;  // [px]
  static constexpr int kStateDim = 1024;
  static constexpr int kActionDim = 256;
  static constexpr int kHorizon = 1024;  // rows of a chunk
  static constexpr int kDof = 64;
  static constexpr float kWidestAction = 1000;  // |entry| of a command, environment units
  static constexpr int kIndex = 1 << 24;        // task, episode, chunk
  static constexpr double kQuaternionNormError = 1e-3;
};

// Bytes of the greatest observation: every camera's view with sides of `max_view_side` [px], the
// state, the longest prompt, and the names beside them. `value_bytes`: of a colour value as the
// wire takes it; openpi's takes float64, gRPC bytes.
size_t LargestObservationBytes(const PolicySpec& policy, int max_view_side,
                               size_t value_bytes = sizeof(double));

// Bytes of the greatest report: every step of a whole horizon, with the states of the most joints
// that a robot may have and three rows of commands, in float64.
size_t LargestExecutedBytes(const PolicySpec& policy);

}  // namespace robostress
