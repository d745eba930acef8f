#include "server/proxy/arm_profile.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include "absl/algorithm/container.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/status_macros.h"
#include "common/wire/openpi_dialect.h"

namespace robostress {
namespace {

// A correction is there to win back what an arm falls short by, not to drive it.
constexpr double kMostFullSteps = 1, kMostJointCorrection = 0.2;  // [rad]

absl::Status CheckWithin(const char* field, double value, double low, double high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be ", low, "..", high);
}

// A full step, or 0 for the unit's.
absl::Status CheckFull(const char* field, double value, double most) {
  return value == 0 ? absl::OkStatus() : CheckWithin(field, value, 1e-4, most);
}

// `count` of them, or none where `optional`; each within [0, below), none twice in `taken`.
absl::Status CheckIndices(const char* field, const std::vector<int>& indices, size_t count,
                          bool optional, int below, std::set<int>& taken) {
  if (indices.size() != count && !(optional && indices.empty())) {
    return Invalid(field, " names ", indices.size(), " indices, must name ", count,
                   optional ? " or none" : "");
  }
  for (const int index : indices) {
    if (index < 0 || index >= below)
      return Invalid(field, " names index ", index, ", must be 0..", below - 1);
    if (!taken.insert(index).second)
      return Invalid(field, " names index ", index, ", which stands for something else already");
  }
  return absl::OkStatus();
}

absl::Status CheckSpace(const std::string& space) {
  if (space == "end_effector" || space == "joint") return absl::OkStatus();
  return Invalid(
      "control_space is '", space,
      "'; understood are end_effector (deltas of the tool) and joint (absolute targets). "
      "In any other space a correction would be a guess: connect the client directly");
}

absl::Status CheckLayouts(const ArmProfile& p) {
  std::set<int> state, action;
  const int numbers = WireLimits::kStateDim;
  RS_RETURN_IF_ERROR(CheckRange("action.size", static_cast<uint64_t>(std::max(0, p.action.size)), 1,
                                WireLimits::kActionDim));
  if (p.joint_space()) {
    if (!p.action.translation.empty() || !p.action.rotation.empty())
      return Invalid("action.translation and action.rotation belong to control_space end_effector");
    const size_t joints = p.action.joints.size();
    RS_RETURN_IF_ERROR(CheckRange("action.joints (their number)", joints, 1, WireLimits::kDof));
    RS_RETURN_IF_ERROR(
        CheckIndices("action.joints", p.action.joints, joints, false, p.action.size, action));
    RS_RETURN_IF_ERROR(CheckIndices("state.joints", p.state.joints, joints, false, numbers, state));
    if (!p.joint_names.empty() && p.joint_names.size() != joints) {
      return Invalid("joint_names names ", p.joint_names.size(), " joints, action.joints ", joints);
    }
    std::set<std::string> names;
    for (const std::string& name : p.joint_names) {
      RS_RETURN_IF_ERROR(CheckName("joint_names", name));
      if (!names.insert(name).second)
        return Invalid("joint_names names '", name, "' twice; a record has a column for each");
    }
    return absl::OkStatus();
  }
  if (!p.action.joints.empty() || !p.state.joints.empty())
    return Invalid("action.joints and state.joints belong to control_space joint");
  if (!p.joint_names.empty()) return Invalid("joint_names belongs to control_space joint");
  RS_RETURN_IF_ERROR(
      CheckIndices("action.translation", p.action.translation, 3, false, p.action.size, action));
  RS_RETURN_IF_ERROR(
      CheckIndices("action.rotation", p.action.rotation, 3, true, p.action.size, action));
  RS_RETURN_IF_ERROR(CheckIndices("state.position", p.state.position, 3, false, numbers, state));
  const bool axis_angle = p.state.rotation_form == "axis_angle";
  if (!axis_angle && p.state.rotation_form != "quaternion_wxyz" &&
      p.state.rotation_form != "quaternion_xyzw") {
    return Invalid("state.rotation_form is '", p.state.rotation_form,
                   "', must be axis_angle, quaternion_wxyz or quaternion_xyzw");
  }
  RS_RETURN_IF_ERROR(CheckIndices("state.rotation", p.state.rotation, axis_angle ? 3 : 4,
                                  p.action.rotation.empty(), numbers, state));
  RS_RETURN_IF_ERROR(CheckWithin("action.translation_unit", p.action.translation_unit, 1e-4, 10));
  RS_RETURN_IF_ERROR(CheckFull("action.translation_full", p.action.translation_full, 1));
  RS_RETURN_IF_ERROR(CheckWithin("action.rotation_unit", p.action.rotation_unit, 1e-4, 10));
  return CheckFull("action.rotation_full", p.action.rotation_full, 3);
}

absl::Status CheckBounds(const ActionLayout& action) {
  if (action.low.empty() && action.high.empty()) return absl::OkStatus();
  const auto size = static_cast<size_t>(action.size);
  if (action.low.size() != size || action.high.size() != size) {
    return Invalid("action.low has ", action.low.size(), " and action.high ", action.high.size(),
                   " values; both must have ", size, ", or none");
  }
  for (size_t i = 0; i < size; ++i) {
    if (!(action.low[i] <= action.high[i]))
      return Invalid("action.low[", i, "] is ", action.low[i], ", above action.high's ",
                     action.high[i]);
  }
  return absl::OkStatus();
}

// One for all, one each, or none.
Eigen::VectorXd Spread(const std::vector<double>& values, Eigen::Index count) {
  if (values.size() == 1) return Eigen::VectorXd::Constant(count, values[0]);
  return Eigen::Map<const Eigen::VectorXd>(values.data(), count);
}

absl::Status CheckLimits(const ArmProfile& p) {
  const size_t columns = p.columns().size();
  for (const auto& [field, values] :
       {std::pair{"limits.correction", &p.limits.correction}, {"limits.rate", &p.limits.rate}}) {
    if (values->size() > 1 && values->size() != columns) {
      return Invalid(field, " has ", values->size(), " values, must have one, or one for each of ",
                     columns, " corrected columns");
    }
    for (const double value : *values) {
      if (!(value >= 0 && value < 1e6)) return Invalid(field, " holds ", value, ", must be 0..1e6");
    }
  }
  const double most = p.joint_space() ? kMostJointCorrection : kMostFullSteps;
  const Eigen::VectorXd limit = p.correction_limit(), step = p.step_limit();
  for (Eigen::Index i = 0; i < limit.size(); ++i) {
    if (limit[i] > most * (1 + 1e-9)) {
      return Invalid("limits.correction of ", p.axes()[static_cast<size_t>(i)], " is ",
                     limit[i] / p.scale()[i], ", must be at most ", most / p.scale()[i],
                     p.joint_space() ? " rad" : ", a full step",
                     "; an arm that needs more needs repair");
    }
    if (limit[i] > 0 && !(step[i] > 0))
      return Invalid("limits.rate of ", p.axes()[static_cast<size_t>(i)],
                     " is 0: the correction would never begin; set limits.correction to 0 instead");
  }
  RS_RETURN_IF_ERROR(CheckWithin("limits.jump_m", p.limits.jump_m, 0, 1));
  RS_RETURN_IF_ERROR(CheckWithin("limits.jump_rad", p.limits.jump_rad, 0, 3));
  return CheckWithin("limits.pause_s", p.limits.pause_s, 0, 3600);
}

// Displacement for a steady command of 1, per control step.
double SteadyGain(const NominalArmOptions& options) {
  NominalArm arm(options);
  double moved = 0;
  for (int i = 0; i < 400; ++i) moved = arm.Step(NominalArm::Vector6::Constant(0.5))[0] / 0.5;
  return moved;
}

}  // namespace

std::vector<int> ArmProfile::columns() const {
  if (joint_space()) return action.joints;
  std::vector<int> columns = action.translation;
  columns.insert(columns.end(), action.rotation.begin(), action.rotation.end());
  return columns;
}

std::vector<std::string> ArmProfile::axes() const {
  if (!joint_space()) {
    std::vector<std::string> axes = {"x", "y", "z", "roll", "pitch", "yaw"};
    axes.resize(columns().size());
    return axes;
  }
  if (!joint_names.empty()) return joint_names;
  std::vector<std::string> axes;
  for (size_t i = 1; i <= action.joints.size(); ++i) axes.push_back(absl::StrCat("joint_", i));
  return axes;
}

Eigen::VectorXd ArmProfile::scale() const {
  const auto count = static_cast<Eigen::Index>(columns().size());
  Eigen::VectorXd scale = Eigen::VectorXd::Ones(count);
  if (joint_space()) return scale;
  const auto of = [](double unit, double full) { return full > 0 ? unit / full : 1; };
  scale.head(3).setConstant(of(action.translation_unit, action.translation_full));
  if (count > 3) scale.tail(3).setConstant(of(action.rotation_unit, action.rotation_full));
  return scale;
}

Eigen::VectorXd ArmProfile::correction_limit() const {
  const Eigen::VectorXd scale = this->scale();
  if (limits.correction.empty())
    return Eigen::VectorXd::Constant(scale.size(), joint_space() ? 0.05 : 0.5);
  return Spread(limits.correction, scale.size()).cwiseProduct(scale);
}

Eigen::VectorXd ArmProfile::step_limit() const {
  if (limits.rate.empty()) return 4 * correction_limit() / rate_hz;
  const Eigen::VectorXd scale = this->scale();
  return Spread(limits.rate, scale.size()).cwiseProduct(scale) / rate_hz;
}

NominalArmOptions ArmProfile::nominal_arm() const {
  return {.goal_reference = nominal.goal_reference,
          .control_period_s = 1 / rate_hz,
          .sub_steps = nominal.sub_steps,
          .kp = nominal.stiffness,
          .damping_ratio = nominal.damping_ratio};
}

absl::Status CheckArmProfile(const ArmProfile& profile) {
  RS_RETURN_IF_ERROR(CheckSpace(profile.control_space));
  RS_RETURN_IF_ERROR(CheckName("name", profile.name));
  RS_RETURN_IF_ERROR(CheckWithin("rate_hz", profile.rate_hz, 0.1, 1000));
  RS_RETURN_IF_ERROR(CheckWithin("first_step", profile.first_step, 0, WireLimits::kHorizon - 1));
  RS_RETURN_IF_ERROR(CheckWithin("execute_steps", profile.execute_steps, 1,
                                 WireLimits::kHorizon - profile.first_step));
  if (profile.asynchronous && (profile.first_step != 0 || !profile.real_time)) {
    return Invalid("asynchronous: the row that is due follows from the clock; set first_step to 0 ",
                   "and real_time to true");
  }
  RS_RETURN_IF_ERROR(CheckWithin("nominal.stiffness", profile.nominal.stiffness, 1, 1e5));
  RS_RETURN_IF_ERROR(CheckWithin("nominal.damping_ratio", profile.nominal.damping_ratio, 0.1, 10));
  RS_RETURN_IF_ERROR(CheckWithin("nominal.sub_steps", profile.nominal.sub_steps, 1, 1000));
  RS_RETURN_IF_ERROR(CheckWithin("observer_bandwidth", profile.observer_bandwidth, 0.01, 100));
  RS_RETURN_IF_ERROR(CheckLayouts(profile));
  RS_RETURN_IF_ERROR(CheckBounds(profile.action));
  if (!profile.joint_space()) {
    const double gain = SteadyGain(profile.nominal_arm());
    if (!(gain > 0.01 && gain < 10)) {
      return Invalid("nominal: a steady command of 1 moves that arm by ", gain,
                     " in a control step, must be 0.01..10; raise sub_steps, or correct stiffness");
    }
  }
  return CheckLimits(profile);
}

absl::StatusOr<ArmProfile> LoadArmProfile(const std::string& file) {
  RS_ASSIGN_OR_RETURN(ArmProfile profile, LoadConfig<ArmProfile>(file));
  if (absl::EndsWith(profile.dialect, ".yaml")) {
    const auto beside = std::filesystem::path(file).parent_path() / profile.dialect;
    RS_ASSIGN_OR_RETURN(profile.keys, LoadConfig<OpenpiDialect>(beside.string()));
  } else {
    RS_ASSIGN_OR_RETURN(profile.keys, OpenpiDialectNamed(profile.dialect));
  }
  absl::Status checked = CheckArmProfile(profile);
  if (checked.ok() && profile.keys.state.empty())
    checked = Invalid("dialect ", profile.dialect, " has no keys of a state");
  if (!checked.ok()) return Invalid(file, ": ", checked.message());
  return profile;
}

absl::StatusOr<MethodOptions> MethodOf(const ArmProfile& profile,
                                       const std::vector<std::string>& overrides) {
  std::vector<std::string> all = profile.method_options;
  all.insert(all.end(), overrides.begin(), overrides.end());
  const auto has = [&all](const char* key) {
    return absl::c_any_of(all, [key](const std::string& text) {
      return absl::StartsWith(text, absl::StrCat(key, "="));
    });
  };
  if (!profile.joint_space() && !has("tracking_gain"))
    all.push_back(absl::StrCat("tracking_gain=", SteadyGain(profile.nominal_arm())));
  RS_ASSIGN_OR_RETURN(MethodOptions method, MakeMethod(profile.method, all));
  if (!has("envelope_share") && (method.Find<IntegralOptions>() || method.Find<FollowingOptions>()))
    method.Add(EnvelopeOptions{.share = EnvelopeOptions::kShare});
  RS_RETURN_IF_ERROR(method.Check());
  const auto refuse = [&](const char* why) {
    return Invalid("method ", profile.method, " ", why,
                   profile.joint_space()
                       ? "; take dob, direct or base"
                       : "; take ours_following, ours_integral, direct, gain or base");
  };
  if (method.adapts()) return refuse("adapts weights, and the proxy has none");
  if (method.panda_dynamics)
    return refuse("has panda_dynamics, which needs joint positions that no arm here reports");
  if (method.observation != ObservationInput::kFull)
    return refuse("changes what the policy sees, and the proxy passes observations as they are");
  if (method.noise_stream != "policy")
    return refuse("draws other sampling noise, which is the server's affair");
  if (method.execute_steps != 0) return refuse("sets execute_steps, which the client decides");
  if (method.observer && !profile.joint_space()) return refuse("observes joints");
  if (profile.joint_space()) {
    if (absl::Status fits = method.CheckJointSpace(profile.name); !fits.ok())
      return Invalid(fits.message(), "; in the proxy: method dob");
  }
  return method;
}

}  // namespace robostress
