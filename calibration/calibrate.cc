#include "calibration/calibrate.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/data/local_polynomial.h"
#include "calibration/model/unit_check.h"
#include "calibration/report/joint_description.h"
#include "calibration/search/aided_motion.h"
#include "calibration/search/command_shape.h"
#include "calibration/search/shared_support.h"
#include "calibration/search/verdict.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kMorePasses = 2;  // over the joints of an arm

std::vector<std::string> TypesOf(const JointReport& joint) {
  std::vector<std::string> types;
  for (const AddedEffectReport& effect : joint.effects) types.push_back(effect.type);
  return types;
}

const char* RoleName(LogRole role) {
  return role == LogRole::kFit ? "fit" : role == LogRole::kHeldOut ? "held_out" : "transfer";
}

// Of input inverse a torque is compared: its noise is that of tau and of the acceleration.
void NoiseOfTorques(const Rig& rig, const Plant& plant, std::vector<MeasuredLog>& logs) {
  for (int joint = 0; joint < static_cast<int>(rig.joints.size()); ++joint) {
    if (rig.joints[joint].input != JointInput::kInverse) continue;
    for (MeasuredLog& log : logs) {
      JointRecord& record = log.joints[joint];
      const double inertia = plant.Rows(joint, log).front().inertia + plant.passive(joint).armature;
      record.noise = std::hypot(NoiseOfReading(record.tau), inertia * record.acceleration_noise);
      record.timing_noise = 0;
      record.drawn = false;
    }
  }
}

// Equal delays are a property of what the joints share.
void CompareJoints(CalibrationReport& report) {
  std::vector<double> delays;
  for (const JointReport& joint : report.joints)
    for (const AddedEffectReport& effect : joint.effects)
      for (const ParameterReport& parameter : effect.parameters)
        if (parameter.name == "delay_s") delays.push_back(parameter.value);
  if (delays.size() < 2) return;
  const auto [low, high] = std::minmax_element(delays.begin(), delays.end());
  if (delays.size() == report.joints.size() && *high - *low < 0.2 * *high)
    report.evidence.push_back(
        absl::StrFormat("every joint has the same delay, %.2f to %.2f ms: a property of the "
                        "channel (bus, sampling), not of a joint",
                        *low * 1e3, *high * 1e3));
}

bool HasFound(const CalibrationReport& report, const std::string& joint,
              const AddedEffectReport& effect) {
  for (const JointReport& other : report.joints) {
    if (other.joint != joint) continue;
    return std::any_of(other.effects.begin(), other.effects.end(),
                       [&](const AddedEffectReport& own) { return Agree(own, effect); });
  }
  return false;
}

// Effects of the whole arm are claimed where other joints bear them out.
absl::Status AskTheArm(const Rig& rig, const Rig& after, const Plant& plant,
                       const std::vector<MeasuredLog>& logs, CalibrationReport& report) {
  if (after.joints.size() < 2) return absl::OkStatus();
  for (JointReport& joint : report.joints) {
    if (joint.verdict != Verdict::kAttributed && joint.verdict != Verdict::kAmbiguous) continue;
    for (int i = 0; i < static_cast<int>(after.joints.size()); ++i) {
      if (after.joints[i].name != joint.joint) continue;
      for (const DeclaredEffect& effect : after.joints[i].effects) {
        const auto added = std::find_if(joint.effects.begin(), joint.effects.end(),
                                        [&](const auto& e) { return e.type == effect.type; });
        if (added == joint.effects.end() || !ActsOnTheWholeArm(effect.type)) continue;
        RS_ASSIGN_OR_RETURN(
            std::vector<OtherJoint> others,
            AskOtherJoints(WithOtherFindings(rig, after, effect.type), plant, logs, i, effect));
        for (OtherJoint& other : others) other.agrees = HasFound(report, other.joint, *added);
        const std::string objection = ObjectionOf(effect.type, others);
        if (objection.empty()) continue;
        joint.verdict = Verdict::kReducedNotAttributed;
        joint.because += "; but " + objection;
      }
    }
  }
  return absl::OkStatus();
}

absl::Status CheckChosen(const Rig& rig, const std::vector<std::string>& chosen) {
  std::vector<std::string> names;
  for (const RigJoint& joint : rig.joints) names.push_back(joint.name);
  for (const std::string& name : chosen) {
    if (std::find(names.begin(), names.end(), name) == names.end())
      return absl::InvalidArgumentError(absl::StrCat("joints: the rig ", rig.file,
                                                     " has no joint '", name, "'; it has ",
                                                     absl::StrJoin(names, ", ")));
  }
  return absl::OkStatus();
}

// `h`: what was fitted and added.
void WriteJoint(const Rig& rig, const Hypothesis& h, RigJoint& after) {
  JointModel model = ModelAt(h, h.x);
  for (const FreeParameter& free : h.free) {
    const auto value = FindValue(model, free.path);
    if (value.ok() && free.path.find('.') == std::string::npos)
      after.parameters[free.path] = **value;
  }
  after.servo = model.servo;
  after.effects.clear();
  for (const EffectInstance& instance : model.effects) {
    DeclaredEffect effect;
    effect.type = instance.info->type;
    for (size_t i = 0; i < instance.values.size(); ++i)
      effect.parameters[instance.info->parameters[i].name] = instance.values[i];
    if (instance.partner >= 0) effect.partner = rig.joints[instance.partner].name;
    after.effects.push_back(std::move(effect));
  }
}

// Of `joints`; `after` gets what was found.
absl::StatusOr<std::vector<JointReport>> TraceJoints(const Rig& rig, const Plant& plant,
                                                     const std::vector<MeasuredLog>& logs,
                                                     const std::vector<int>& joints,
                                                     const TraceOptions& options, Rig& after) {
  std::vector<JointReport> reports;
  std::vector<std::string> leads;
  for (const int i : joints) {
    TraceOptions own = options;
    own.progress = [&](const std::string& text) {
      options.progress(absl::StrCat(rig.joints[i].name, ": ", text));
    };
    JointCase joint(rig, plant, logs, i);
    RS_ASSIGN_OR_RETURN(const Finding finding, SearchJoint(joint, leads, own));
    reports.push_back(DescribeJoint(joint, finding));
    WriteJoint(rig, finding.trace.after.fit.best, after.joints[i]);
    for (const std::string& type : TypesOf(reports.back())) leads.push_back(type);
  }
  return reports;
}

// Joints to trace again: another one lacked something, which its motion had and this joint felt.
// What a model without it explains to the noise stays so.
std::vector<int> OpenJoints(const Rig& rig, const CalibrationReport& report) {
  std::vector<int> open;
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i)
    for (const JointReport& joint : report.joints) {
      if (joint.joint != rig.joints[i].name || joint.verdict == Verdict::kDeclaredSufficient ||
          joint.verdict == Verdict::kNotTestable)
        continue;
      if (std::any_of(report.joints.begin(), report.joints.end(), [&](const JointReport& other) {
            return other.joint != joint.joint && !other.effects.empty();
          }))
        open.push_back(i);
    }
  return open;
}

// Without the rig's joints that are not traced.
std::vector<ModelFact> FactsOf(const Rig& rig, const Plant& plant,
                               const std::vector<std::string>& chosen) {
  std::vector<ModelFact> facts = plant.facts();
  if (chosen.empty()) return facts;
  std::erase_if(facts, [&](const ModelFact& fact) {
    const auto is = [&](const RigJoint& joint) { return joint.name == fact.part; };
    return std::any_of(rig.joints.begin(), rig.joints.end(), is) &&
           std::find(chosen.begin(), chosen.end(), fact.part) == chosen.end();
  });
  return facts;
}

}  // namespace

absl::StatusOr<Calibration> Calibrate(const Rig& rig, const TraceOptions& options) {
  const auto begin = std::chrono::steady_clock::now();
  RS_RETURN_IF_ERROR(CheckChosen(rig, options.joints));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Plant> plant, Plant::Load(rig));
  std::vector<MeasuredLog> logs;
  for (const RigLog& log : rig.logs) {
    RS_ASSIGN_OR_RETURN(MeasuredLog read, ReadMeasuredLog(rig, log));
    logs.push_back(std::move(read));
  }
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> unchecked, CheckUnits(rig, *plant, logs));
  NoiseOfTorques(rig, *plant, logs);
  RS_RETURN_IF_ERROR(ChooseCommandShapes(rig, *plant, logs));
  if (!plant->single()) {
    options.progress("motions of the arm");
    RS_RETURN_IF_ERROR(AidArmMotions(rig, *plant, logs));
  }
  Calibration result;
  result.after = rig;
  CalibrationReport& report = result.report;
  report.rig = rig.name;
  report.rig_file = rig.file;
  report.model = rig.model;
  for (const MeasuredLog& log : logs)
    report.logs.push_back(
        {log.file, RoleName(log.role), log.condition, log.rows, log.rows * log.dt, log.notes});
  report.model_facts = FactsOf(rig, *plant, options.joints);
  std::vector<int> joints;
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    const auto& chosen = options.joints;
    if (chosen.empty() ||
        std::find(chosen.begin(), chosen.end(), rig.joints[i].name) != chosen.end())
      joints.push_back(i);
  }
  RS_ASSIGN_OR_RETURN(report.joints, TraceJoints(rig, *plant, logs, joints, options, result.after));
  // What a joint lacks was in its motion too, which the others feel.
  for (int pass = 0; pass < kMorePasses && !plant->single(); ++pass) {
    const std::vector<int> open = OpenJoints(rig, report);
    if (open.empty()) break;
    options.progress("motions of the arm with what was found");
    RS_RETURN_IF_ERROR(AidArmMotions(result.after, *plant, logs));
    RS_ASSIGN_OR_RETURN(std::vector<JointReport> again,
                        TraceJoints(rig, *plant, logs, open, options, result.after));
    bool changed = false;
    for (JointReport& joint : again)
      for (JointReport& before : report.joints)
        if (before.joint == joint.joint) {
          changed |= TypesOf(before) != TypesOf(joint);
          before = std::move(joint);
          break;
        }
    if (!changed) break;
  }
  options.progress("asking other joints");
  RS_RETURN_IF_ERROR(AskTheArm(rig, result.after, *plant, logs, report));
  for (JointReport& joint : report.joints)
    if (std::find(unchecked.begin(), unchecked.end(), joint.joint) != unchecked.end())
      absl::StrAppend(&joint.because, "; units of ", joint.joint, " could not be checked");
  report.verdict = Combine(report.joints);
  for (const JointReport& joint : report.joints)
    report.because +=
        absl::StrCat(report.because.empty() ? "" : "; ", joint.joint, ": ", joint.because);
  CompareJoints(report);
  const auto was_searched = [](const JointReport& joint) { return !joint.rounds.empty(); };
  if (std::any_of(report.joints.begin(), report.joints.end(), was_searched))
    report.n_surrogates = options.surrogates;
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
  report.elapsed_s = elapsed.count();
  return result;
}

}  // namespace robostress::calibration
