#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "common/joint_errors/scenarios.h"
#include "common/rollout/command_inversion.h"
#include "common/unit_config.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

struct InversionOptions {
  int look_ahead = 5;  // control steps whose motion is compared
  int tries = 6;       // predictions per command
  double memory = 10;  // T, control steps that a shortfall counts
  double limit = 1;    // of what is added to a command on each axis [normalised action]
  // Memory of the errors of prediction, and what is not worth explaining: half a millimetre.
  double confidence_memory = 10;   // [control steps]
  double confidence_floor = 0.01;  // [normalised action]
};

// Chooses the command after which a model of the arm with its joint errors moves as an arm without
// errors does after the policy's command:
//
//   m*_k = motion of the arm without errors from here, rows a_0 ... a_k, plus e
//   d    = argmin_d sum_k |m*_k - m_k(a + d)|^2,  k < look_ahead        c = a_0 + w d
//   e_i  = (1 - 1 / T) e_(i-1) + dx_nominal_i - dx_i                    per executed step
//
// symbol  shape  unit
// a       [n, 6] normalised action  rows of the policy from now on
// m       [6]    normalised action  displacement since now
// e       [6]    normalised action  how far the arm is behind
// w       -                         confidence, 0..1
//
// d is found by `tries` steps of Gauss-Newton with the response of the nominal arm, halved where a
// step made it worse; a try is given up at the row where it is worse than the best. w = (E_0 - E) /
// (E_0 + floor^2), not below 0: E and E_0 are running means of the squared error of the last step's
// prediction by the model and by an arm without errors. A model that explains no more than nothing
// at all corrects nothing.
class ModelInversion : public CommandInversion {
 public:
  // Of what was identified. The model is the bare arm: it touches nothing and holds nothing.
  static absl::StatusOr<std::unique_ptr<ModelInversion>> OfModel(const PandaSim& arm,
                                                                 const SimOptions& sim,
                                                                 const Scenario& identified,
                                                                 int horizon);
  // An upper bound: the model is the simulated arm itself with its errors, their hidden states and
  // everything that it touches; w = 1. `arm` outlives this.
  static absl::StatusOr<std::unique_ptr<ModelInversion>> OfTruth(const PandaSim& arm,
                                                                 const SimOptions& sim,
                                                                 const Scenario& scenario,
                                                                 int horizon);

  void StartEpisode() override { running_ = false; }
  absl::StatusOr<Eigen::VectorXf> Command(const Eigen::MatrixXf& rows,
                                          const RobotState& now) override;
  double confidence() const;

 private:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Vector7 = Eigen::Matrix<double, 7, 1>;

  ModelInversion(const PandaSim* truth, std::unique_ptr<PandaSim> model,
                 std::unique_ptr<PandaSim> errorless);
  static absl::StatusOr<std::unique_ptr<ModelInversion>> Create(const PandaSim* truth,
                                                                const SharedModel& scene,
                                                                const SimOptions& sim,
                                                                const Scenario& scenario,
                                                                int horizon);
  absl::Status Start(const RobotState& now);
  // Shortfall and confidence by what the arm did with the command before.
  void Learn(const RobotState& now);
  // The model where the arm is now.
  void Synchronise(const RobotState& now);
  void SetArm(PandaSim& sim, const Eigen::VectorXd* q, const Eigen::VectorXd& dq) const;
  // Called with k and the displacement after row k; false: enough was seen.
  using AfterRow = absl::FunctionRef<bool(int k, const Vector6& motion)>;
  // Plays up to `steps` of the rows, d added to each.
  static absl::Status Play(PandaSim& sim, const Eigen::MatrixXf& rows, const Vector6& d, int steps,
                           AfterRow after);
  // The displacement after the first row.
  static absl::StatusOr<Vector6> FirstMotion(PandaSim& sim, const Eigen::MatrixXf& rows);

  const InversionOptions options_;
  const PandaSim* const truth_;  // null: identified
  const PandaModel panda_;
  const std::unique_ptr<PandaSim> model_, errorless_;
  std::vector<double> response_;  // displacement of the nominal arm after a unit step, per step

  bool running_ = false;
  Vector6 shortfall_ = Vector6::Zero(), added_ = Vector6::Zero();
  RobotState before_;                                // when the last command was chosen
  Eigen::VectorXd nominal_velocity_;                 // [7] of the arm that is followed
  Vector6 wanted_, predicted_, unexplained_;         // of the last step
  double model_error_ = 0, errorless_error_ = 0;     // running means of squares
  std::shared_ptr<const PandaSim::Snapshot> after_;  // the model after the last command
};

}  // namespace robostress
