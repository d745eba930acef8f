#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/joint_model.h"
#include "calibration/joint_simulation.h"

namespace robostress::calibration {

// Typical sizes of a joint's signals, of which parameters are multiples.
struct SignalScales {
  double torque = 1, position = 1, velocity = 1, sample = 1, payload = 1;
};
SignalScales MeasureScales(const RigJoint& joint, const std::vector<JointTrack>& tracks);
double ScaleOf(EffectScale scale, const SignalScales& scales);

// A parameter that a fit moves: x in [lower, upper] stands for the value x * scale, or scale / x.
struct FreeParameter {
  std::string path;  // FindValue's
  double scale = 1, lower = 0, upper = 1;
  bool inverse = false;
  double ToValue(double x) const { return inverse ? scale / std::max(x, 1e-12) : scale * x; }
  double FromValue(double value) const { return inverse ? scale / value : value / scale; }
};

// A model with what of it is free and where the fit begins.
struct Hypothesis {
  JointModel model;
  std::vector<FreeParameter> free;
  Eigen::VectorXd x;  // [free]
};

// The declared model with the rig's `fit` lists free.
absl::StatusOr<Hypothesis> DeclaredHypothesis(const RigJoint& joint, const JointModel& model,
                                              const SignalScales& scales, double inertia);
// `base` with `effect` beside its own; one per combination of the effect's starts.
std::vector<Hypothesis> WithEffect(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales);
JointModel ModelAt(const Hypothesis& hypothesis, const Eigen::VectorXd& x);

// Predictions and residuals of one joint over its logs.
class JointProblem {
 public:
  // window [rows] of free runs. Keeps `tracks`.
  JointProblem(std::string joint, std::vector<JointTrack> tracks, int window);

  const std::vector<JointTrack>& tracks() const { return tracks_; }
  // Predicted minus measured along a track, all rows; of a transmission without its mean, since an
  // encoder's zero belongs to a session.
  std::vector<double> Residual(const JointModel& model, size_t track) const;
  // Of several tracks, one after the other; `stride` keeps every so-many-th row.
  Eigen::VectorXd Residuals(const JointModel& model, const std::vector<size_t>& tracks,
                            int stride) const;
  double Rms(const JointModel& model, const std::vector<size_t>& tracks) const;
  // d Residuals / d x by forward differences on two threads.
  Eigen::MatrixXd Jacobian(const Hypothesis& h, const Eigen::VectorXd& x,
                           const Eigen::VectorXd& at_x, const std::vector<size_t>& tracks,
                           int stride) const;

  struct Fit {
    Hypothesis best;        // x at the minimum
    double rms = 0;         // over the tracks fitted
    bool at_bound = false;  // some free parameter is on a bound
    int evaluations = 0;
  };
  // Bounded Levenberg-Marquardt (Ceres) on a Huber loss, from h.x.
  Fit Minimise(const Hypothesis& h, const std::vector<size_t>& tracks,
               int max_iterations = 25) const;
  // The best of several starts.
  Fit MinimiseAll(const std::vector<Hypothesis>& starts, const std::vector<size_t>& tracks) const;

 private:
  std::string joint_;
  std::vector<JointTrack> tracks_;
  int window_;
};

}  // namespace robostress::calibration
