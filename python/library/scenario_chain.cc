#include "python/library/scenario_chain.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/scenario_file.h"
#include "common/joint_errors/scenarios.h"
#include "common/status_macros.h"
#include "python/library/boundary.h"

namespace robostress {
namespace {

constexpr int kMostJoints = 64;

absl::Status ReadOptions(const robostress_options& from, JointErrorOptions& to) {
  RS_RETURN_IF_ERROR(ReadWord("friction_law", from.friction_law,
                              {Word<FrictionLaw>{"sgn", FrictionLaw::kSgn},
                               {"tanh", FrictionLaw::kTanh},
                               {"stick", FrictionLaw::kStick}},
                              to.friction_law));
  RS_RETURN_IF_ERROR(ReadWord(
      "offset_start", from.offset_start,
      {Word<OffsetStart>{"zero", OffsetStart::kZero}, {"equilibrium", OffsetStart::kEquilibrium}},
      to.offset_start));
  RS_RETURN_IF_ERROR(ReadWord(
      "gravity_sign", from.gravity_sign,
      {Word<GravitySign>{"literal", GravitySign::kLiteral}, {"payload", GravitySign::kPayload}},
      to.gravity_sign));
  to.tanh_width = from.tanh_width;
  if (!(to.tanh_width > 0 && std::isfinite(to.tanh_width))) {
    return absl::InvalidArgumentError(
        absl::StrCat("tanh_width is ", to.tanh_width, " rad/s, must be above 0; 0.01 is usual"));
  }
  if (from.horizon < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("horizon is ", from.horizon, " control steps, must be at least 1"));
  }
  return absl::OkStatus();
}

absl::Status ReadNominal(const double* values, int joints, Scenario& scenario) {
  struct Parameter {
    const char* name;
    double JointErrorParameters::*member;
    bool divided;  // may not be 0
  };
  static constexpr Parameter kParameters[] = {{"Fc", &JointErrorParameters::Fc, false},
                                              {"Fs", &JointErrorParameters::Fs, false},
                                              {"vs", &JointErrorParameters::vs, true},
                                              {"sigma_v", &JointErrorParameters::sigma_v, false},
                                              {"B", &JointErrorParameters::B, false},
                                              {"M_eff", &JointErrorParameters::M_eff, true},
                                              {"D", &JointErrorParameters::D, true},
                                              {"K", &JointErrorParameters::K, true},
                                              {"beta", &JointErrorParameters::beta, false}};
  scenario.nominal.assign(static_cast<size_t>(joints), {});
  for (int joint = 0; joint < joints; ++joint) {
    for (const Parameter& parameter : kParameters) {
      const double value = *values++;
      scenario.nominal[static_cast<size_t>(joint)].*parameter.member = value;
      if (std::isfinite(value) && (parameter.divided ? value > 0 : value >= 0)) continue;
      return absl::InvalidArgumentError(absl::StrCat("nominal[", joint, "].", parameter.name,
                                                     " is ", value, ", must be finite and ",
                                                     parameter.divided ? "above 0" : "at least 0"));
    }
  }
  return absl::OkStatus();
}

bool WearsAllAlike(const std::vector<SeverityFactors>& factors) {
  return std::all_of(factors.begin(), factors.end(), [&](const SeverityFactors& w) {
    const SeverityFactors& first = factors.front();
    return w.friction == first.friction && w.gravity == first.gravity &&
           w.backlash == first.backlash && w.compliance == first.compliance;
  });
}

// Its values for an arm of `joints`, whose nominal ones are given.
absl::Status FitToArm(const char* name, int joints, const double* nominal, Scenario& scenario) {
  const bool panda = joints == static_cast<int>(NominalPandaErrors().size());
  if (!panda && !scenario.effects.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("scenario file '", name,
                                                   "' names joints of a Panda, the arm has ",
                                                   joints, "; begin with 'clean' and add effects"));
  }
  if (!panda && nominal == nullptr) {
    return absl::InvalidArgumentError(absl::StrCat(
        "scenario '", name, "' has values for the seven joints of a Panda, the arm has ", joints,
        "; give its own as options.nominal, or begin with 'clean' and add effects"));
  }
  if (!panda && !(WearsAllAlike(scenario.start) && WearsAllAlike(scenario.end))) {
    return absl::InvalidArgumentError(absl::StrCat(
        "scenario '", name, "' wears some of the seven joints of a Panda only, the arm has ",
        joints,
        "; take one that wears all alike (aged_joint_uniform, heavy_payload), or begin "
        "with 'clean' and add effects"));
  }
  if (nominal == nullptr) return absl::OkStatus();
  RS_RETURN_IF_ERROR(ReadNominal(nominal, joints, scenario));
  if (panda) return absl::OkStatus();
  scenario.start = std::vector(static_cast<size_t>(joints), scenario.start.front());
  scenario.end = std::vector(static_cast<size_t>(joints), scenario.end.front());
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<JointChain> MakeChain(const char* scenario, int joints,
                                     const robostress_options& options) {
  if (scenario == nullptr) return absl::InvalidArgumentError("scenario is NULL, must be a name");
  if (joints < 1 || joints > kMostJoints) {
    return absl::InvalidArgumentError(
        absl::StrCat("joints is ", joints, ", must be 1 to ", kMostJoints));
  }
  JointErrorOptions laws;
  RS_RETURN_IF_ERROR(ReadOptions(options, laws));
  RS_ASSIGN_OR_RETURN(Scenario found, MakeScenario(scenario, options.severity));
  JointChain chain(joints, laws);
  const bool clean = !found.friction_on && !found.gravity_on && !found.backlash_on &&
                     !found.compliance_on && found.effects.empty();
  // Without errors it has no values, and nothing to check them against.
  if (clean) return chain;
  RS_RETURN_IF_ERROR(FitToArm(scenario, joints, options.nominal, found));
  chain.SetScenario(found, options.horizon);
  return chain;
}

}  // namespace robostress
