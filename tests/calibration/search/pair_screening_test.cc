#include "calibration/search/pair_screening.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "calibration/search/surrogates.h"
#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

using testing::Contains;

// In the order of the library.
const std::vector<std::string> kHidden = {"asymmetric_viscous", "cable_spring"};

TEST(PairScreening, RanksTheTwoThatAreHiddenAndLeadsAFitToThem) {
  generator::RigOptions options;
  options.effects = kHidden;
  options.family = generator::Family::kServo;
  options.richness = generator::Richness::kBrief;
  options.seed = 12;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/pair_screening";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  JointProblem problem = rig->Problem(0);
  const WindowSet fit = problem.OfRole(LogRole::kFit);
  const auto declared = rig->Declared(0);
  ASSERT_TRUE(declared.ok()) << declared.status();
  problem.LinearizeStarts(declared->model);
  const JointFit base = Minimise(problem, *declared, fit);
  problem.LinearizeStarts(ModelAt(base.best, base.best.x));

  const Screening screening(problem, base, rig->Scales(0), CandidatesFor(base.best.model, {}, true),
                            fit);
  const auto pairs = ScreenPairs(problem, screening, rig->Scales(0), fit, 99, 1);
  ASSERT_FALSE(pairs.empty());
  std::vector<std::vector<std::string>> names;
  for (const PairContender& pair : pairs) {
    names.push_back({});
    for (const int candidate : pair.candidates)
      names.back().push_back(screening.candidates()[candidate].effect->type);
    EXPECT_LE(pair.p, 0.05);
    // Together they explain at least what each does alone.
    for (const Signature& signature : screening.signatures()) {
      if (signature.candidate == pair.candidates[0] || signature.candidate == pair.candidates[1]) {
        EXPECT_GE(pair.gain, screening.Gain(signature) - 1e-9);
      }
    }
    EXPECT_EQ(pair.start.model.effects.size(), base.best.model.effects.size() + 2);
    if (names.back() == kHidden) {
      EXPECT_LT(Minimise(problem, pair.start, fit).rms, 0.1 * base.rms);
    }
  }
  EXPECT_THAT(names, Contains(kHidden));
  std::filesystem::remove_all(folder);
}

TEST(PairScreening, CouplesAJointToOneOther) {
  generator::RigOptions options;
  options.effects = {"cross_joint_friction"};
  options.family = generator::Family::kArm;
  options.richness = generator::Richness::kBrief;
  options.seed = 3;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/pair_partners";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  const int joint = machine->truth.effects.front().joint;
  JointProblem problem = rig->Problem(joint);
  const WindowSet fit = problem.OfRole(LogRole::kFit);
  const auto declared = rig->Declared(joint);
  ASSERT_TRUE(declared.ok()) << declared.status();
  problem.LinearizeStarts(declared->model);
  const JointFit base = Minimise(problem, *declared, fit, 2);
  // Of a partner that would be a third joint this one stands in.
  const auto count = [&](int partner) {
    const Screening screening(problem, base, rig->Scales(joint),
                              {{FindEffect("cross_joint_friction").value(), 1 - joint},
                               {FindEffect("cross_joint_inertia").value(), partner}},
                              fit);
    return ScreenPairs(problem, screening, rig->Scales(joint), fit, 99, 1).size();
  };
  EXPECT_EQ(count(1 - joint), 1u);
  EXPECT_EQ(count(joint), 0u);
  std::filesystem::remove_all(folder);
}

// A log of an arm that touches something at every other row leaves such windows.
TEST(Surrogates, OfAWindowOfOneRowAreDrawn) {
  generator::RigOptions options;
  options.family = generator::Family::kServo;
  options.richness = generator::Richness::kBrief;
  options.seed = 12;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/one_row";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  const auto declared = rig->Declared(0);
  ASSERT_TRUE(declared.ok()) << declared.status();
  const JointProblem problem(rig->rig.joints[0].name, MakeTracks(*rig->plant, rig->logs, 0), 1);
  WindowSet one(problem.windows().size(), 0);
  one[one.size() / 2] = 1;
  JointFit fit;
  fit.best = *declared;
  const Screening screening(problem, fit, rig->Scales(0), {}, one);
  int drawn = 0;
  ForSurrogates(problem, screening, one, 10, 1, [&](int, const Eigen::MatrixXd& surrogates) {
    EXPECT_EQ(surrogates.rows(), 1);
    drawn += static_cast<int>(surrogates.cols());
  });
  EXPECT_EQ(drawn, 10);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace robostress::calibration
