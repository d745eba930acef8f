#include "calibration/model/unit_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

using generator::Family;
using testing::HasSubstr;

constexpr double kDegreesOfRadian = 180 / M_PI;
constexpr Family kDriven[] = {Family::kServo, Family::kTorque, Family::kInverse, Family::kArm,
                              Family::kSlide};

// A rig with nothing hidden whose positions are multiplied by `unit`, as the gates see it.
absl::Status GatesOf(Family family, uint64_t seed, double unit,
                     generator::Richness richness = generator::Richness::kBrief) {
  generator::RigOptions options;
  options.family = family;
  options.seed = seed;
  options.richness = richness;
  auto machine = generator::GenerateRig(options);
  if (!machine.ok()) return machine.status();
  for (auto& log : machine->logs)
    for (auto& joint : log.recording.joints)
      for (auto* channel : {&joint.command, &joint.q, &joint.motor})
        for (double& value : *channel) value *= unit;
  const std::string folder = testing::TempDir() + "/units";
  std::filesystem::remove_all(folder);
  if (absl::Status written = WriteGeneratedRig(*machine, options, folder); !written.ok())
    return written;
  const auto rig = LoadRig(folder + "/rig.yaml");
  if (!rig.ok()) return rig.status();
  return CheckUnits(rig->rig, *rig->plant, rig->logs).status();
}

TEST(UnitCheck, PassesGeneratedRigsInRadiansAndMetres) {
  for (const Family family : kDriven) {
    for (uint64_t seed = 1; seed <= 12; ++seed) {
      const auto richness = seed % 2 ? generator::Richness::kBrief : generator::Richness::kAny;
      EXPECT_TRUE(GatesOf(family, seed, 1, richness).ok())
          << FamilyName(family) << " " << seed << ": " << GatesOf(family, seed, 1, richness);
    }
  }
}

// Of a rig whose joint is `family`'s, with this override in its first log.
absl::Status GatesOfOverride(Family family, const std::string& key) {
  generator::RigOptions options;
  options.family = family;
  options.richness = generator::Richness::kBrief;
  const auto machine = generator::GenerateRig(options);
  if (!machine.ok()) return machine.status();
  const std::string folder = testing::TempDir() + "/overrides";
  std::filesystem::remove_all(folder);
  if (absl::Status written = WriteGeneratedRig(*machine, options, folder); !written.ok())
    return written;
  auto rig = LoadRig(folder + "/rig.yaml");
  if (!rig.ok()) return rig.status();
  rig->logs[0].overrides["hinge." + key] = 0.3;
  return CheckUnits(rig->rig, *rig->plant, rig->logs).status();
}

TEST(UnitCheck, NamesAnOverrideThatIsNone) {
  for (const Family family : {Family::kServo, Family::kTransmission}) {
    EXPECT_TRUE(GatesOfOverride(family, "known_mass").ok());
    EXPECT_THAT(std::string(GatesOfOverride(family, "known_mas").message()),
                testing::AllOf(HasSubstr("rig.yaml: log "), HasSubstr("log_0.csv"),
                               HasSubstr("override 'hinge.known_mas'"), HasSubstr("force_lag"),
                               HasSubstr("known_mass")));
  }
}

TEST(UnitCheck, RefusesGeneratedRigsInDegreesOrMillimetres) {
  for (const Family family : kDriven) {
    const bool slide = family == Family::kSlide;
    for (uint64_t seed = 1; seed <= 6; ++seed) {
      const absl::Status gates = GatesOf(family, seed, slide ? 1000 : kDegreesOfRadian);
      EXPECT_THAT(std::string(gates.message()), HasSubstr(slide ? "0.001" : "0.0174533"))
          << FamilyName(family) << " " << seed;
    }
  }
}

// A pendulum of 1 kg at 0.3 m under a logged torque, which follows a sine exactly.
class Pendulum : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "/unit_pendulum";
    ASSERT_TRUE(MakeDirectories(folder_).ok());
    SetModel("");
    rig_.model = folder_ + "/m.xml";
    rig_.rate_hz = 200;
    RigJoint joint;
    joint.name = "hinge";
    joint.input = JointInput::kInverse;
    rig_.joints = {joint};
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  void SetModel(const std::string& attributes) {
    ASSERT_TRUE(WriteFileAtomically(
                    folder_ + "/m.xml",
                    absl::StrCat("<mujoco><compiler angle=\"radian\"/><worldbody><body><joint "
                                 "name=\"hinge\" axis=\"0 1 0\" ",
                                 attributes,
                                 "/><inertial pos=\"0 0 -0.3\" mass=\"1\" diaginertia=\"0.01 "
                                 "0.01 0.01\"/></body></worldbody></mujoco>"))
                    .ok());
  }
  // amplitude [rad], frequency [Hz]; what is written is `unit` times the angle and `torque` times
  // the torque.
  absl::Status Gates(double amplitude, double frequency, double unit, double friction = 0.1,
                     double torque = 1) {
    const double w = 2 * M_PI * frequency, I = 0.01 + 0.09, mgl = 9.81 * 0.3;
    std::string text = "t,q_hinge,tau_hinge\n";
    for (int k = 0; k < 4000; ++k) {
      const double t = k / 200.0, q = amplitude * std::sin(w * t),
                   v = amplitude * w * std::cos(w * t);
      const double tau = -I * w * w * q + mgl * std::sin(q) + friction * (v > 0 ? 1 : -1);
      absl::StrAppend(&text, t, ",", unit * q, ",", torque * tau, "\n");
    }
    RigLog log;
    log.file = folder_ + "/log.csv";
    EXPECT_TRUE(WriteFileAtomically(log.file, text).ok());
    auto plant = Plant::Load(rig_);
    if (!plant.ok()) return plant.status();
    auto measured = ReadMeasuredLog(rig_, log);
    if (!measured.ok()) return measured.status();
    const auto unchecked = CheckUnits(rig_, **plant, {*measured});
    if (unchecked.ok()) unchecked_ = *unchecked;
    return unchecked.status();
  }
  std::string folder_;
  Rig rig_;
  std::vector<std::string> unchecked_;
};

// Of an upright axis without stops, behind a servo whose torque nobody logged, no unit follows.
TEST_F(Pendulum, WhereNothingTellsAUnitTheJointIsNamed) {
  ASSERT_TRUE(Gates(0.5, 0.5, 1).ok());
  EXPECT_THAT(unchecked_, testing::IsEmpty());
  rig_.joints[0].input = JointInput::kPositionTarget;
  rig_.joints[0].servo.kp = 20;
  const auto unchecked = [&](double unit) {
    std::string text = "t,q_cmd_hinge,q_hinge\n";
    for (int k = 0; k < 2000; ++k)
      absl::StrAppend(&text, k / 200.0, ",", unit * std::sin(k / 100.0), ",",
                      unit * std::sin(k / 100.0 - 0.05), "\n");
    RigLog log;
    log.file = folder_ + "/servo.csv";
    EXPECT_TRUE(WriteFileAtomically(log.file, text).ok());
    const auto plant = Plant::Load(rig_);
    EXPECT_TRUE(plant.ok()) << plant.status();
    const auto measured = ReadMeasuredLog(rig_, log);
    EXPECT_TRUE(measured.ok()) << measured.status();
    const auto found = CheckUnits(rig_, **plant, {*measured});
    EXPECT_TRUE(found.ok()) << found.status();
    return found.ok() ? *found : std::vector<std::string>();
  };
  SetModel("range=\"-2 2\" limited=\"true\" ");
  EXPECT_THAT(unchecked(1), testing::IsEmpty());
  rig_.gravity = {0, 0, 0};
  SetModel("");
  EXPECT_THAT(unchecked(1), testing::ElementsAre("hinge"));
  EXPECT_THAT(unchecked(kDegreesOfRadian), testing::ElementsAre("hinge"));
}

TEST_F(Pendulum, SlowSmallFastAndManyTurnsInRadiansPass) {
  for (const auto& [amplitude, frequency] : {std::pair(0.01, 0.05),
                                             {0.5, 0.05},
                                             {0.5, 1.0},
                                             {0.2, 4.0},
                                             {3.0, 0.5},
                                             {20.0, 0.1},
                                             {40.0, 0.05}})
    EXPECT_TRUE(Gates(amplitude, frequency, 1).ok())
        << amplitude << " rad, " << frequency << " Hz: " << Gates(amplitude, frequency, 1);
}

TEST_F(Pendulum, SlowDegreesAreKnownByGravityAndFastOnesByEnergy) {
  EXPECT_THAT(std::string(Gates(0.5, 0.05, kDegreesOfRadian).message()),
              testing::AllOf(HasSubstr("gravity leaves"), HasSubstr("0.0174533")));
  EXPECT_THAT(std::string(Gates(0.5, 1, kDegreesOfRadian).message()),
              testing::AllOf(HasSubstr("J while drive and gravity"), HasSubstr("0.0174533")));
}

TEST_F(Pendulum, PositionsBeyondTheModelsStopsAreRefused) {
  SetModel("limited=\"true\" range=\"-2 2\"");
  EXPECT_TRUE(Gates(1.9, 0.2, 1).ok());
  EXPECT_THAT(std::string(Gates(0.5, 0.05, kDegreesOfRadian).message()),
              HasSubstr("its stops in the model are 4 rad apart"));
}

TEST_F(Pendulum, TorqueThatCountsTheOtherWayOrInThousandthsIsRefused) {
  EXPECT_THAT(
      std::string(Gates(0.5, 0.5, 1, 0.3, -1).message()),
      HasSubstr(
          "over 1 log its torque is -1.002 times what its motion asks of the model's masses and "
          "gravity; if it counts the other way multiply it by -1"));
  EXPECT_THAT(std::string(Gates(0.5, 0.5, 1, 0.3, 1000).message()),
              HasSubstr("thousandths multiply them by 0.001"));
  for (const double torque : {0.5, 1.0, 3.0, 30.0}) {  // a model's masses may be this wrong
    EXPECT_TRUE(Gates(0.5, 0.5, 1, 0.3, torque).ok()) << Gates(0.5, 0.5, 1, 0.3, torque);
  }
}

}  // namespace
}  // namespace robostress::calibration
