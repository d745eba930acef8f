#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// Nominal parameters of one joint (paper, tab:base_params).
struct JointErrorParameters {
  double Fc = 0;       // Coulomb friction torque [Nm]
  double Fs = 0;       // static friction torque [Nm]
  double vs = 0;       // Stribeck velocity [rad/s]
  double sigma_v = 0;  // viscous coefficient [Nm s/rad]
  double B = 0;        // backlash half-width [rad]
  double M_eff = 0;    // effective inertia of the compliance [kg m^2]
  double D = 0;        // damping [Nm s/rad]
  double K = 0;        // stiffness [Nm/rad]
  double beta = 0;     // gravity residual fraction [1]
};

// Severity factors of one joint (paper, Eq. wear); 1 is nominal.
struct SeverityFactors {
  double friction = 1, gravity = 1, backlash = 1, compliance = 1;
};

enum class SeverityProfile {
  kFixed,            // w_end throughout
  kRampOverEpisode,  // w_start -> w_end linearly over the suite's horizon
  kWhileGrasping,    // nominal, w_end while an object is held
};

// An effect of the effect library at one joint, with a value for each of its parameters in the
// order of EffectInfo::parameters. Physical values: severity levels do not scale them.
struct ScenarioEffect {
  int joint = 0;  // 0: J1
  std::string type;
  std::vector<double> values;
  int coupled = -1;  // of an effect that is coupled: the joint whose motion it reads
};

// One row of the scenario table, or a scenario file: everything that distinguishes a scenario from
// Clean.
struct Scenario {
  std::string name;   // "clean", "heavy_payload", "thermal_drift_stribeck", ...
  std::string title;  // "Heavy Payload"
  bool friction_on = false, gravity_on = false, backlash_on = false, compliance_on = false;
  SeverityProfile profile = SeverityProfile::kFixed;
  std::vector<JointErrorParameters> nominal;  // [joints] of the arm; with the next two, or empty
  std::vector<SeverityFactors> start;   // [joints], ramp onset (equal to `end` without a ramp)
  std::vector<SeverityFactors> end;     // [joints], at the chosen severity level
  bool deployment = false;              // one of the seven
  std::vector<ScenarioEffect> effects;  // of scenario files only; beside the paper's four errors
};

// clean, the seven deployment scenarios, nominal, four isolated settings, dev_mixed (private, for
// tuning); names as printed by `robostress scenarios`.
std::vector<std::string> ScenarioNames();
const std::vector<JointErrorParameters>& NominalPandaErrors();  // [7]
// level: 1 (mild) .. 5 (full; the paper's main tables). Unknown names list the known ones. A name
// that ends in .yaml is the path of a scenario file of the Panda (scenario_file.h), which is read
// at every call.
absl::StatusOr<Scenario> MakeScenario(const std::string& name, int level);
// Factors at `progress` in [0, 1] of the horizon and `grasp` in [0, 1] of the grasp gate.
std::vector<SeverityFactors> FactorsAt(const Scenario& scenario, double progress, double grasp);
// Scaled parameters (Eq. wear; D = D0 / sqrt(w_c)).
JointErrorParameters Scale(const JointErrorParameters& nominal, const SeverityFactors& w);

}  // namespace robostress
