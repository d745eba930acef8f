#include "calibration/search/residual_tests.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

TEST(ResidualTests, HoldAResidualAgainstTheMotionOfEveryOtherJoint) {
  generator::RigOptions options;
  options.effects = {"cross_joint_friction"};
  options.family = generator::Family::kArm;
  options.seed = 3;  // torque -d times the other joint's velocity
  options.richness = generator::Richness::kBrief;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/residual_tests";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  const int joint = machine->truth.effects.front().joint;
  JointProblem problem = rig->Problem(joint);
  const auto declared = rig->Declared(joint);
  ASSERT_TRUE(declared.ok()) << declared.status();
  problem.LinearizeStarts(declared->model);
  const std::vector<StructureCurve> curves =
      MeasureStructure(problem, declared->model, declared->model, problem.All(), 1);
  const auto against = [&](const std::string& name) {
    return std::find_if(curves.begin(), curves.end(),
                        [&](const StructureCurve& curve) { return curve.against == name; });
  };
  const std::string& other = rig->rig.joints[1 - joint].name;
  const auto position = against("position of " + other), velocity = against("velocity of " + other);
  ASSERT_NE(position, curves.end());
  ASSERT_NE(velocity, curves.end());
  EXPECT_NE(position->x, velocity->x);
  EXPECT_GT(velocity->explained_declared, velocity->limit);
  std::filesystem::remove_all(folder);
}

TEST(ResidualTests, SayWhereAResidualStandsOut) {
  StructureCurve curve;
  curve.unit = "rad";
  for (int i = 0; i < 24; ++i) curve.x.push_back(0.1 * i);
  curve.declared.assign(24, 0.1);
  curve.after.assign(24, 0.1);
  curve.declared[3] = curve.declared[4] = -2;
  EXPECT_EQ(WhereItIs(curve, false), ", most of it at 0.25 to 0.45 rad");
  EXPECT_EQ(WhereItIs(curve, true), "");  // the same everywhere
  for (int i = 0; i < 12; ++i) curve.declared[i] = 1;
  EXPECT_EQ(WhereItIs(curve, false), "");  // half of all is no place
  curve.declared.assign(24, 0.9);
  curve.declared[3] = 2;
  EXPECT_EQ(WhereItIs(curve, false), "");  // a peak with a fifth of the energy
}

}  // namespace
}  // namespace robostress::calibration
