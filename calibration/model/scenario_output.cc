#include "calibration/model/scenario_output.h"

#include <algorithm>
#include <cctype>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kOwn[] = "own";

// The arm's joint that a joint's own name tells, or -1.
int OwnJoint(const RobotDescription& arm, const std::string& name) {
  const size_t at = name.rfind("joint");
  return FindJoint(arm, at == std::string::npos ? name : absl::StrCat("J", name.substr(at + 5)));
}

std::string JointNames(const Rig& rig) {
  return absl::StrJoin(rig.joints, ", ", [](std::string* out, const RigJoint& joint) {
    absl::StrAppend(out, joint.name);
  });
}

absl::Status ReadEntry(const std::string& entry, const Rig& rig, const RobotDescription& arm,
                       JointMap& map) {
  const auto error = [&](const std::string& what) {
    return absl::InvalidArgumentError(absl::StrCat("--map '", entry, "': ", what,
                                                   "; give JOINT=J4, JOINT=J2+J4, JOINT=J4:RATIO "
                                                   "or own; the rig's joints are ",
                                                   JointNames(rig)));
  };
  const std::vector<std::string> sides = absl::StrSplit(entry, absl::MaxSplits('=', 1));
  if (sides.size() != 2) return error("has no '='");
  const bool known = std::any_of(rig.joints.begin(), rig.joints.end(),
                                 [&](const RigJoint& joint) { return joint.name == sides[0]; });
  if (!known) return error(absl::StrCat("the rig has no joint '", sides[0], "'"));
  const std::vector<std::string> parts = absl::StrSplit(sides[1], absl::MaxSplits(':', 1));
  MappedJoint mapped;
  if (parts.size() == 2 && (!absl::SimpleAtod(parts[1], &mapped.torque_ratio) ||
                            !(mapped.torque_ratio > 0 && mapped.torque_ratio < 1e6)))
    return error(absl::StrCat("'", parts[1], "' is no ratio above 0"));
  for (const absl::string_view name : absl::StrSplit(parts[0], '+')) {
    const int joint = FindJoint(arm, name);
    if (joint < 0) return error(absl::StrCat("'", name, "' is not one of ", KnownJoints(arm)));
    mapped.arm_joints.push_back(joint);
  }
  if (!map.emplace(sides[0], mapped).second)
    return error(absl::StrCat("joint '", sides[0], "' is mapped twice"));
  return absl::OkStatus();
}

// Whether a parameter grows with the torques of its joint.
bool IsOfTorque(EffectScale scale) {
  switch (scale) {
    case EffectScale::kTorque:
    case EffectScale::kTorquePerPosition:
    case EffectScale::kTorquePerPosition2:
    case EffectScale::kTorquePerPosition3:
    case EffectScale::kTorquePerVelocity:
    case EffectScale::kTorquePerVelocity2:
    case EffectScale::kTorquePerSecond:
    case EffectScale::kPayload:
    case EffectScale::kTorquePerAcceleration:
    case EffectScale::kTorquePerKelvin:
    case EffectScale::kTorquePerVelocityKelvin:
      return true;
    case EffectScale::kOne:
    case EffectScale::kPosition:
    case EffectScale::kVelocity:
    case EffectScale::kSample:
    case EffectScale::kColdest:
      return false;
  }
  return false;
}

bool WasDeclared(const RigJoint& declared, const DeclaredEffect& effect) {
  return std::any_of(declared.effects.begin(), declared.effects.end(),
                     [&](const DeclaredEffect& known) {
                       return known.type == effect.type && known.partner == effect.partner;
                     });
}

// A length or a speed that was fitted as 0 is a limit, of bristles without a way for instance,
// which a scenario holds as the least that it can divide by.
void RaiseDivisors(const EffectInfo& info, const RobotDescription& arm, const std::string& what,
                   ScenarioEffect& effect, std::vector<std::string>& notes) {
  for (size_t i = 0; i < info.parameters.size(); ++i) {
    const EffectParameter& parameter = info.parameters[i];
    const double least = RangeInScenario(info, i, arm, effect.joint).lower;
    double& value = effect.values[i];
    if (parameter.inverse || parameter.lower != 0 || value < 0 || value >= least) continue;
    notes.push_back(absl::StrFormat("%s: %s is written as %.3g %s, the least that a scenario holds",
                                    what, parameter.name, least, parameter.unit));
    value = least;
  }
}

// What a scenario file may hold is said in one place.
absl::Status FitsScenario(const ScenarioEffect& effect, const RobotDescription& arm) {
  ScenarioFile alone;
  alone.title = "scenario";
  alone.effects = {effect};
  const auto checked = ParseScenarioFile("scenario", WriteScenarioFile(alone, arm), arm);
  if (checked.ok()) return absl::OkStatus();
  return absl::OutOfRangeError(
      absl::StrCat(checked.status().message(),
                   "; map to a larger joint or give a torque ratio below 1 (--map JOINT=J4:0.5)"));
}

}  // namespace

absl::StatusOr<JointMap> ParseJointMap(const std::vector<std::string>& arguments, const Rig& rig,
                                       const RobotDescription& arm) {
  JointMap map;
  for (const std::string& argument : arguments) {
    for (const absl::string_view piece : absl::StrSplit(argument, ',')) {
      const std::string entry(piece);
      if (entry != kOwn) {
        RS_RETURN_IF_ERROR(ReadEntry(entry, rig, arm, map));
        continue;
      }
      for (const RigJoint& joint : rig.joints) {
        if (const int own = OwnJoint(arm, joint.name); own >= 0) map[joint.name] = {{own}, 1};
      }
      if (map.empty())
        return absl::InvalidArgumentError(absl::StrCat(
            "--map own: no joint of the rig is called ", KnownJoints(arm), " or joint1 to joint",
            arm.joints.size(), "; its joints are ", JointNames(rig)));
    }
  }
  return map;
}

absl::StatusOr<ScenarioOutput> ScenarioOfRig(const Rig& declared, const Rig& after,
                                             const JointMap& map, const std::string& title,
                                             const RobotDescription& arm) {
  ScenarioOutput output;
  output.scenario.title = title;
  int added = 0;
  for (size_t i = 0; i < after.joints.size(); ++i) {
    const RigJoint& joint = after.joints[i];
    const auto mapped = map.find(joint.name);
    for (const DeclaredEffect& effect : joint.effects) {
      if (i < declared.joints.size() && WasDeclared(declared.joints[i], effect)) continue;
      ++added;
      const std::string what = absl::StrCat(joint.name, ": ", effect.type);
      if (mapped == map.end()) {
        output.notes.push_back(absl::StrCat(what, " is left out: --map does not name the joint"));
        continue;
      }
      RS_ASSIGN_OR_RETURN(const EffectInfo* info, FindEffect(effect.type));
      if (info->of_position) {
        output.notes.push_back(absl::StrCat(
            what, " is left out: scenarios are of arms that are given torques, and ",
            joint.input == JointInput::kTorque ? "have no limit of a torque command's rate"
                                               : "it limits a position command"));
        continue;
      }
      ScenarioEffect found;
      found.type = effect.type;
      for (const EffectParameter& parameter : info->parameters) {
        const auto value = effect.parameters.find(parameter.name);
        const double given =
            value == effect.parameters.end() ? parameter.starts.front() : value->second;
        found.values.push_back(IsOfTorque(parameter.scale) ? given * mapped->second.torque_ratio
                                                           : given);
      }
      if (!effect.partner.empty()) {
        const auto partner = map.find(effect.partner);
        if (partner == map.end() || partner->second.arm_joints.size() != 1) {
          output.notes.push_back(absl::StrCat(what, " is left out: --map must name one joint for ",
                                              effect.partner, ", which it is coupled to"));
          continue;
        }
        found.coupled = partner->second.arm_joints.front();
      }
      for (const int arm_joint : mapped->second.arm_joints) {
        found.joint = arm_joint;
        RaiseDivisors(*info, arm, what, found, output.notes);
        if (absl::Status fits = FitsScenario(found, arm); fits.ok()) {
          output.scenario.effects.push_back(found);
        } else {
          output.notes.push_back(absl::StrCat(what, " is left out: ", fits.message()));
        }
      }
    }
  }
  if (output.scenario.effects.empty())
    return absl::FailedPreconditionError(
        absl::StrCat(after.name, ": no scenario: ",
                     added == 0 ? "no effect was added to the declared model"
                                : absl::StrJoin(output.notes, "; ")));
  return output;
}

}  // namespace robostress::calibration
