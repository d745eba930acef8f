#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// What the entries of an action are, and so in which space commanded and executed motion are
// compared.
enum class ControlSpace {
  kUnspecified,  // it does not say
  kEndEffector,  // displacements of the end effector in units of translation_scale and
                 // rotation_scale (common/rollout/session_spec.h), and a gripper
  kJoint,  // absolute joint targets [rad] and a gripper; residual as in the paper, sec:supp_real
};

// What a policy expects and delivers. Filled by the server (or a local policy) before the first
// rollout.
struct PolicySpec {
  std::string name;                  // "nano", "expert", "replay"
  std::string model_hash;            // SHA-256 of the weights file, hex; empty without weights
  std::vector<std::string> cameras;  // views it wants, in order; empty: no rendering
  int image_width = 224;             // [px] of the views it wants
  int image_height = 224;
  bool resizes_images = false;  // takes views of other sizes too
  int max_view_side = 1280;     // [px] of any view; wide enough for a camera's 1280 x 720
  int state_dim = 8;
  int action_dim = 7;                                       // environment action
  int horizon = 50;                                         // K, steps per predicted chunk
  int execute_steps = 5;                                    // n_exec
  ControlSpace control_space = ControlSpace::kUnspecified;  // of its actions
  // [action_dim] what the policy's actions mean to lie in, environment units; empty: it declares
  // none. A policy may pass them by a little; a correction is held to them
  // (adapter/command_bounds.h).
  std::vector<float> action_low, action_high;
  bool adaptable = false;  // has an action expert that LoRA can adapt
  bool inpaints = false;   // PredictAfter is there: a flow policy that can go on from a chunk
};

// What is left of the chunk that plays while the next one is made. Row i is due i steps after the
// observation.
struct RunningRows {
  Eigen::MatrixXf actions;  // [n, action_dim] policy_actions of the running chunk, n >= 1
  int held = 0;  // 0..n: so many will have been played when the answer is there; the others may yet
                 // be changed
};

// Where in a sweep a prediction stands. The sampling noise is a function of
// (seed, suite, task, episode, chunk) only.
struct EpisodeKey {
  int task = 0;
  int episode = 0;
};

// A session's counters, for tables and logs.
struct SessionStats {
  uint64_t feedback_chunks = 0;
  uint64_t updates_applied = 0;
  double adapter_distance = 0;  // ||phi - phi_0||_2
  double last_loss = 0;
};

// UNIMPLEMENTED, with what to do.
inline absl::Status InpaintingError(const std::string& policy) {
  return absl::UnimplementedError(
      "policy '" + policy +
      "' cannot go on from a running chunk: real-time chunking (rtc) needs a flow policy of ours, "
      "such as nano; take waiting, switch or crossfade");
}

// A policy as the rollout loop sees it: local (expert, replay) or behind gRPC. One object, one
// session, one thread.
class PolicyEndpoint {
 public:
  virtual ~PolicyEndpoint() = default;
  virtual const PolicySpec& spec() const = 0;
  // Start of an episode: per-episode state (e.g. the direct correction) is reset. A change of task
  // is a boundary: the feedback buffer is cleared.
  virtual absl::Status StartEpisode(const EpisodeKey& key) = 0;
  // Lockstep: returns when all feedback sent before is in and every due update is published.
  virtual absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) = 0;
  // [action_dim] what is sent for row `so_far.steps.size()` of `predicted`, the last prediction:
  // its `actions`, unless the policy corrects by what was executed since. `so_far`: the steps of
  // this chunk that are done, `so_far.final_state` the state now.
  virtual absl::StatusOr<Eigen::VectorXf> NextCommand(const PredictedChunk& predicted,
                                                      const ExecutedChunk& so_far) {
    return Eigen::VectorXf(
        predicted.actions.row(static_cast<Eigen::Index>(so_far.steps.size())).transpose());
  }
  // As Predict, with a chunk that goes on from what is running (real-time chunking). UNIMPLEMENTED
  // where spec().inpaints is false.
  virtual absl::StatusOr<PredictedChunk> PredictAfter(const Observation& /*observation*/,
                                                      int /*chunk*/,
                                                      const RunningRows& /*running*/) {
    return InpaintingError(spec().name);
  }
  virtual absl::Status SendFeedback(ExecutedChunk executed) = 0;
  virtual absl::StatusOr<SessionStats> Stats() = 0;
};

}  // namespace robostress
