#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/fidelity/measured_replays.h"
#include "calibration/fidelity/payload_replay.h"
#include "calibration/fidelity/replay_arm.h"
#include "common/statistics.h"

namespace robostress::calibration {

// The paper's comparison of Heavy Payload with a real payload (fig:fidelity).
struct FidelityOptions {
  // An arm that replays holds absolute targets, and a payload pulls it down; the simulator's own
  // defaults are robosuite's deltas to the achieved pose and the paper's literal sign.
  FidelityOptions() {
    task.sim.goal_reference = GoalReference::kDesired;
    task.sim.joint_errors.gravity_sign = GravitySign::kPayload;
  }

  ReplayTask task;
  int demonstration_layout = 0;  // replayed on the measured side; w_g and w_c are fitted to it
  int first_layout = 1;          // of the others
  int layouts = 10;
  // Added to the carried object of a simulated measured side [kg]: the paper's bowl holds 1 kg.
  double payload_kg = 1;
  int replays = 3;           // of either kind
  std::string measured_dir;  // empty: simulated
  // Of the Gaussian noise on the normalised command. The paper names RobustVLA's scale without a
  // number for its evaluation; 0.03 is the radius of the ball that it gives for its training.
  double noise_sigma = 0.03;
  int noise_draws = 3;  // per layout
  // Deviations of the model from the arm without any error (Clean) instead of from the same arm
  // without the payload (w_g = w_c = 1).
  bool clean_reference = false;
  int64_t seed = 10000;
  int replicates = 2000;  // of the bootstrap
  int threads = 2;
  std::function<void(const std::string&)> progress;
};

struct FittedFactors {
  double gravity = 1, compliance = 1;
  double rms = 0;          // model's profile minus the measured mean, on the demonstration [m]
  double rms_nominal = 0;  // the same of w_g = w_c = 1
  bool gravity_at_bound = false, compliance_at_bound = false;
  int replays = 0;  // spent on the fit
};
// The factors that are tried; the paper's lie in [1, 4] and [1, 5].
inline constexpr double kLargestGravityFactor = 16, kLargestComplianceFactor = 10;

// A number with its 95 % interval over layouts and measured replays.
struct Estimate {
  double value = 0;
  Interval interval;
};

// One side of the comparison.
struct Contender {
  std::string name;               // "fitted model", "Gaussian noise"
  std::vector<Profile> profiles;  // one per layout; of noise the mean over its draws
  Profile mean;
  int lost = 0, replays = 0;  // in which the object was never held, of how many
  Estimate dtw, dtw_total;    // to the measured mean profile [m]; per step of the path, and its sum
  Estimate rise;              // of the mean profile at the grasp [m]
  Estimate dtw_excess;        // dtw minus the fitted model's
};

struct FidelityResult {
  std::string source, instruction;
  MeasuredProfiles measured;
  Profile measured_mean, model_demonstration;
  Estimate measured_rise;
  double replay_dtw = 0;  // mean dtw of a loaded replay to the mean of the others: repeatability
  FittedFactors fit;
  double fitted_sigma = 0;            // of Gaussian noise, fitted like the factors
  std::vector<Contender> contenders;  // fitted model, Gaussian at the stated scale, at the fitted
  double model_vertical = 0, measured_vertical = 0;  // mean z over the carry [m]
  MeasuredReplays replays;
};

absl::StatusOr<FidelityResult> RunFidelity(const FidelityOptions& options);

}  // namespace robostress::calibration
