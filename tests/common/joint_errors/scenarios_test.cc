#include "common/joint_errors/scenarios.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>

namespace robostress {
namespace {

using ::testing::HasSubstr;

const std::vector<std::string> kDeployment = {
    "heavy_payload",      "thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
    "aged_joint_uniform", "aged_joint_shoulder",    "aged_joint_elbow"};

JointErrorParameters At(const std::string& name, int joint, double progress, double grasp,
                        int level = 5) {
  return Scale(NominalPandaErrors()[joint],
               FactorsAt(MakeScenario(name, level).value(), progress, grasp)[joint]);
}

void ExpectSame(const JointErrorParameters& a, const JointErrorParameters& b,
                const std::string& what) {
  EXPECT_EQ(a.Fc, b.Fc) << what;
  EXPECT_EQ(a.Fs, b.Fs) << what;
  EXPECT_EQ(a.vs, b.vs) << what;
  EXPECT_EQ(a.sigma_v, b.sigma_v) << what;
  EXPECT_EQ(a.B, b.B) << what;
  EXPECT_EQ(a.M_eff, b.M_eff) << what;
  EXPECT_EQ(a.D, b.D) << what;
  EXPECT_EQ(a.K, b.K) << what;
  EXPECT_EQ(a.beta, b.beta) << what;
}

TEST(Scenarios, IsolatedSettingsHaveTheOtherThreeOff) {
  for (const char* name :
       {"isolated_stribeck", "isolated_backlash", "isolated_compliance", "isolated_gravity"}) {
    const Scenario s = MakeScenario(name, 5).value();
    EXPECT_EQ(s.friction_on + s.gravity_on + s.backlash_on + s.compliance_on, 1) << name;
    EXPECT_FALSE(s.deployment);
  }
  EXPECT_TRUE(MakeScenario("isolated_stribeck", 5)->friction_on);
  EXPECT_TRUE(MakeScenario("isolated_backlash", 5)->backlash_on);
  EXPECT_TRUE(MakeScenario("isolated_compliance", 5)->compliance_on);
  EXPECT_TRUE(MakeScenario("isolated_gravity", 5)->gravity_on);
}

TEST(Scenarios, AllFourComponentsAreActiveInTheSevenAndNoneInClean) {
  int deployment = 0;
  for (const std::string& name : ScenarioNames()) deployment += MakeScenario(name, 5)->deployment;
  EXPECT_EQ(deployment, 7);
  for (const std::string& name : kDeployment) {
    const Scenario s = MakeScenario(name, 5).value();
    EXPECT_TRUE(s.deployment && s.friction_on && s.gravity_on && s.backlash_on && s.compliance_on)
        << name;
  }
  const Scenario clean = MakeScenario("clean", 5).value();
  EXPECT_FALSE(clean.friction_on || clean.gravity_on || clean.backlash_on || clean.compliance_on);
}

TEST(Scenarios, ComponentsThatAScenarioDoesNotRaiseAreNominalBitForBit) {
  // factor raised in: friction, gravity, backlash, compliance
  const std::map<std::string, std::array<bool, 4>> raised = {
      {"heavy_payload", {false, true, false, true}},
      {"thermal_drift_stribeck", {true, false, false, false}},
      {"thermal_drift_backlash", {false, false, true, false}},
      {"aged_transmission", {true, false, true, false}},
      {"aged_joint_uniform", {true, false, true, true}},
      {"aged_joint_shoulder", {true, false, true, true}},
      {"aged_joint_elbow", {true, false, true, true}}};
  for (const auto& [name, expected] : raised) {
    for (const double t : {0.0, 0.37, 1.0}) {
      const auto factors = FactorsAt(MakeScenario(name, 4).value(), t, 1);
      for (int j = 0; j < 7; ++j) {
        const bool worn = name == "aged_joint_shoulder" ? j < 3
                          : name == "aged_joint_elbow"  ? j == 3
                                                        : true;
        EXPECT_EQ(factors[j].friction > 1, expected[0] && worn) << name << j;
        EXPECT_EQ(factors[j].gravity > 1, expected[1] && worn) << name << j;
        EXPECT_EQ(factors[j].backlash > 1, expected[2] && worn) << name << j;
        EXPECT_EQ(factors[j].compliance > 1, expected[3] && worn) << name << j;
        if (!worn)
          ExpectSame(Scale(NominalPandaErrors()[j], factors[j]), NominalPandaErrors()[j], name);
      }
    }
  }
}

TEST(Scenarios, HeavyPayloadIsNominalOutsideTheGraspAndLinearInTheGate) {
  for (int j = 0; j < 7; ++j) {
    ExpectSame(At("heavy_payload", j, 0.5, 0), NominalPandaErrors()[j], "outside the grasp");
    EXPECT_DOUBLE_EQ(At("heavy_payload", j, 0, 1).K, j < 4 ? 1200 : 800);
  }
  const SeverityFactors half = FactorsAt(MakeScenario("heavy_payload", 5).value(), 0, 0.5)[2];
  EXPECT_DOUBLE_EQ(half.gravity, 2.5);     // linear in w, so beta is linear
  EXPECT_DOUBLE_EQ(half.compliance, 3.0);  // and K = K0 / 3, not the middle of K0 and K0 / 5
  EXPECT_DOUBLE_EQ(At("heavy_payload", 2, 0, 0.5).K, 2000);
}

TEST(Scenarios, ThermalDriftRampsLinearlyAndIsHeldBeyondTheHorizon) {
  EXPECT_DOUBLE_EQ(At("thermal_drift_stribeck", 0, 0.5, 0).Fs, 3.48 * 1.75);
  EXPECT_DOUBLE_EQ(At("thermal_drift_backlash", 6, 1, 0).B, 0.0195);
  EXPECT_DOUBLE_EQ(At("thermal_drift_backlash", 6, 0.25, 0).B, 0.0013 * 7.5);
  EXPECT_DOUBLE_EQ(At("thermal_drift_backlash", 6, 7, 0).B, 0.0195);  // held beyond the horizon
}

TEST(Scenarios, FactorOneEqualsNominalBitForBit) {
  for (const JointErrorParameters& p : NominalPandaErrors()) ExpectSame(Scale(p, {}), p, "w = 1");
}

TEST(Scenarios, DevMixedIsItsOwn) {
  for (const int level : {1, 5}) {
    const auto factors = FactorsAt(MakeScenario("dev_mixed", level).value(), 0.3, 1);
    for (int j = 0; j < 7; ++j) {
      EXPECT_EQ(factors[j].friction, 1.3);
      EXPECT_EQ(factors[j].backlash, 8);
      EXPECT_EQ(factors[j].gravity, 1);
      EXPECT_EQ(factors[j].compliance, j == 1 || j == 4 || j == 5 ? 3 : 1);
    }
  }
  EXPECT_FALSE(MakeScenario("dev_mixed", 5)->deployment);
}

TEST(Scenarios, RefusesUnknownNamesAndLevels) {
  const auto unknown = MakeScenario("aged_wrist", 5);
  EXPECT_EQ(unknown.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(unknown.status().message()), HasSubstr("aged_joint_elbow"));
  for (const int level : {0, 6, -1}) {
    EXPECT_EQ(MakeScenario("clean", level).status().code(), absl::StatusCode::kInvalidArgument);
  }
}

}  // namespace
}  // namespace robostress
