#include "calibration/search/shared_support.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/search/joint_case.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kVisible = 2;   // times the floor
constexpr double kGain = 0.02;   // of the error: less is no support
constexpr double kWorse = 0.05;  // of the error
constexpr double kEqual = 0.1;   // of a parameter
constexpr double kErrors = 3;    // standard ones, of a difference

absl::StatusOr<EffectInstance> InstanceOf(const DeclaredEffect& effect) {
  EffectInstance instance;
  RS_ASSIGN_OR_RETURN(instance.info, FindEffect(effect.type));
  for (const EffectParameter& parameter : instance.info->parameters)
    instance.values.push_back(effect.parameters.at(parameter.name));
  return instance;
}

}  // namespace

bool Agree(const AddedEffectReport& one, const AddedEffectReport& other) {
  bool shared = false;
  for (const ParameterReport& a : one.parameters) {
    for (const ParameterReport& b : other.parameters) {
      if (a.name != b.name) continue;
      shared = true;
      const double apart = std::abs(a.value - b.value);
      if (apart > std::max(kEqual * std::max(std::abs(a.value), std::abs(b.value)),
                           kErrors * std::hypot(a.std, b.std)))
        return false;
    }
  }
  return shared && one.type == other.type;
}

bool ActsOnTheWholeArm(const std::string& effect) {
  return effect == "base_tilt" || effect == "payload";
}

std::string ObjectionOf(const std::string& effect, const std::vector<OtherJoint>& others) {
  std::vector<std::string> asked;
  bool supported = false;
  for (const OtherJoint& other : others) {
    supported |= other.agrees;
    if (other.change < kVisible * other.floor) continue;
    asked.push_back(other.joint);
    if (other.with > (1 + kWorse) * other.without && other.with > kVisible * other.floor)
      return absl::StrFormat(
          "%s acts on the whole arm, and %s is predicted worse with it, %.3g "
          "instead of %.3g",
          effect, other.joint, other.with, other.without);
    supported |= other.with < (1 - kGain) * other.without;
  }
  if (supported) return "";
  return asked.empty()
             ? absl::StrCat(effect,
                            " acts on the whole arm, and no other joint shows whether it "
                            "is there")
             : absl::StrCat(effect, " acts on the whole arm, and ", absl::StrJoin(asked, ", "),
                            asked.size() == 1 ? " does" : " do", " without it");
}

Rig WithOtherFindings(Rig rig, const Rig& after, const std::string& type) {
  for (size_t i = 0; i < rig.joints.size(); ++i) {
    std::vector<DeclaredEffect>& effects = rig.joints[i].effects;
    const auto declares = [&](const std::string& name) {
      return std::any_of(effects.begin(), effects.end(),
                         [&](const DeclaredEffect& effect) { return effect.type == name; });
    };
    std::vector<DeclaredEffect> found;
    for (const DeclaredEffect& effect : after.joints[i].effects)
      if (effect.type != type && !declares(effect.type)) found.push_back(effect);
    effects.insert(effects.end(), found.begin(), found.end());
  }
  return rig;
}

absl::StatusOr<std::vector<OtherJoint>> AskOtherJoints(const Rig& rig, const Plant& plant,
                                                       const std::vector<MeasuredLog>& logs,
                                                       int claimant, const DeclaredEffect& effect) {
  RS_ASSIGN_OR_RETURN(const EffectInstance instance, InstanceOf(effect));
  std::vector<OtherJoint> others;
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    if (i == claimant) continue;
    JointCase joint(rig, plant, logs, i);
    const std::vector<JointTrack>& tracks = joint.problem.tracks();
    RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, plant, i));
    const SignalScales scales = MeasureScales(joint.declared(), tracks);
    RS_ASSIGN_OR_RETURN(const Hypothesis start,
                        DeclaredHypothesis(joint.declared(), model, scales, MeanInertia(tracks)));
    joint.problem.LinearizeStarts(model);
    const WindowSet fit = joint.Fit();
    const JointFit without = Minimise(joint.problem, start, fit);
    Hypothesis with = without.best;
    with.model.effects.push_back(instance);
    OtherJoint other{rig.joints[i].name, without.rms, 0, 0, joint.problem.ProjectedFloor(fit)};
    const Eigen::VectorXd change = joint.problem.Projected(ModelAt(with, with.x), fit) -
                                   joint.problem.Projected(ModelAt(without.best, with.x), fit);
    other.change = std::sqrt(change.squaredNorm() / std::max<double>(1, change.size()));
    other.with = Minimise(joint.problem, with, fit).rms;
    others.push_back(std::move(other));
  }
  return others;
}

}  // namespace robostress::calibration
