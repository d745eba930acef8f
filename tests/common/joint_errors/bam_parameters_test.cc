#include "common/joint_errors/bam_parameters.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/joint_errors/scenarios.h"
#include "nlohmann/json.hpp"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
namespace fs = std::filesystem;

// Of no servo: numbers of this test.
nlohmann::json BamJson(int model) {
  nlohmann::json json = {{"model", absl::StrCat("m", model)},
                         {"actuator", "made_up"},
                         {"kt", 1.5},
                         {"R", 2.5},
                         {"armature", 0.011},
                         {"q_offset", 0.02},
                         {"friction_base", 0.04},
                         {"friction_viscous", 0.07}};
  if (model == 2 || model >= 4)
    json.update({{"friction_stribeck", 0.03}, {"dtheta_stribeck", 0.25}, {"alpha", 1.4}});
  if (model == 3 || model == 4) json["load_friction_base"] = 0.15;
  if (model == 4) json["load_friction_stribeck"] = 0.06;
  if (model >= 5)
    json.update({{"load_friction_motor", 0.12},
                 {"load_friction_external", 0.21},
                 {"load_friction_motor_stribeck", 0.05},
                 {"load_friction_external_stribeck", 0.02}});
  if (model == 6)
    json.update({{"load_friction_motor_quad", 0.004}, {"load_friction_external_quad", 0.008}});
  return json;
}

BamParameters Servo(const nlohmann::json& json) {
  const auto servo = ParseBamParameters("servo.json", json.dump());
  EXPECT_TRUE(servo.ok()) << servo.status();
  return servo.ok() ? *servo : BamParameters();
}

std::string WhyRefused(const nlohmann::json& json) {
  const auto servo = ParseBamParameters("servo.json", json.dump());
  EXPECT_FALSE(servo.ok());
  return std::string(servo.status().message());
}

// bam/model.py, compute_frictions, with its branches as there; from the JSON, not from the reader.
double Published(const nlohmann::json& p, double motor, double external, double dq) {
  const std::string model = p["model"];
  const bool stribeck = model != "m1" && model != "m3", directional = model >= "m5";
  const auto at = [&](const char* name) { return p.value(name, 0.0); };
  const double gear =
      directional
          ? std::abs(external * at("load_friction_external") - motor * at("load_friction_motor"))
          : std::abs(external - motor);
  double loss = at("friction_base");
  if (model >= "m3") loss += directional ? gear : at("load_friction_base") * gear;
  if (!stribeck) return loss;
  const double near_rest = std::exp(-std::pow(std::abs(dq / at("dtheta_stribeck")), at("alpha")));
  loss += near_rest * at("friction_stribeck");
  if (model == "m4") loss += at("load_friction_stribeck") * gear * near_rest;
  if (directional)
    loss += near_rest * std::abs(external * at("load_friction_external_stribeck") -
                                 motor * at("load_friction_motor_stribeck"));
  const bool same = (external > 0) == (motor > 0) && (external < 0) == (motor < 0);
  if (model == "m6" && !same && std::abs(external) != std::abs(motor))
    loss += near_rest * (std::abs(external) < std::abs(motor)
                             ? at("load_friction_external_quad") * external * external
                             : at("load_friction_motor_quad") * motor * motor);
  return loss;
}

struct Friction {
  double dry = 0, torque = 0;
};

// What the library's own effects make of the mapped parameters.
Friction OfLibrary(const BamEffects& mapped, double motor, double external, double dq) {
  JointMoment moment;
  moment.dq = dq;
  moment.drive = motor;
  moment.gravity = -external;  // what holds the joint against it
  Friction sum;
  for (const ScenarioEffect& effect : mapped.effects) {
    const std::unique_ptr<JointEffect> law = (*FindEffect(effect.type))->make();
    law->SetParameters(effect.values);
    DryFriction dry;
    sum.torque += law->Torque(moment, dry);
    EXPECT_EQ(dry.forward, dry.backward);
    sum.dry += dry.forward;
  }
  return sum;
}

// The largest difference of the library's effects from the published law, on a grid of its own.
BamDifference OnGrid(const nlohmann::json& json) {
  const BamParameters servo = Servo(json);
  const BamEffects mapped = EffectsOfBam(servo);
  BamDifference largest;
  for (int at = 0; at <= 100; ++at) {
    for (int i = 0; i <= 20; ++i) {
      for (int k = -20; k <= 20; ++k) {
        const double dq = 0.04 * at, motor = 0.05 * i, external = 0.05 * k;
        const Friction found = OfLibrary(mapped, motor, external, dq);
        const double published = Published(json, motor, external, dq);
        EXPECT_NEAR(BamDryFriction(servo, motor, external, dq), published, 1e-15);
        EXPECT_NEAR(BamDryFriction(servo, -motor, -external, -dq), published, 1e-15);
        EXPECT_NEAR(found.torque, -0.07 * dq, 1e-15);
        double& of_kind = motor == 0 && external == 0 ? largest.unloaded
                          : external <= 0             ? largest.opposing
                                                      : largest.helping;
        of_kind = std::max(of_kind, std::abs(found.dry - published));
      }
    }
  }
  return largest;
}

TEST(BamParameters, MappedFrictionIsThePublishedLawUpToWhatIsSaid) {
  constexpr double kExact = 1e-15;
  for (int model = 1; model <= 6; ++model) {
    const nlohmann::json json = BamJson(model);
    const BamDifference found = OnGrid(json), said = LargestBamDifference(Servo(json), 1);
    std::printf("m%d: largest difference [Nm] %.4f without load, %.4f opposing, %.4f helping\n",
                model, found.unloaded, found.opposing, found.helping);
    // The two grids are not the same: a curve's maximum lies between their points.
    EXPECT_NEAR(found.unloaded, said.unloaded, 1e-4) << model;
    EXPECT_NEAR(found.opposing, said.opposing, 1e-4) << model;
    EXPECT_NEAR(found.helping, said.helping, 1e-4) << model;
    if (model == 1 || model == 3) {
      EXPECT_LT(found.unloaded + found.opposing, kExact);
    }
    if (model == 1) {
      EXPECT_LT(found.helping, kExact);
    }
  }
  // With BAM's exponent at ours, and without what grows towards rest, m2 and m6 are exact as well.
  nlohmann::json two = BamJson(2), six = BamJson(6);
  two["alpha"] = six["alpha"] = 2;
  for (const char* name : {"load_friction_motor_stribeck", "load_friction_external_stribeck",
                           "load_friction_motor_quad", "load_friction_external_quad"})
    six[name] = 0;
  EXPECT_LT(OnGrid(two).unloaded, kExact);
  EXPECT_LT(OnGrid(six).opposing, kExact);
  // Where gravity helps: the sum of what they take in place of the difference.
  EXPECT_NEAR(OnGrid(six).helping, 2 * 0.12, 1e-9);
}

TEST(BamParameters, StribeckCurvesEncloseTheSameArea) {
  const nlohmann::json json = BamJson(2);
  const BamEffects mapped = EffectsOfBam(Servo(json));
  double difference = 0;
  for (double dq = 0; dq < 10; dq += 1e-3)
    difference += 1e-3 * (OfLibrary(mapped, 0, 0, dq).dry - Published(json, 0, 0, dq));
  EXPECT_NEAR(difference, 0, 1e-8);
}

TEST(BamParameters, SaysWhatIsLeftOut) {
  EXPECT_THAT(EffectsOfBam(Servo(BamJson(1))).left_out,
              ElementsAre("q_offset 0.02: of BAM's test bench"));
  EXPECT_THAT(EffectsOfBam(Servo(BamJson(6))).left_out,
              ElementsAre(HasSubstr("load_friction_motor_stribeck 0.05: friction by load does not"),
                          HasSubstr("load_friction_external_stribeck 0.02"),
                          HasSubstr("load_friction_motor_quad 0.004: friction is linear"),
                          HasSubstr("load_friction_external_quad 0.008"), HasSubstr("q_offset")));
  nlohmann::json newer = BamJson(3);
  newer.erase("q_offset");
  newer["alpha"] = 2;
  EXPECT_THAT(EffectsOfBam(Servo(newer)).left_out,
              ElementsAre("alpha 2: model m3 of BAM has no such term"));
  nlohmann::json none = BamJson(1);
  none["friction_base"] = none["friction_viscous"] = 0;
  EXPECT_THAT(EffectsOfBam(Servo(none)).effects, IsEmpty());
}

// bam/params/feetech_sts3215_7_4V/m6.json has these.
TEST(BamParameters, TermsOfTheServosControllerAreNoneOfTheFrictionModels) {
  nlohmann::json json = BamJson(6);
  json.update({{"actuator", "sts3215"}, {"error_gain_ratio", 1.16}, {"max_velocity", 5.1}});
  const std::vector<std::string> left_out = EffectsOfBam(Servo(json)).left_out;
  EXPECT_THAT(left_out, Contains("error_gain_ratio 1.16: of the servo's controller: multiply the "
                                 "rig's kp by it"));
  EXPECT_THAT(left_out, Contains(HasSubstr("max_velocity 5.1: of the servo's controller")));
  EXPECT_THAT(left_out, Not(Contains(HasSubstr("has no such term"))));
}

TEST(BamParameters, AServoThatIsDrivenByACurrentIsNoMotorAtAVoltage) {
  nlohmann::json json = BamJson(3);
  EXPECT_THAT(RigJointOfBam(Servo(json), "J"), HasSubstr("{type: dc_motor, kp: FILL_IN, kt: 1.5"));
  json.update({{"actuator", "feetech_hls"}, {"current_limit", 2}});
  EXPECT_THAT(RigJointOfBam(Servo(json), "J"),
              HasSubstr("servo: {kp: FILL_IN, kd: FILL_IN, torque_limit: 3}  # [Nm/rad], "
                        "[Nm s/rad]: 1.5 Nm/A times those in amperes\n"));
  EXPECT_THAT(EffectsOfBam(Servo(json)).left_out, Not(Contains(HasSubstr("current_limit"))));
  for (const char* actuator : {"erob80_50", "erob80_100", "xl330i"}) {
    json["actuator"] = actuator;
    EXPECT_THAT(RigJointOfBam(Servo(json), "J"), Not(HasSubstr("dc_motor"))) << actuator;
  }
}

TEST(BamParameters, BadInputIsRefusedByFieldValueAndRemedy) {
  const auto with = [](int model, const char* name, const nlohmann::json& value) {
    nlohmann::json json = BamJson(model);
    json[name] = value;
    return WhyRefused(json);
  };
  EXPECT_EQ(with(1, "friction_base", -0.1),
            "servo.json: friction_base: is -0.1, must be a number of at least 0; correct it or fit "
            "with BAM again");
  EXPECT_THAT(with(2, "alpha", 0), HasSubstr("alpha: is 0, must be a number above 0"));
  EXPECT_THAT(with(1, "kt", "1.5"), HasSubstr("kt: is \"1.5\", must be a number above 0"));
  EXPECT_THAT(with(1, "R", 0), HasSubstr("R: is 0, must be a number above 0"));
  EXPECT_THAT(with(1, "model", "m7"), HasSubstr("model: is \"m7\", must be m1 to m6"));
  EXPECT_THAT(with(1, "actuator", 3), HasSubstr("actuator: is 3, must be a text"));
  nlohmann::json lacking = BamJson(6);
  lacking.erase("load_friction_motor_quad");
  EXPECT_THAT(WhyRefused(lacking), HasSubstr("load_friction_motor_quad: is missing, must be"));
  EXPECT_THAT(WhyRefused(nlohmann::json::array()), HasSubstr("give a file that BAM's fit wrote"));
  // What the Panda's scenarios may not hold.
  nlohmann::json strong = BamJson(1);
  strong["friction_base"] = 30;
  const auto scenario = ScenarioOfBam(Servo(strong), {0, 6}, kPanda);
  EXPECT_THAT(
      std::string(scenario.status().message()),
      AllOf(HasSubstr("servo.json"), HasSubstr("Fc: is 30 Nm at J7"), HasSubstr("at most 24")));
}

TEST(BamParameters, TheProgramWritesAScenarioThatASweepTakes) {
  const fs::path folder = fs::path(testing::TempDir()) / "bam_parameters";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const std::string params = (folder / "m6.json").string(), out = (folder / "servo.yaml").string();
  ASSERT_TRUE(WriteFileAtomically(params, BamJson(6).dump()).ok());
  const auto run = [&](const std::string& arguments) {
    return RunProgram(BIN_DIR "/robostress-scenarios",
                      absl::StrCat("--from-bam ", params, " ", arguments));
  };
  const auto [said, code] = run("--joints J2,J7 --out " + out);
  ASSERT_EQ(code, 0) << said;
  EXPECT_THAT(said, AllOf(HasSubstr("left out: load_friction_motor_quad 0.004"),
                          HasSubstr("largest difference"),
                          HasSubstr("servo: {type: dc_motor, kp: FILL_IN, kt: 1.5, R: 2.5, vin: "
                                    "FILL_IN}"),
                          HasSubstr("parameters: {armature: 0.011}")));
  const auto scenario = MakeScenario(out, 5);
  ASSERT_TRUE(scenario.ok()) << scenario.status();
  EXPECT_EQ(scenario->title, "Servo made_up, BAM m6");
  ASSERT_EQ(scenario->effects.size(), 6);
  const ScenarioEffect& last = scenario->effects[3];
  EXPECT_EQ(last.joint, 6);
  EXPECT_EQ(last.type, "stribeck_friction");
  EXPECT_THAT(last.values, ElementsAre(0.04, 0.07, testing::DoubleNear(0.25711, 1e-5), 0.07));
  EXPECT_EQ(scenario->effects[1].values, std::vector<double>{0.12});
  EXPECT_EQ(scenario->effects[2].type, "gravity_dependent_friction");
  EXPECT_EQ(scenario->effects[2].values, std::vector<double>{0.21});
  EXPECT_THAT(run("--out " + out).first, HasSubstr("must be a new file"));
  EXPECT_THAT(run("--joints J9 --out " + out + ".yaml").first, HasSubstr("J1 to J7"));
  EXPECT_EQ(run("").second, 2);
  EXPECT_THAT(RunProgram(BIN_DIR "/robostress-scenarios", "--joints J1").first,
              HasSubstr("go with --from-bam"));
}

}  // namespace
}  // namespace robostress
