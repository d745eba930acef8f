#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/model/joint_model.h"
#include "calibration/model/joint_simulation.h"

namespace robostress::calibration {

// Typical sizes of a joint's signals, of which parameters are multiples.
struct SignalScales {
  double torque = 1, position = 1, velocity = 1, acceleration = 1, sample = 1, payload = 1;
  double coldest = 0;  // [deg C] logged
  double warming = 0;  // [K] between the coldest and the warmest; 0: nothing is logged
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

// The declared model with the rig's `fit` lists free, and with what a row leaves open where a
// motion is simulated (JointModel::command_shift, force_lag).
absl::StatusOr<Hypothesis> DeclaredHypothesis(const RigJoint& joint, const JointModel& model,
                                              const SignalScales& scales, double inertia);
// `base` with `effect` beside its own; one per combination of the effect's starts. A delay or lag
// of the command takes the place of the free command_shift.
std::vector<Hypothesis> WithEffect(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales, int partner = -1);
// With the late parameters of the effects of these types free; of a servo_lag the command_shift,
// whose place it took.
Hypothesis WithLateParameters(const Hypothesis& base, const std::vector<std::string>& types);
// Whether logs hold what an effect reads beside motion and torque: a temperature that changes.
bool IsLogged(const EffectInfo& effect, const SignalScales& scales);
// Without an effect that was added; its free parameters leave with it.
Hypothesis WithoutEffect(const Hypothesis& h, const std::string& type);
// With a free parameter fixed at 0.
Hypothesis FixedAtZero(const Hypothesis& h, int free);
JointModel ModelAt(const Hypothesis& hypothesis, const Eigen::VectorXd& x);

}  // namespace robostress::calibration
