#pragma once

#include <Eigen/Core>
#include <memory>

#include "absl/status/status.h"
#include "adapter/corrector.h"
#include "adapter/method_way.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/types.h"

namespace robostress {

// A control: regression without a model of the arm.
struct CalibratorOptions {
  using Corrector = class ResidualCalibrator;
  static constexpr MethodWay kWay{
      .name = "residual_calibrator", .key = "calibrator_memory", .in_joint_space = false};

  double memory = 0;   // N, control steps after which a step counts 1 / e; 0: off
  double ridge = 1;    // r
  double limit = 0.5;  // bound of the correction on each axis [command units]

  bool on() const { return memory != 0; }
  bool carries_over() const { return true; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Late("calibrator_memory", memory, 0.0,
           "learned residual calibrator: control steps after which a step counts 1/e; 0: none");
    v.Late("calibrator_ridge", ridge, 1.0, "weight of the squared coefficients in its regression");
    v.Late("calibrator_limit", limit, 0.5, "bound of its correction on each axis [command units]");
  }
};

// What the arm will do in the next step beyond a nominal arm, by ridge regression on what is known
// before it, learned while the robot works and carried from episode to episode:
//
//   w_i = (dx_i - dx_nominal(c)_i) / g          phi_i = (1, p_i / 0.5 m, c_(i-1), dx_(i-1) / g)
//   A  <- (1 - 1 / N) A + phi phi' + r / N I    B  <- (1 - 1 / N) B + phi w'
//   c   = a - clip(phi' A^-1 B)                 for the next step or chunk
//
// symbol  name               shape    unit
// p       tool position      [3]      m, in the base frame, before the step
// a, c    command            [6]      normalised action, of the policy, and as it was sent
// dx      motion             [6]      normalised action
// g       tracking_gain      -        achieved / commanded displacement of a nominal arm
// A, B    moments            [16, 16], [16, 3]
// N       calibrator_memory  -        control steps
// r       calibrator_ridge   -
//
// Nothing is corrected before the first step of an episode. Three translations; rotations and the
// gripper are left alone. Recursive least squares in information form, which forgets what is old
// without losing its ridge (Ljung, System Identification, 2nd ed., section 11.2).
class ResidualCalibrator : public Corrector {
 public:
  using Vector6 = NominalArm::Vector6;
  static constexpr int kFeatures = 16, kAxes = 3;
  static constexpr int kStateSize = kFeatures * (kFeatures + kAxes) + kFeatures + 12;

  ResidualCalibrator(const CalibratorOptions& options, const ResidualOptions& residual,
                     const NominalArmOptions& arm);

  std::unique_ptr<Corrector> Clone() const override {
    return std::make_unique<ResidualCalibrator>(*this);
  }
  // What was learned stays.
  void StartEpisode() override;
  // Masked steps move the nominal arm; nothing is learned from them, nor from the one after.
  void Observe(const ExecutedChunk& chunk) override;
  Eigen::VectorXd correction() const override;  // [6]

  // A and B by columns, phi, nominal goal, nominal velocity.
  Eigen::VectorXd State() const override;
  void SetState(const Eigen::VectorXd& state) override;
  // A positive definite and its entries and B's bounded, an arm that holds.
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  using Features = Eigen::Matrix<double, kFeatures, 1>;
  using Moments = Eigen::Matrix<double, kFeatures, kFeatures>;
  using Answers = Eigen::Matrix<double, kFeatures, kAxes>;
  static constexpr double kLargest = 1e30;  // of an entry of A or B

  CalibratorOptions options_;
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Moments A_;
  Answers B_ = Answers::Zero();
  Features phi_ = Features::Zero();  // of the next step; zero where it is not known
};

}  // namespace robostress
