#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "common/random.h"
#include "common/records/episode_recording.h"
#include "common/rollout/policy_endpoint.h"
#include "common/types.h"
#include "sim_worker/sim_task.h"

namespace robostress {

inline constexpr int kLabelSteps = 50;  // rows of a label, the policies' horizon
inline constexpr int kExpertTurn = 40;  // control steps that the expert drives in DAgger at a time

// One observation with what the expert would do from there.
struct DemonstrationFrame {
  int step = 0;
  std::vector<Image> views;               // agentview, robot0_eye_in_hand
  Eigen::VectorXf proprioception;         // [8]
  Eigen::Matrix<float, 8, 1> aux;         // target 3, destination 3, holding, progress
  Eigen::MatrixXf actions;                // [kLabelSteps, 7]
  std::optional<SimulatorRow> simulator;  // on request
};

struct Demonstration {
  bool success = false;
  int steps = 0;
  double execution_sigma = 0;  // of the Gaussian noise on the executed command [command]
  double render_seconds = 0;   // spent on drawing views
  std::vector<DemonstrationFrame> frames;
};

// How episodes are recorded.
struct RecordOptions {
  int image_size = 64;  // [px]
  int stride = 2;       // control steps between frames
  bool render = true;
  bool simulator_state = false;  // frames carry a SimulatorRow
  // Held action noise (after DART): bursts of a constant offset are added to what is executed;
  // labels stay the expert's.
  double noisy_share = 0.75;       // of the episodes
  double burst_chance = 0.08;      // per control step without one
  double translation_noise = 0.5;  // largest standard deviation of a burst [command]
  double rotation_noise = 0.12;
  // Domain randomisation (DR) of the action space: per episode sigma ~ U[0, execution_noise], per
  // control step independent N(0, sigma^2) on the six motion channels of the executed end-effector
  // command, in command units (full scale is 1: 0.05 m, 0.5 rad). The gripper is left alone.
  double execution_noise = 0;
};

// The expert drives, from the state to which `task` was reset; bursts come from the stream `key`,
// execution noise from a stream of its own, so that it changes nothing else. Labels are the
// expert's own commands along the path; after success zero motion with the last gripper command.
// Ends at success or at the horizon.
absl::StatusOr<Demonstration> RecordExpert(SimTask& task, const Expert& expert,
                                           const RecordOptions& options, const StreamKey& key);

struct DaggerOptions {
  double mix = 0.5;  // the expert's share of the driving, in (0, 1)
  int stride = 2;    // control steps between frames
};

// The policy and the expert drive in turns, from the state to which `task` was reset; the expert's
// take kExpertTurn control steps, the policy's a geometric number of chunks. Frames are of the
// expert's turns, which start where the policy got to; a label is what the expert does from there,
// on a branch of the simulation where the turn ends before it (after DAgger). Ends at success or at
// the horizon.
absl::StatusOr<Demonstration> RecordDagger(SimTask& task, const Expert& expert,
                                           const EpisodeKey& key, const DaggerOptions& options,
                                           PolicyEndpoint& policy, RandomStream random);

// The expert's next kLabelSteps commands from the present state, which is restored.
absl::StatusOr<Eigen::MatrixXf> BranchLabel(SimTask& task, const Expert& expert);

}  // namespace robostress
