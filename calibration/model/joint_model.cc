#include "calibration/model/joint_model.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

// A declared effect must say its numbers, except those that are fitted or fixed.
absl::StatusOr<EffectInstance> MakeInstance(const RigJoint& joint, const DeclaredEffect& declared) {
  EffectInstance instance;
  RS_ASSIGN_OR_RETURN(instance.info, FindEffect(declared.type));
  for (const EffectParameter& parameter : instance.info->parameters) {
    const auto given = declared.parameters.find(parameter.name);
    if (given != declared.parameters.end()) {
      instance.values.push_back(given->second);
    } else if (parameter.fixed) {
      instance.values.push_back(parameter.starts.front());
    } else {
      return absl::InvalidArgumentError(absl::StrCat("joint '", joint.name, "': declared effect '",
                                                     declared.type, "' has no value of '",
                                                     parameter.name, "' [", parameter.unit, "]"));
    }
  }
  return instance;
}

}  // namespace

absl::StatusOr<JointModel> DeclaredModel(const Rig& rig, const Plant& plant, int index) {
  const RigJoint& joint = rig.joints[index];
  JointModel model;
  model.input = joint.input;
  model.hinge = plant.hinge(index);
  model.servo = joint.servo;
  if (model.servo.type == Servo::Type::kPd && !std::isfinite(model.servo.torque_limit))
    model.servo.torque_limit = plant.effort_limit(index);
  const PlantPassive passive = plant.passive(index);
  model.armature = passive.armature;
  model.damping = passive.damping;
  model.frictionloss = passive.frictionloss;
  model.stiffness = passive.stiffness;
  model.spring_rest = passive.spring_rest;
  for (const DeclaredEffect& declared : joint.effects) {
    RS_ASSIGN_OR_RETURN(EffectInstance instance, MakeInstance(joint, declared));
    for (size_t i = 0; i < rig.joints.size(); ++i)
      if (rig.joints[i].name == declared.partner) instance.partner = static_cast<int>(i);
    if (instance.info->coupled && (instance.partner < 0 || instance.partner == index))
      return absl::InvalidArgumentError(
          absl::StrCat(rig.file, ": joint '", joint.name, "': ", declared.type, ": partner is '",
                       declared.partner, "', must be another joint of the rig"));
    if (const int known = PartnerOf(model);
        known >= 0 && instance.partner >= 0 && instance.partner != known)
      return absl::InvalidArgumentError(absl::StrCat(
          rig.file, ": joint '", joint.name, "': ", declared.type, ": partner is '",
          declared.partner, "', must be ", rig.joints[known].name,
          ", the partner of its other effects: a joint is coupled to one other joint"));
    model.effects.push_back(std::move(instance));
  }
  for (const auto& [name, value] : joint.parameters) {
    RS_ASSIGN_OR_RETURN(double* target, FindValue(model, name));
    *target = value;
  }
  return model;
}

int PartnerOf(const JointModel& model) {
  for (const EffectInstance& effect : model.effects)
    if (effect.partner >= 0) return effect.partner;
  return -1;
}

absl::StatusOr<double*> FindValue(JointModel& model, const std::string& path) {
  const std::vector<std::pair<std::string, double*>> values = {
      {"armature", &model.armature},
      {"mass_scale", &model.mass_scale},
      {"damping", &model.damping},
      {"frictionloss", &model.frictionloss},
      {"servo.kp", &model.servo.kp},
      {"servo.kd", &model.servo.kd},
      {"servo.torque_limit", &model.servo.torque_limit},
      {"servo.kt", &model.servo.kt},
      {"servo.R", &model.servo.R},
      {"servo.vin", &model.servo.vin},
      {"torque_offset", &model.torque_offset},
      {"torque_gain", &model.torque_gain},
      {"position_offset", &model.position_offset},
      {"command_shift", &model.command_shift},
      {"force_lag", &model.force_lag}};
  std::vector<std::string> known;
  for (const auto& [name, value] : values) {
    if (name == path) return value;
    known.push_back(name);
  }
  for (EffectInstance& effect : model.effects) {
    for (size_t i = 0; i < effect.values.size(); ++i) {
      const std::string name =
          absl::StrCat(effect.info->type, ".", effect.info->parameters[i].name);
      if (name == path) return &effect.values[i];
      known.push_back(name);
    }
  }
  return absl::NotFoundError(
      absl::StrCat("'", path, "' is no parameter; known: ", absl::StrJoin(known, ", ")));
}

absl::StatusOr<JointModel> WithOverrides(JointModel model, const std::string& joint,
                                         const std::map<std::string, double>& overrides) {
  for (const auto& [key, value] : overrides) {
    absl::string_view path = key;
    if (!absl::ConsumePrefix(&path, joint + ".")) continue;
    if (path == kKnownMass) continue;  // of the plant (MakeTracks)
    const absl::StatusOr<double*> target = FindValue(model, std::string(path));
    if (!target.ok())
      return absl::InvalidArgumentError(
          absl::StrCat("override '", key, "': ", target.status().message(), ", ", kKnownMass));
    **target = value;
  }
  return model;
}

}  // namespace robostress::calibration
