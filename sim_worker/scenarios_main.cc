// robostress-scenarios: the table of scenarios with the parameters that they inject.
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/joint_errors/bam_parameters.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/joint_errors/scenario_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "sim_worker/scenario_markdown.h"

namespace robostress {
namespace {

using Json = nlohmann::ordered_json;

const char* ProfileName(SeverityProfile profile) {
  switch (profile) {
    case SeverityProfile::kFixed:
      return "fixed";
    case SeverityProfile::kRampOverEpisode:
      return "ramp_over_episode";
    case SeverityProfile::kWhileGrasping:
      return "while_grasping";
  }
  return "";
}

struct Part {
  const char* name;
  bool Scenario::*on;
  double SeverityFactors::*factor;
};
constexpr Part kParts[] = {{"friction", &Scenario::friction_on, &SeverityFactors::friction},
                           {"gravity", &Scenario::gravity_on, &SeverityFactors::gravity},
                           {"backlash", &Scenario::backlash_on, &SeverityFactors::backlash},
                           {"compliance", &Scenario::compliance_on, &SeverityFactors::compliance}};

Json FactorJson(const SeverityFactors& w) {
  Json json;
  for (const Part& part : kParts) json[part.name] = w.*part.factor;
  return json;
}

Json ParameterJson(const JointErrorParameters& p) {
  return {{"Fc", p.Fc},       {"Fs", p.Fs}, {"vs", p.vs}, {"sigma_v", p.sigma_v}, {"B", p.B},
          {"M_eff", p.M_eff}, {"D", p.D},   {"K", p.K},   {"beta", p.beta}};
}

Json ScenarioJson(const Scenario& scenario) {
  Json json = {{"name", scenario.name},
               {"title", scenario.title},
               {"deployment", scenario.deployment},
               {"profile", ProfileName(scenario.profile)}};
  for (const Part& part : kParts) json["active"][part.name] = scenario.*part.on;
  const std::vector<SeverityFactors> first = FactorsAt(scenario, 0, 0),
                                     last = FactorsAt(scenario, 1, 1);
  json["joints"] = Json::array();
  for (size_t j = 0; j < last.size(); ++j) {
    const JointErrorParameters& nominal = NominalPandaErrors()[j];
    json["joints"].push_back({{"joint", j + 1},
                              {"factors_first", FactorJson(first[j])},
                              {"factors_last", FactorJson(last[j])},
                              {"parameters_first", ParameterJson(Scale(nominal, first[j]))},
                              {"parameters_last", ParameterJson(Scale(nominal, last[j]))}});
  }
  return json;
}

// "x1.5->2 J1-J3", "nominal" or "off".
std::string Cell(const Scenario& scenario, const Part& part) {
  if (!(scenario.*part.on)) return "off";
  const std::vector<SeverityFactors> first = FactorsAt(scenario, 0, 0),
                                     last = FactorsAt(scenario, 1, 1);
  std::vector<std::string> joints;
  double from = 1, to = 1;
  for (size_t j = 0; j < last.size(); ++j) {
    if (last[j].*part.factor == 1) continue;
    joints.push_back(absl::StrCat(j + 1));
    from = first[j].*part.factor;
    to = last[j].*part.factor;
  }
  if (joints.empty()) return "nominal";
  std::string cell = from == to ? absl::StrFormat("x%g", to) : absl::StrFormat("x%g->%g", from, to);
  if (joints.size() < 7) absl::StrAppend(&cell, " J", absl::StrJoin(joints, ","));
  return cell;
}

void PrintTable(const std::vector<Scenario>& scenarios, int level) {
  std::printf(
      "Severity level %d of 5. Factors: friction scales Fc, Fs, sigma_v; gravity beta; backlash B; "
      "compliance "
      "divides K and, as a root, D.\nA range runs over the episode (Thermal Drift) or over 0.1 s "
      "of a grasp "
      "(Heavy Payload).\n\n",
      level);
  std::printf("%-24s %-12s %-12s %-12s %-14s %-18s %s\n", "scenario", "friction", "gravity",
              "backlash", "compliance", "profile", "reported");
  for (const Scenario& s : scenarios) {
    std::printf("%-24s %-12s %-12s %-12s %-14s %-18s %s\n", s.name.c_str(),
                Cell(s, kParts[0]).c_str(), Cell(s, kParts[1]).c_str(), Cell(s, kParts[2]).c_str(),
                Cell(s, kParts[3]).c_str(), ProfileName(s.profile),
                s.deployment            ? "deployment"
                : s.name == "dev_mixed" ? "tuning only"
                                        : "");
  }
}

void PrintParameters(const Scenario& scenario) {
  const std::vector<SeverityFactors> last = FactorsAt(scenario, 1, 1);
  std::printf("\n%s: parameters at full severity of the episode (* component off)\n",
              scenario.name.c_str());
  const auto mark = [](bool on) { return on ? ' ' : '*'; };
  std::printf(
      "joint   Fc%c     Fs%c     vs%c   sigma_v%c  beta%c      B%c    M_eff%c      D%c       K%c\n",
      mark(scenario.friction_on), mark(scenario.friction_on), mark(scenario.friction_on),
      mark(scenario.friction_on), mark(scenario.gravity_on), mark(scenario.backlash_on),
      mark(scenario.compliance_on), mark(scenario.compliance_on), mark(scenario.compliance_on));
  std::printf(
      "        [Nm]    [Nm]  [rad/s] [Nms/rad]  [1]     [rad]  [kg m^2] [Nms/rad] [Nm/rad]\n");
  for (size_t j = 0; j < last.size(); ++j) {
    const JointErrorParameters p = Scale(NominalPandaErrors()[j], last[j]);
    std::printf("J%zu    %6.3f  %6.3f   %5.2f    %6.3f   %5.2f  %8.5f    %5.2f  %7.2f  %7.1f\n",
                j + 1, p.Fc, p.Fs, p.vs, p.sigma_v, p.beta, p.B, p.M_eff, p.D, p.K);
  }
}

// What a scenario file lists beside its base.
void PrintEffectsOf(const Scenario& scenario) {
  for (const ScenarioEffect& effect : scenario.effects) {
    const EffectInfo& info = **FindEffect(effect.type);
    std::printf("J%d    %s:", effect.joint + 1, effect.type.c_str());
    for (size_t i = 0; i < effect.values.size(); ++i)
      std::printf(" %s %g %s", info.parameters[i].name.c_str(), effect.values[i],
                  info.parameters[i].unit.c_str());
    if (effect.coupled >= 0) std::printf(" of J%d", effect.coupled + 1);
    std::printf("%s\n", info.stage == EffectStage::kSensor ? "  (sensor: outside the paper)" : "");
  }
}

// The effects that a scenario file may list, with parameters, units and ranges.
void PrintEffects() {
  std::printf(
      "Effects that a scenario file lists per joint (FILE.yaml, passed wherever a scenario is "
      "named):\n\n"
      "  title: Worn elbow\n  base: clean\n  joints:\n    - name: J4\n      effects:\n"
      "        - {type: transport_delay, delay_s: 0.02}\n\n"
      "Values are physical; severity levels do not scale them. The controller gives torques, so "
      "that a\ncommand effect acts on the joint's torque command on its way to the motor. Effects "
      "of stage sensor\nare outside the paper, which adds no noise to observations: they act on "
      "the joint readings that the\ncontroller sees. Ranges at J1; torques of J6 and J7 end at "
      "12/80 of J1's.\n\n");
  for (const EffectInfo& effect : EffectLibrary()) {
    std::printf("%-28s %-12s %s%s\n", effect.type.c_str(), StageName(effect.stage),
                effect.equation.c_str(),
                effect.stage == EffectStage::kSensor ? "  (outside the paper)" : "");
    if (effect.of_position) {
      std::printf("    in no scenario: it limits a servo's position command\n");
      continue;
    }
    for (size_t i = 0; i < effect.parameters.size(); ++i) {
      const EffectParameter& parameter = effect.parameters[i];
      const EffectRange range = RangeInScenario(effect, i, kPanda, 0);
      std::printf(
          "    %-12s [%s]  %.4g to %.4g%s\n", parameter.name.c_str(), parameter.unit.c_str(),
          range.lower, range.upper,
          parameter.fixed ? absl::StrFormat(", else %g", parameter.starts.front()).c_str() : "");
    }
    if (effect.type == "cross_joint_coupling")
      std::printf("    %-12s the other joint, J1 to J7\n", "joint");
  }
}

struct BamOptions {
  std::string file, out;
  std::vector<std::string> joints;  // of the Panda; empty: all
};

constexpr double kBamLoad = 1;  // [Nm]

// Writes the scenario and says what became of each term.
absl::Status TakeBam(const BamOptions& options) {
  RS_ASSIGN_OR_RETURN(const BamParameters servo, ReadBamParameters(options.file));
  if (!IsScenarioFile(options.out) || std::filesystem::exists(options.out))
    return absl::InvalidArgumentError(
        absl::StrCat("--out: is '", options.out, "', must be a new file whose name ends in .yaml"));
  std::vector<int> joints;
  for (const std::string& name : options.joints) {
    joints.push_back(FindJoint(kPanda, name));
    if (joints.back() < 0)
      return absl::InvalidArgumentError(
          absl::StrCat("--joints: is '", name, "', must be of ", KnownJoints(kPanda)));
  }
  for (int j = 0; options.joints.empty() && j < static_cast<int>(kPanda.joints.size()); ++j)
    joints.push_back(j);
  RS_ASSIGN_OR_RETURN(const ScenarioFile scenario, ScenarioOfBam(servo, joints, kPanda));
  const std::string text = WriteScenarioFile(scenario, kPanda);
  RS_RETURN_IF_ERROR(WriteFileAtomically(options.out, text));
  if (const auto read = ReadScenarioFile(options.out, kPanda); !read.ok()) {
    std::remove(options.out.c_str());
    return read.status();
  }
  const BamDifference differs = LargestBamDifference(servo, kBamLoad);
  std::printf("%s: %s, in addition to the Panda's own joints\n", options.out.c_str(),
              scenario.title.c_str());
  std::printf(
      "largest difference from BAM's friction up to 10 rad/s: %.3g Nm without load; with loads up "
      "to %g Nm\n%.3g Nm where gravity opposes the motor, %.3g Nm where it helps\n",
      differs.unloaded, kBamLoad, differs.opposing, differs.helping);
  for (const std::string& term : EffectsOfBam(servo).left_out)
    std::printf("left out: %s\n", term.c_str());
  std::printf("\nThe servo in a calibration rig (kt, R and armature are no errors of a Panda):\n%s",
              RigJointOfBam(servo, "JOINT").c_str());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  cli::App app(
      "Prints the deployment scenarios and the joint error parameters that they inject.\n"
      "Examples:\n  robostress scenarios\n  robostress scenarios --level 3 --parameters "
      "aged_joint_elbow\n"
      "  robostress scenarios --json\n  robostress scenarios --markdown\n"
      "  robostress scenarios --effects\n"
      "  robostress scenarios --from-bam params/sts3215/m1.json --joints J5,J6,J7 --out servo.yaml",
      "robostress scenarios");
  int level = 5;
  std::string parameters;
  bool json = false, markdown = false, effects = false;
  app.add_option("--level", level, "severity level, 1 (mild) to 5 (full)")->capture_default_str();
  app.add_option("--parameters", parameters, "also print one scenario's parameters per joint");
  app.add_flag("--json", json, "everything as JSON, parameters of all scenarios included");
  app.add_flag("--markdown", markdown,
               "Markdown tables: parameters of all scenarios, factors of all levels, what the "
               "compliance becomes at 2 ms");
  app.add_flag("--effects", effects,
               "the effects that a scenario file may list, with parameters, units and ranges");
  BamOptions bam;
  app.add_option("--from-bam", bam.file,
                 "a servo's parameters in the form of Rhoban's BAM (JSON, m1 to m6): its friction "
                 "becomes a scenario file");
  app.add_option("--out", bam.out, "with --from-bam: the scenario file to write (.yaml)");
  app.add_option("--joints", bam.joints,
                 "with --from-bam: joints that get the servo's friction (default: all)")
      ->delimiter(',');
  const auto print = [&]() -> absl::StatusOr<int> {
    if (bam.file.empty() && !(bam.out.empty() && bam.joints.empty()))
      return absl::InvalidArgumentError("--out and --joints go with --from-bam FILE; add it");
    if (!bam.file.empty()) {
      RS_RETURN_IF_ERROR(TakeBam(bam));
      return 0;
    }
    if (effects) {
      PrintEffects();
      return 0;
    }
    std::vector<Scenario> scenarios;
    for (const std::string& name : ScenarioNames()) {
      RS_ASSIGN_OR_RETURN(Scenario scenario, MakeScenario(name, level));
      scenarios.push_back(std::move(scenario));
    }
    std::optional<Scenario> chosen;
    if (!parameters.empty()) {
      RS_ASSIGN_OR_RETURN(chosen, MakeScenario(parameters, level));
    }
    if (json) {
      Json root = {{"level", level}, {"scenarios", Json::array()}};
      for (const Scenario& scenario : scenarios)
        root["scenarios"].push_back(ScenarioJson(scenario));
      std::printf("%s\n", root.dump(2).c_str());
    } else if (markdown) {
      std::printf("%s\n%s\n%s", ParameterMarkdown(scenarios).c_str(),
                  SeverityLevelMarkdown().c_str(), ComplianceMarkdown().c_str());
    } else {
      PrintTable(scenarios, level);
      if (chosen) {
        PrintParameters(*chosen);
        PrintEffectsOf(*chosen);
      }
    }
    return 0;
  };
  return RunMain(app, argc, argv, print, [](const absl::Status&) { return kWrongCommand; });
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
