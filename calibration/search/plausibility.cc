#include "calibration/search/plausibility.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/model/effect_chain.h"

namespace robostress::calibration {
namespace {

constexpr double kSlack = 0.1;       // of the friction's parts, that may be missing
constexpr double kSigmas = 2;        // of their standard errors
constexpr double kLeastDrive = 0.2;  // of the drive, that must be left at the end of a log
constexpr double kKnownCoupling = 0.05;
constexpr int kRowStep = 4;  // rows that are looked at

// What resists motion; a torque of these is viscous.
bool Rubs(const EffectInstance& effect) {
  static const std::vector<std::string> types = {
      "stribeck_friction",       "asymmetric_coulomb",          "asymmetric_viscous",
      "load_dependent_friction", "gravity_dependent_friction",  "time_drift_friction",
      "temperature_friction",    "position_dependent_friction", "quadratic_viscous_friction",
      "cross_joint_friction",
  };
  return std::find(types.begin(), types.end(), effect.info->type) != types.end();
}

// Where the curve of a Stribeck friction never rises its speed and static friction say nothing.
bool IsFlatCurve(const Hypothesis& h, const std::string& path) {
  if (path != "stribeck_friction.vs" && path != "stribeck_friction.Fs") return false;
  JointModel model = ModelAt(h, h.x);
  const auto Fc = FindValue(model, "stribeck_friction.Fc");
  const auto Fs = FindValue(model, "stribeck_friction.Fs");
  return Fc.ok() && Fs.ok() && **Fs <= 1.001 * **Fc;
}

// A joint's friction against motion at `speed` either way [Nm], and what its parts add up to.
struct Resistance {
  double forward = 0, backward = 0, parts = 0;
};

Resistance ResistanceAt(const JointModel& model, EffectChain& chain, JointMoment moment) {
  Resistance sum;
  const auto add = [&](double forward, double backward) {
    sum.forward += forward;
    sum.backward += backward;
    sum.parts += std::max(std::abs(forward), std::abs(backward));
  };
  const double speed = std::abs(moment.dq);
  add(model.frictionloss, model.frictionloss);
  add(model.damping * speed, model.damping * speed);
  for (JointEffect* effect : chain.memoryless) {
    DryFriction dry, ignored;
    moment.dq = speed;
    const double ahead = -effect->Torque(moment, dry);
    moment.dq = -speed;
    const double back = effect->Torque(moment, ignored);
    add(dry.forward + ahead, dry.backward + back);
  }
  return sum;
}

double DriveAt(const JointModel& model, const JointRecord& record, int row) {
  if (!record.tau.empty()) return record.tau[row];
  return record.command.empty() ? 0 : model.servo.kp * (record.command[row] - record.q_smooth[row]);
}

// Standard error of a joint's friction.
struct FrictionError {
  double dry2 = 0;      // [Nm^2]
  double viscous2 = 0;  // [(Nm s/rad)^2]
  double At(double speed) const { return std::sqrt(dry2 + viscous2 * speed * speed); }
};

FrictionError ErrorOfFriction(const JointFit& fit, const std::vector<double>& std) {
  FrictionError error;
  for (size_t i = 0; i < std.size(); ++i) {
    const std::string& path = fit.best.free[i].path;
    if (path == "frictionloss" || absl::EndsWith(path, ".Fc") || absl::EndsWith(path, ".dFc"))
      error.dry2 += std[i] * std[i];
    if (path == "damping" || absl::EndsWith(path, "sigma_v") || absl::EndsWith(path, ".d_sigma"))
      error.viscous2 += std[i] * std[i];
  }
  return error;
}

// What a joint's friction depends on at a row.
JointMoment MomentAt(const JointModel& model, const JointTrack& track, int row) {
  const JointRecord& record = track.record();
  const PlantRow& plant = track.rows[track.single ? 0 : static_cast<size_t>(row)];
  JointMoment moment;
  moment.t = row * track.log->dt;
  moment.h = track.log->dt;
  moment.q = record.q_smooth[row];
  moment.dq = record.dq[row];
  moment.drive = DriveAt(model, record, row);
  moment.gravity = Evaluate(plant.gravity, track.single, std::cos(moment.q), std::sin(moment.q),
                            moment.q, plant.q_ref);
  if (!record.temperature.empty()) moment.temperature = record.temperature[row];
  if (const int partner = PartnerOf(model); partner >= 0)
    moment.coupled_dq = track.log->joints[partner].motion.dq[row];
  return moment;
}

std::string FadingDoubt(const JointProblem& problem, const JointModel& model) {
  for (const EffectInstance& effect : model.effects) {
    if (effect.info->type != "time_varying_gain") continue;
    for (const JointTrack& track : problem.tracks()) {
      const double left = 1 + effect.values[0] * track.log->rows * track.log->dt;
      if (left < kLeastDrive)
        return absl::StrFormat("the drive would fade to %.0f %% within %s", 100 * left,
                               track.log->file);
    }
  }
  return "";
}

// The torque that another joint's acceleration brings is known as well as that acceleration.
std::string CouplingDoubt(const JointProblem& problem, const JointModel& model) {
  for (const EffectInstance& effect : model.effects) {
    if (effect.info->type != "cross_joint_inertia") continue;
    double added = 0, known = 0;
    for (const JointTrack& track : problem.tracks()) {
      const std::vector<double>& ddq = track.log->joints[effect.partner].motion.ddq;
      for (size_t row = 0; row < ddq.size() && !track.single; ++row) {
        added += std::pow(effect.values[0] * ddq[row], 2);
        known += std::pow(track.rows[row].coupling, 2);
      }
    }
    const double share = known > 0 ? std::sqrt(added / known) : 1;
    if (share < kKnownCoupling)
      return absl::StrFormat(
          "cross_joint_inertia is %.1f %% of the torque that couples the joints by the model, and "
          "smoothed accelerations leave up to %.0f %%",
          100 * share, 100 * kKnownCoupling);
  }
  return "";
}

}  // namespace

bool IsAbsence(const Hypothesis& h, int free) {
  const FreeParameter& parameter = h.free[free];
  const double x = h.x[free];
  if (IsFlatCurve(h, parameter.path)) return true;
  if (parameter.lower != 0 || parameter.upper - x < x - parameter.lower) return false;
  for (const EffectInstance& effect : h.model.effects) {
    const std::string prefix = effect.info->type + ".";
    if (!absl::StartsWith(parameter.path, prefix)) continue;
    return std::any_of(effect.info->amplitudes.begin(), effect.info->amplitudes.end(), [&](int i) {
      return prefix + effect.info->parameters[i].name == parameter.path;
    });
  }
  return parameter.path == "damping" || parameter.path == "frictionloss" ||
         parameter.path == "armature" || parameter.path == "servo.kd";
}

std::string ParameterDoubt(const JointFit& fit, const std::vector<double>& std,
                           const std::string& effect) {
  const Hypothesis& best = fit.best;
  for (size_t i = 0; i < best.free.size(); ++i) {
    const FreeParameter& free = best.free[i];
    if (!absl::StartsWith(free.path, effect + ".") || IsAbsence(best, static_cast<int>(i)))
      continue;
    const double value = free.ToValue(best.x[static_cast<int>(i)]);
    if (fit.at_bound[i]) return absl::StrFormat("%s is on a bound, %.3g", free.path, value);
    if (!(std[i] > 0) || !std::isfinite(std[i]))
      return absl::StrFormat("%s, %.3g, has no standard error: the data do not say it", free.path,
                             value);
  }
  return "";
}

std::string PhysicalDoubt(const JointProblem& problem, const JointFit& fit,
                          const std::vector<double>& std) {
  JointModel model = ModelAt(fit.best, fit.best.x);
  if (std::string fading = FadingDoubt(problem, model); !fading.empty()) return fading;
  if (std::string coupling = CouplingDoubt(problem, model); !coupling.empty()) return coupling;
  std::erase_if(model.effects, [](const EffectInstance& effect) { return !Rubs(effect); });
  if (model.effects.empty()) return "";
  EffectChain chain(model);
  const FrictionError error = ErrorOfFriction(fit, std);
  double worst = 0;
  std::string doubt;
  for (const JointTrack& track : problem.tracks()) {
    for (int row = 0; row < track.log->rows; row += kRowStep) {
      const JointMoment moment = MomentAt(model, track, row);
      const Resistance r = ResistanceAt(model, chain, moment);
      // Another joint may pull this one along, and then resists it the other way.
      const double least =
          PartnerOf(model) >= 0 ? 0.5 * (r.forward + r.backward) : std::min(r.forward, r.backward);
      const double excess = -least - kSlack * r.parts;
      const double allowed = kSigmas * error.At(moment.dq);
      if (excess - allowed <= worst) continue;
      worst = excess - allowed;
      doubt = absl::StrFormat(
          "friction would be %.3g at %.3g rad and %.3g rad/s %s: no joint is driven by its "
          "friction",
          least, moment.q, std::abs(moment.dq), r.forward < r.backward ? "forwards" : "backwards");
    }
  }
  return doubt;
}

}  // namespace robostress::calibration
