#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calibration/search/joint_fit.h"

namespace robostress::calibration {

// Something that may be missing: an effect, of a coupled one with the joint that it reads.
struct Candidate {
  const EffectInfo* effect = nullptr;
  int partner = -1;
};

// Effects that a joint's input can show and that `model` does not have. `other_joints` are those
// that a coupling may read.
std::vector<Candidate> CandidatesFor(const JointModel& model, const std::vector<int>& other_joints,
                                     bool has_torque);

// How a small amount of an effect changes the projected residual of a fitted model, for one choice
// of its shape parameters (wavelength, delay ...): one column per amplitude, without what the
// model's own free parameters could imitate.
struct Signature {
  int candidate = 0;                 // index
  Hypothesis start;                  // the model with the effect, at this choice
  std::vector<int> columns;          // amplitudes in start.x
  Eigen::MatrixXd basis;             // [rows, k] orthonormal; k 0: nothing survives
  Eigen::MatrixXd columns_of_basis;  // [k, columns]: signature = basis * this + what is imitated
  double surviving = 0;              // share of the columns' energy that is not imitated
};

// The residual of a fitted model and the signatures of what it may lack.
class Screening {
 public:
  Screening(const JointProblem& problem, const JointFit& fit, const SignalScales& scales,
            std::vector<Candidate> candidates, const WindowSet& chosen);

  // Those of which the logs hold what they depend on.
  const std::vector<Candidate>& candidates() const { return candidates_; }
  const std::vector<Signature>& signatures() const { return signatures_; }
  const Eigen::VectorXd& residual() const { return residual_; }  // orthogonal to what is imitated
  // Takes out of columns [rows, any] what the model's free parameters imitate.
  void RemoveImitated(Eigen::MatrixXd& columns) const;
  // Share of the residual's energy that a signature explains.
  double Gain(const Signature& signature) const;
  // Where a fit begins: start.x with amplitudes by linear least squares, within bounds.
  Hypothesis LinearStart(const Signature& signature) const;

 private:
  std::vector<Candidate> candidates_;
  std::vector<Signature> signatures_;
  Eigen::VectorXd at_base_, residual_;
  Eigen::MatrixXd imitated_;  // [rows, any] orthonormal
};

}  // namespace robostress::calibration
