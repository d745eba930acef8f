// robostress-excite: the motion that would tell what a robot's model lacks.

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "calibration/excite/excitation_design.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress::calibration {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress excite --rig rig.yaml --out motion.csv --film motion.webp\n"
    "  robostress excite --rig rig.yaml --out motion.csv --seconds 120 --velocity 0.5 --velocity "
    "elbow=0.3 --floor 0\n"
    "  robot_client replay motion.csv --config lab.yaml --bus can:can0 --out runs/tuesday\n"
    "  robostress calibrate --rig rig.yaml --add-log tuesday.csv --out runs/found\n"
    "  robostress excite --rig rig.yaml --after runs/found --out next.csv\n\n"
    "The rig needs no logs yet. Look at the film before the arm moves, and play the motion slowly "
    "first.\n"
    "What is outside of the model, as a table or a person, is not known here: --floor, --box.\n"
    "Exit code: 0 done; 1 no motion fits; 2 the command or the rig is wrong.\n";

constexpr size_t kListed = 3;  // of the effects that are hardest to tell

struct CommandLine {
  std::string rig, out, film, report, after;
  std::vector<std::string> swing, velocity, acceleration, centre;
  std::vector<double> floor, box;
  DesignOptions design;
};

// "0.5" for all joints, or "elbow=0.3" for one.
absl::Status TakeLimits(const char* flag, const std::vector<std::string>& given, double* of_all,
                        std::map<std::string, double>* of_joint) {
  for (const std::string& text : given) {
    const size_t equals = text.rfind('=');
    const std::string number = equals == std::string::npos ? text : text.substr(equals + 1);
    double value = 0;
    const bool named = equals != std::string::npos && equals > 0;
    if (!absl::SimpleAtod(number, &value) || !std::isfinite(value) ||
        (of_all != nullptr && value <= 0) || (!named && of_all == nullptr)) {
      return absl::InvalidArgumentError(
          absl::StrCat(flag, " ", text, ": must be ",
                       of_all == nullptr ? "" : "a number above 0, or ", "JOINT=NUMBER"));
    }
    if (named) {
      (*of_joint)[text.substr(0, equals)] = value;
    } else {
      *of_all = value;
    }
  }
  return absl::OkStatus();
}

absl::Status TakeSpace(const CommandLine& line, ArmSpace::Options* space) {
  if (!line.floor.empty()) space->floor_z = line.floor[0];
  if (line.box.empty()) return absl::OkStatus();
  space->box_lower = {line.box[0], line.box[1], line.box[2]};
  space->box_upper = {line.box[3], line.box[4], line.box[5]};
  for (size_t i = 0; i < 3; ++i)
    if (!(space->box_lower[i] < space->box_upper[i]))
      return absl::InvalidArgumentError(
          absl::StrFormat("--box: %g to %g is no range; give the lower corner, then the upper one",
                          space->box_lower[i], space->box_upper[i]));
  return absl::OkStatus();
}

// What the report in a folder of calibrate leaves open.
absl::Status TakeAsked(const std::string& folder, const Rig& rig, DesignOptions* design) {
  const std::string file = folder + "/report.json";
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const nlohmann::json report = nlohmann::json::parse(text, nullptr, false);
  const auto wrong = [&](const std::string& what) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", what, "; give the folder that `robostress calibrate` wrote"));
  };
  if (!report.is_object() || !report.contains("joints") || !report["joints"].is_array())
    return wrong("is no report");
  try {
    for (const nlohmann::json& joint : report["joints"]) {
      const std::string name = joint.at("joint"), verdict = joint.at("verdict");
      if (std::none_of(rig.joints.begin(), rig.joints.end(),
                       [&](const RigJoint& known) { return known.name == name; }))
        return wrong(absl::StrCat("joint '", name, "' is none of ", rig.file));
      if (verdict == "attributed" || verdict == "declared_sufficient") continue;
      DesignOptions::Question& question = design->asked[name];
      if (verdict != "ambiguous") continue;
      for (const nlohmann::json& effect : joint.at("effects_added")) {
        const std::vector<std::string> rivals = effect.at("ambiguous_with");
        if (rivals.empty()) continue;
        question.effects.push_back(effect.at("type"));
        question.found[effect.at("type")] = effect.at("parameters");
        for (const std::string& rival : rivals) question.effects.push_back(rival);
      }
    }
  } catch (const nlohmann::json::exception& error) {
    return wrong(error.what());
  }
  if (design->asked.empty())
    return absl::FailedPreconditionError(
        absl::StrCat(file, ": every joint has its verdict; nothing is left to ask"));
  return absl::OkStatus();
}

nlohmann::json Report(const CommandLine& line, const ExcitationDesign& design) {
  nlohmann::json joints = nlohmann::json::array();
  for (const ExcitationDesign::Joint& joint : design.joints) {
    nlohmann::json effects = nlohmann::json::array();
    for (size_t i = 0; i < joint.effects.size(); ++i) {
      const auto& sight = joint.sights[i];
      effects.push_back({{"type", joint.effects[i]},
                         {"times_noise", sight.times_noise},
                         {"nearest", sight.rival < 0 ? "" : joint.effects[sight.rival]}});
    }
    joints.push_back({{"joint", joint.name},
                      {"centre", joint.room.centre},
                      {"lower", joint.room.lower},
                      {"upper", joint.room.upper},
                      {"velocity", joint.room.velocity},
                      {"acceleration", joint.room.acceleration},
                      {"pieces", joint.pieces},
                      {"effects", effects}});
  }
  return {{"rig", line.rig},
          {"seconds", static_cast<double>(design.q[0].size()) * design.dt},
          {"torque_used", design.torque_used},
          {"change", design.change},
          {"gain", design.gain},
          {"mass_kg", design.mass},
          {"overrides", design.overrides},
          {"notes", design.notes},
          {"joints", joints}};
}

void Print(const ExcitationDesign& design) {
  for (const ExcitationDesign::Joint& joint : design.joints) {
    std::printf("%s: %.3f to %.3f, at most %.3g /s and %.3g /s^2\n", joint.name.c_str(),
                joint.room.lower, joint.room.upper, joint.room.velocity, joint.room.acceleration);
    if (!joint.asked) continue;
    std::vector<size_t> order;
    std::vector<std::string> unseen;
    for (size_t i = 0; i < joint.effects.size(); ++i) {
      if (joint.sights[i].times_noise >= 1)
        order.push_back(i);
      else
        unseen.push_back(joint.effects[i]);
    }
    std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
      return joint.sights[a].times_noise < joint.sights[b].times_noise;
    });
    if (order.size() > kListed) order.resize(kListed);
    std::vector<std::string> hardest;
    for (const size_t i : order) {
      const auto& sight = joint.sights[i];
      hardest.push_back(absl::StrFormat("%s %.3g times the noise%s%s", joint.effects[i],
                                        sight.times_noise, sight.rival < 0 ? "" : " from ",
                                        sight.rival < 0 ? "" : joint.effects[sight.rival]));
    }
    if (!hardest.empty()) std::printf("  hardest: %s\n", absl::StrJoin(hardest, ", ").c_str());
    if (!unseen.empty())
      std::printf("  not told by any motion within these limits: %s\n",
                  absl::StrJoin(unseen, ", ").c_str());
  }
  if (design.torque_used > 0)
    std::printf("motors are asked for %.0f %% of their limits at most\n", 100 * design.torque_used);
  for (const std::string& note : design.notes) std::printf("%s\n", note.c_str());
}

absl::Status Run(CommandLine line) {
  DesignOptions& design = line.design;
  RS_RETURN_IF_ERROR(TakeLimits("--swing", line.swing, &design.swing, &design.swings));
  RS_RETURN_IF_ERROR(TakeLimits("--velocity", line.velocity, &design.velocity, &design.velocities));
  RS_RETURN_IF_ERROR(
      TakeLimits("--acceleration", line.acceleration, &design.acceleration, &design.accelerations));
  RS_RETURN_IF_ERROR(TakeLimits("--centre", line.centre, nullptr, &design.centre));
  RS_RETURN_IF_ERROR(TakeSpace(line, &design.space));
  RS_ASSIGN_OR_RETURN(const Rig rig, ReadRig(line.rig, RigLogs::kNone));
  if (!line.after.empty()) RS_RETURN_IF_ERROR(TakeAsked(line.after, rig, &design));
  if (design.fastest > rig.rate_hz / 10)
    return absl::InvalidArgumentError(
        absl::StrFormat("--fastest %g Hz: at %g rows per second at most %g Hz are drawn",
                        design.fastest, rig.rate_hz, rig.rate_hz / 10));
  RS_ASSIGN_OR_RETURN(const ExcitationDesign motion, DesignExcitation(rig, design));
  RS_RETURN_IF_ERROR(WriteFileAtomically(line.out, ExcitationCsv(motion)));
  if (!line.report.empty())
    RS_RETURN_IF_ERROR(WriteFileAtomically(line.report, Report(line, motion).dump(2) + "\n"));
  if (!line.film.empty()) RS_RETURN_IF_ERROR(FilmExcitation(rig, design, motion, line.film));
  Print(motion);
  std::printf("%s: %.1f s of %zu joints%s%s\n", line.out.c_str(),
              static_cast<double>(motion.q[0].size()) * motion.dt, motion.joints.size(),
              motion.change.empty() ? "" : ", to be played ", motion.change.c_str());
  if (!line.after.empty()) {
    std::string overrides;
    for (const auto& [key, value] : motion.overrides)
      absl::StrAppendFormat(&overrides, ",%s=%g", key, value);
    std::printf("then: robostress calibrate --rig %s --add-log RECORDED.csv%s --out ...\n",
                line.rig.c_str(), overrides.c_str());
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CommandLine line;
  DesignOptions& design = line.design;
  cli::App app("Designs a motion that tells a robot's effects apart", "robostress excite");
  app.footer(kExamples);
  app.add_option("--rig", line.rig, "Rig file: model and servos; logs are not needed")->required();
  app.add_option("--out", line.out, "CSV to write: t and q_cmd_<joint>")->required();
  app.add_option("--film", line.film,
                 "Animated WebP of the motion, to look at before it is played");
  app.add_option("--report", line.report,
                 "JSON to write: pieces, limits, and what is told from what");
  app.add_option("--seconds", design.seconds, "Of the motion")
      ->check(cli::Range(5.0, 600.0))
      ->capture_default_str();
  app.add_option(
         "--swing", line.swing,
         "Each way from the centre [rad, m]: NUMBER or JOINT=NUMBER; repeatable (default 0.5)")
      ->allow_extra_args(false);
  app.add_option("--velocity", line.velocity, "The most [rad/s], likewise (default 0.8)")
      ->allow_extra_args(false);
  app.add_option("--acceleration", line.acceleration, "The most [rad/s^2], likewise (default 3)")
      ->allow_extra_args(false);
  app.add_option(
         "--centre", line.centre,
         "JOINT=POSITION [rad, m] around which it moves (default: the model's keyframe home, "
         "or its zero)")
      ->allow_extra_args(false);
  app.add_option("--fastest", design.fastest, "Highest frequency [Hz]")
      ->check(cli::Range(0.2, 50.0))
      ->capture_default_str();
  app.add_option(
         "--effects", design.effects,
         "Effects to be told, with commas between them (default: all that can be seen); see "
         "`robostress calibrate --effects`")
      ->delimiter(',');
  app.add_option(
      "--after", line.after,
      "Folder of `robostress calibrate`: the motion, and where it tells more the load or "
      "the servo gains, that tell apart what its verdict left open");
  app.add_option("--noise", design.noise, "Of a reading, standard deviation [rad, m]")
      ->check(cli::Range(1e-9, 1.0))
      ->capture_default_str();
  app.add_option("--torque-share", design.torque_share,
                 "Of servo.torque_limit, or else the model's effort, that the motion may ask")
      ->check(cli::Range(0.05, 1.0))
      ->capture_default_str();
  app.add_option("--clearance", design.space.clearance,
                 "Between parts of the arm, floor and box [m]")
      ->check(cli::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--floor", line.floor, "Height of the floor in the model's frame [m]")
      ->expected(1);
  app.add_option("--box", line.box, "Corners of the workspace [m]: X Y Z X Y Z")->expected(6);
  app.add_flag("--without-shapes", design.without_shapes,
               "A model without collision shapes is let pass: nobody checks whether parts meet");
  app.add_flag("--sweep", design.sweep,
               "No design: every joint a sine from 0.1 Hz to --fastest, to compare with");
  app.add_option("--seed", design.seed, "Of the order of pieces")->capture_default_str();
  return RunMain(
      app, argc, argv, [&] { return Run(line); },
      [](const absl::Status& status) {
        return absl::IsInvalidArgument(status) || absl::IsNotFound(status) ? kWrongCommand
                                                                           : kFailed;
      });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
