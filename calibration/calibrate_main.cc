// robostress-calibrate: finds what a declared model of a measured robot lacks.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/calibrate.h"
#include "calibration/model/effect_table.h"
#include "calibration/model/scenario_output.h"
#include "calibration/report/report_numbers.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress calibrate --rig rig.yaml --out runs/calibration\n"
    "  robostress calibrate --rig rig.yaml --out runs/worn --map hinge=J4\n"
    "  robostress sweep --scenarios clean,runs/worn/scenario.yaml --out runs/stress\n\n"
    "Reads the rig's logs, fits the declared model, searches the effect library for what it lacks, "
    "and says\n"
    "before and after on logs that were not fitted. Leaves report.json, report.html and "
    "rig_after.yaml.\n"
    "Exit code: 0 done, whatever the verdict; 1 rig, logs or model are refused; 2 the command is "
    "wrong.\n";

struct CommandLine {
  std::string rig, out;
  std::vector<std::string> map, add_logs;
  RobotDescription arm = kPanda;  // of the scenario
  TraceOptions trace;
  bool quiet = false;
};

// Nothing of an earlier run may pass for the result of one that fails.
absl::Status PrepareFolder(const std::filesystem::path& out) {
  std::error_code error;
  std::filesystem::create_directories(out, error);
  if (error)
    return absl::InvalidArgumentError(
        absl::StrFormat("--out %s: cannot be made: %s", out.string(), error.message()));
  for (const char* name : {"report.json", "report.html", "rig_after.yaml", "scenario.yaml"})
    std::filesystem::remove(out / name, error);
  return absl::OkStatus();
}

// scenario.yaml of what was added, for `robostress sweep --scenarios`; none where nothing was.
absl::Status WriteScenario(const Rig& declared, const Rig& after, const JointMap& map,
                           const RobotDescription& arm, const std::filesystem::path& out,
                           std::string& scenario_out) {
  const absl::StatusOr<ScenarioOutput> output =
      ScenarioOfRig(declared, after, map, absl::StrCat("As ", declared.name), arm);
  if (absl::IsFailedPrecondition(output.status())) {
    std::printf("  %s\n", std::string(output.status().message()).c_str());
    return absl::OkStatus();
  }
  RS_RETURN_IF_ERROR(output.status());
  for (const std::string& note : output->notes) std::printf("  scenario.yaml: %s\n", note.c_str());
  scenario_out = "scenario.yaml";
  return WriteFileAtomically((out / scenario_out).string(),
                             WriteScenarioFile(output->scenario, arm));
}

bool LeavesAQuestion(const CalibrationReport& report) {
  return std::any_of(report.joints.begin(), report.joints.end(), [](const JointReport& joint) {
    return joint.verdict != Verdict::kAttributed && joint.verdict != Verdict::kDeclaredSufficient &&
           joint.input != "transmission" && !joint.rounds.empty();
  });
}

absl::Status Run(CommandLine line) {
  const std::filesystem::path out = line.out;
  RS_ASSIGN_OR_RETURN(Rig rig,
                      ReadRig(line.rig, line.add_logs.empty() ? RigLogs::kNeeded : RigLogs::kNone));
  for (const std::string& text : line.add_logs) {
    RS_ASSIGN_OR_RETURN(RigLog log, ParseRigLog(text, rig));
    rig.logs.push_back(std::move(log));
  }
  RS_ASSIGN_OR_RETURN(const JointMap map, ParseJointMap(line.map, rig, line.arm));
  RS_RETURN_IF_ERROR(PrepareFolder(out));
  if (!line.quiet) {
    line.trace.progress = [](const std::string& text) {
      std::fprintf(stderr, "calibrate: %s\n", text.c_str());
    };
  }
  RS_ASSIGN_OR_RETURN(Calibration calibration, Calibrate(rig, line.trace));
  CalibrationReport& report = calibration.report;
  calibration.after.file = std::filesystem::absolute(out / "rig_after.yaml").string();
  report.model_out = "rig_after.yaml";
  RS_RETURN_IF_ERROR(WriteFileAtomically(calibration.after.file, WriteRig(calibration.after)));
  if (!map.empty()) {
    RS_RETURN_IF_ERROR(
        WriteScenario(rig, calibration.after, map, line.arm, out, report.scenario_out));
  }
  if (LeavesAQuestion(report))
    report.evidence.push_back(absl::StrFormat(
        "the motion that tells most of what is open: robostress excite --rig %s --after %s --out "
        "next.csv",
        line.rig, line.out));
  RS_RETURN_IF_ERROR(WriteFileAtomically((out / "report.html").string(), ReportHtml(report)));
  RS_RETURN_IF_ERROR(WriteFileAtomically((out / "report.json").string(), ReportJson(report)));
  std::printf("%s\n%s", std::filesystem::path(report.model).filename().c_str(),
              ModelTableText(report.model_facts, "  ").c_str());
  std::printf("%s: %s\n", report.rig.c_str(), VerdictName(report.verdict));
  for (const JointReport& joint : report.joints) {
    const ErrorReport& error = joint.held_out.present ? joint.held_out : joint.fit;
    std::printf("  %s: %s: %s\n", joint.joint.c_str(), VerdictName(joint.verdict),
                joint.because.c_str());
    std::printf("    %s error %.4g -> %.4g %s (noise %.4g)\n",
                joint.held_out.present ? "held-out" : "fit", error.declared, error.after,
                joint.unit.c_str(), error.noise_floor);
    for (const AddedEffectReport& effect : joint.effects) {
      std::string text;
      for (const ParameterReport& p : effect.parameters)
        absl::StrAppend(&text, " ", p.name, " = ", ValueText(p.value, p.std), " ", p.unit);
      for (const std::string& rival : effect.ambiguous_with) text += " or " + rival;
      std::printf("    + %s:%s\n", effect.type.c_str(), text.c_str());
    }
    for (const std::string& mimic : joint.mimics_exposed) std::printf("    %s\n", mimic.c_str());
    if (!joint.next_experiment.text.empty())
      std::printf("    next: %s\n", joint.next_experiment.text.c_str());
  }
  for (const std::string& evidence : report.evidence) std::printf("  %s\n", evidence.c_str());
  if (report.n_surrogates > 0) std::printf("  %d surrogates\n", report.n_surrogates);
  std::printf("  %.1f s; %s\n", report.elapsed_s, (out / "report.json").string().c_str());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CommandLine line;
  cli::App app("Finds what a declared model of a measured robot lacks", "robostress calibrate");
  app.add_option("--rig", line.rig, "Rig file: model, what is known of its joints, logs")
      ->required();
  app.add_option("--out", line.out, "Directory to write")->required();
  app.add_option("--map", line.map,
                 "Write scenario.yaml with what was added at joints of the simulated arm: "
                 "hinge=J4, hinge=J2+J4, hinge=J4:2.5 (torques times 2.5; else values are kept), "
                 "or own for an arm's own joints; repeatable")
      ->allow_extra_args(false);
  app.add_option_function(
         "--arm", [&](const std::string& arm) { line.arm = arm == "piper" ? kPiper : kPanda; },
         "The simulated arm of --map: panda, or piper for a profile of piper_emulator")
      ->check(cli::IsMember({"panda", "piper"}));
  app.add_option("--add-log", line.add_logs,
                 "One more log to fit, and what differed in it: new.csv, or "
                 "new.csv,elbow.known_mass=0.3,elbow.servo.kp=50; repeatable")
      ->allow_extra_args(false);
  app.add_option(
         "--joints", line.trace.joints,
         "Joints to trace, with commas between them (default: all); the others move as they "
         "were measured")
      ->delimiter(',');
  app.add_option("--surrogates", line.trace.surrogates, "Surrogates of a null distribution")
      ->check(cli::Range(99, 100000))
      ->capture_default_str();
  app.add_option("--seed", line.trace.seed, "Of the surrogates")->capture_default_str();
  app.add_option("--max-effects", line.trace.max_effects,
                 "Added to a joint at most; 0: the declared model is fitted, nothing is searched")
      ->check(cli::Range(0, 6))
      ->capture_default_str();
  app.add_option("--beam", line.trace.beam, "Models that the search follows at once")
      ->check(cli::Range(1, 10))
      ->capture_default_str();
  app.add_flag("--quiet", line.quiet, "No progress");
  app.add_last_flag(
      "--effects", [] { std::printf("%s", EffectTableMarkdown().c_str()); },
      "Print the effect library and do nothing else");
  app.footer(kExamples);
  return RunMain(app, argc, argv, [&] { return Run(line); });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
