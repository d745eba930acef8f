// calibration_generate: writes a rig with logs and, beside them, what it hides.
#include <cmath>
#include <cstdio>
#include <map>
#include <string>

#include "common/command_line.h"
#include "common/run_main.h"
#include "tests/calibration/generator/log_hardship.h"
#include "tests/calibration/generator/spatial_arm.h"

namespace {

using robostress::generator::SpatialArm;
using robostress::generator::SpatialFault;

const std::map<std::string, SpatialArm (*)()>& Arms() {
  static const auto& arms =
      *new std::map<std::string, SpatialArm (*)()>{{"so101", robostress::generator::So101},
                                                   {"ur5e", robostress::generator::Ur5e},
                                                   {"panda", robostress::generator::FrankaPanda},
                                                   {"piper", robostress::generator::Piper}};
  return arms;
}

// An arm as its maker sells it, whose fourth joint cogs: 4 Nm every 0.2 rad.
int WriteArm(const std::string& name, const std::string& out) {
  SpatialFault fault;
  fault.joint = 3;
  fault.torque = [](double q, double) { return 4 * std::cos(2 * M_PI * q / 0.2); };
  const absl::Status written = robostress::generator::WriteSpatialRig(
      Arms().at(name)(), fault, "urdf", {"armature", "damping", "frictionloss"}, out);
  if (written.ok()) return 0;
  std::fprintf(stderr, "calibration_generate: %s\n", std::string(written.message()).c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace robostress::generator;
  RigOptions options;
  std::string out, arm, family = "any", size = "medium", richness = "any", hardship = "none";
  robostress::cli::App app{
      "Writes a rig whose machine has effects that the rig does not declare: model.xml, "
      "rig.yaml, log_*.csv, and truth.json, which calibrate never reads"};
  app.add_option("--effect", options.effects, "Hidden effect; repeat for two; leave out for none");
  app.add_option("--size", size, "small, medium or large")
      ->check(robostress::cli::IsMember({"small", "medium", "large"}));
  app.add_option("--seed", options.seed, "Of everything that is drawn");
  app.add_option("--family", family, "any, servo, torque, inverse, transmission, slide or arm");
  app.add_option("--excitation", richness, "any, rich, poor or brief")
      ->check(robostress::cli::IsMember({"any", "rich", "poor", "brief"}));
  app.add_option("--hardship", hardship, "What else makes the rig hard to tell")
      ->check(robostress::cli::IsMember(HardshipNames()));
  app.add_option(
         "--arm", arm,
         "Instead: an SO-101, UR5e, Panda or Piper with its URDF, whose fourth joint cogs by "
         "4 Nm every 0.2 rad")
      ->check(robostress::cli::IsMember({"so101", "ur5e", "panda", "piper"}));
  app.add_option("--out", out, "Folder of the rig")->required();
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  if (!arm.empty()) return WriteArm(arm, out);
  options.size = size == "small" ? Size::kSmall : size == "medium" ? Size::kMedium : Size::kLarge;
  options.richness = richness == "rich"    ? Richness::kRich
                     : richness == "poor"  ? Richness::kPoor
                     : richness == "brief" ? Richness::kBrief
                                           : Richness::kAny;
  const auto parsed = ParseFamily(family);
  if (!parsed.ok()) {
    std::fprintf(stderr, "calibration_generate: %s\n",
                 std::string(parsed.status().message()).c_str());
    return 2;
  }
  options.family = *parsed;
  options.hardship = *ParseHardship(hardship);
  const auto rig = GenerateRig(options);
  if (!rig.ok()) {
    std::fprintf(stderr, "calibration_generate: %s\n", std::string(rig.status().message()).c_str());
    return 2;
  }
  const absl::Status written = WriteGeneratedRig(*rig, options, out);
  if (!written.ok()) {
    std::fprintf(stderr, "calibration_generate: %s\n", std::string(written.message()).c_str());
    return 1;
  }
  std::printf("%s: %s, %zu logs at %g rows per second, visibility %.3g\n", out.c_str(),
              FamilyName(rig->family), rig->logs.size(), rig->rate_hz, rig->visibility);
  return 0;
}
