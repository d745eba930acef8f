#include "sim_worker/scenario_markdown.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"

namespace robostress {
namespace {

struct Column {
  const char* title;
  double JointErrorParameters::*value;
  bool Scenario::*on;
  bool every_joint = false;  // listed for each joint of the line
};
constexpr Column kColumns[] = {
    {"Fc [Nm]", &JointErrorParameters::Fc, &Scenario::friction_on},
    {"Fs [Nm]", &JointErrorParameters::Fs, &Scenario::friction_on},
    {"vs [rad/s]", &JointErrorParameters::vs, &Scenario::friction_on},
    {"sigma_v [Nm s/rad]", &JointErrorParameters::sigma_v, &Scenario::friction_on},
    {"B [rad]", &JointErrorParameters::B, &Scenario::backlash_on},
    {"M_eff [kg m²]", &JointErrorParameters::M_eff, &Scenario::compliance_on},
    {"D [Nm s/rad]", &JointErrorParameters::D, &Scenario::compliance_on},
    {"K [Nm/rad]", &JointErrorParameters::K, &Scenario::compliance_on},
    {"beta", &JointErrorParameters::beta, &Scenario::gravity_on, true}};

// First and last parameters of an episode, per joint.
struct Course {
  explicit Course(const Scenario& scenario) {
    const auto w_first = FactorsAt(scenario, 0, 0), w_last = FactorsAt(scenario, 1, 1);
    for (size_t j = 0; j < w_first.size(); ++j) {
      first.push_back(Scale(NominalPandaErrors()[j], w_first[j]));
      last.push_back(Scale(NominalPandaErrors()[j], w_last[j]));
    }
  }
  std::vector<JointErrorParameters> first, last;
};

std::string FromTo(double from, double to) {
  return from == to ? absl::StrFormat("%.5g", to) : absl::StrFormat("%.5g → %.5g", from, to);
}

// Whether joints a and b stand in one line.
bool Alike(const Scenario& scenario, const Course& course, size_t a, size_t b) {
  return std::all_of(std::begin(kColumns), std::end(kColumns), [&](const Column& column) {
    return column.every_joint || !(scenario.*column.on) ||
           (course.first[a].*column.value == course.first[b].*column.value &&
            course.last[a].*column.value == course.last[b].*column.value);
  });
}

// Joints begin .. end - 1, counted from 0.
std::string Line(const Scenario& scenario, const Course& course, size_t begin, size_t end) {
  std::string line = absl::StrFormat("| %s | J%d", begin == 0 ? scenario.name : "", begin + 1);
  if (end > begin + 1) absl::StrAppend(&line, "–J", end);
  for (const Column& column : kColumns) {
    std::vector<std::string> values;
    for (size_t j = begin; j < (column.every_joint ? end : begin + 1); ++j) {
      values.push_back(FromTo(course.first[j].*column.value, course.last[j].*column.value));
    }
    absl::StrAppend(&line, " | ", scenario.*column.on ? absl::StrJoin(values, ", ") : "–");
  }
  return absl::StrCat(line, " |\n");
}

SeverityFactors EndFactors(const char* scenario, int level) {
  return FactorsAt(MakeScenario(scenario, level).value(), 1, 1)[0];
}

struct Oscillator {
  double frequency, damping;  // [Hz], [1]
};

Oscillator OscillatorOf(const JointErrorParameters& p) {
  return {std::sqrt(p.K / p.M_eff) / (2 * M_PI), p.D / (2 * std::sqrt(p.K * p.M_eff))};
}

}  // namespace

std::string ParameterMarkdown(const std::vector<Scenario>& scenarios) {
  std::string table = "| scenario | joints", rule = "|---|---";
  for (const Column& column : kColumns) {
    absl::StrAppend(&table, " | ", column.title);
    absl::StrAppend(&rule, "|---");
  }
  absl::StrAppend(&table, " |\n", rule, "|\n");
  for (const Scenario& scenario : scenarios) {
    const Course course(scenario);
    for (size_t begin = 0, end; begin < course.last.size(); begin = end) {
      end = begin + 1;
      while (end < course.last.size() && Alike(scenario, course, begin, end)) ++end;
      absl::StrAppend(&table, Line(scenario, course, begin, end));
    }
  }
  return table;
}

std::string SeverityLevelMarkdown() {
  std::string table =
      "| level | friction | backlash | compliance | Heavy Payload: compliance | gravity | "
      "Thermal Drift-Stribeck | Thermal Drift-Backlash |\n|---|---|---|---|---|---|---|---|\n";
  const SeverityFactors onset_friction =
      FactorsAt(MakeScenario("thermal_drift_stribeck", 5).value(), 0, 0)[0];
  const SeverityFactors onset_backlash =
      FactorsAt(MakeScenario("thermal_drift_backlash", 5).value(), 0, 0)[0];
  for (int level = 1; level <= 5; ++level) {
    const SeverityFactors worn = EndFactors("aged_joint_uniform", level),
                          payload = EndFactors("heavy_payload", level);
    absl::StrAppendFormat(
        &table, "| L%d | %g | %g | %g | %g | %g | %g → %g | %g → %g |\n", level, worn.friction,
        worn.backlash, worn.compliance, payload.compliance, payload.gravity,
        onset_friction.friction, EndFactors("thermal_drift_stribeck", level).friction,
        onset_backlash.backlash, EndFactors("thermal_drift_backlash", level).backlash);
  }
  return table;
}

std::string ComplianceMarkdown() {
  std::string table =
      "| compliance factor | J1–J4: f [Hz] | zeta | J5–J7: f [Hz] | zeta "
      "|\n|---|---|---|---|---|\n";
  std::vector<double> factors = {1};
  for (int level = 1; level <= 5; ++level) {
    factors.push_back(EndFactors("isolated_compliance", level).compliance);
  }
  for (const double w : factors) {
    absl::StrAppendFormat(&table, "| %g", w);
    for (const int joint : {0, 6}) {
      const JointErrorParameters p = Scale(NominalPandaErrors()[joint], {.compliance = w});
      const Oscillator response = OscillatorOf(p);
      absl::StrAppendFormat(&table, " | %.1f | %.2f", response.frequency, response.damping);
    }
    absl::StrAppend(&table, " |\n");
  }
  return table;
}

}  // namespace robostress
