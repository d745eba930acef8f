// Rigs of four common arms from model files of the kind that their users have, with logs of one
// hidden effect each: it is named, on its joint, and another joint stays as it was declared.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/calibrate.h"
#include "nlohmann/json.hpp"
#include "tests/calibration/generator/spatial_arm.h"

namespace robostress::calibration {
namespace {

using generator::SpatialArm;
using generator::SpatialFault;
using testing::AllOf;
using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::Not;

class ArmRigTest : public testing::Test {
 protected:
  void TearDown() override { std::filesystem::remove_all(folder_); }

  // What `calibrate` says of the joints named, the one with the fault first.
  void Trace(const SpatialArm& arm, const SpatialFault& fault, const std::string& format,
             const std::vector<std::string>& joints) {
    const auto wrote = generator::WriteSpatialRig(arm, fault, format,
                                                  {"armature", "damping", "frictionloss"}, folder_);
    ASSERT_TRUE(wrote.ok()) << wrote;
    const auto rig = ReadRig(folder_ + "/rig.yaml");
    ASSERT_TRUE(rig.ok()) << rig.status();
    TraceOptions options;
    options.joints = joints;
    options.surrogates = 99;
    options.max_effects = 1;
    options.beam = 1;
    const auto calibration = Calibrate(*rig, options);
    ASSERT_TRUE(calibration.ok()) << calibration.status();
    report_ = calibration->report;
    ASSERT_EQ(report_.joints.size(), joints.size());
  }
  const JointReport& Of(const std::string& joint) const {
    return *std::find_if(report_.joints.begin(), report_.joints.end(),
                         [&](const JointReport& report) { return report.joint == joint; });
  }
  // Of the one effect that was added to a joint.
  double Found(const std::string& joint, const std::string& type, const std::string& name) const {
    const JointReport& report = Of(joint);
    EXPECT_EQ(report.verdict, Verdict::kAttributed) << report.because;
    EXPECT_EQ(report.effects.size(), 1u);
    for (const AddedEffectReport& effect : report.effects) {
      EXPECT_EQ(effect.type, type);
      for (const ParameterReport& parameter : effect.parameters)
        if (parameter.name == name) return parameter.value;
    }
    return std::nan("");
  }
  void ExpectHealthy(const std::string& joint) const {
    EXPECT_EQ(Of(joint).verdict, Verdict::kDeclaredSufficient) << Of(joint).because;
    EXPECT_TRUE(Of(joint).effects.empty());
  }

  const std::string folder_ =
      (std::filesystem::path(testing::TempDir()) / absl::StrCat("arm_rig_", getpid())).string();
  CalibrationReport report_;
};

TEST_F(ArmRigTest, So101sGearHasAGap) {
  SpatialFault fault;
  fault.joint = 2;
  fault.backlash = 0.012;
  Trace(generator::So101(), fault, "urdf", {"elbow_flex", "wrist_flex"});
  EXPECT_NEAR(Found("elbow_flex", "backlash", "B"), 0.012, 0.001);
  ExpectHealthy("wrist_flex");
  // The same table in every form.
  const ModelFact armature = {"elbow_flex", "armature", "0 kg m^2, fitted", FactSource::kRig, ""};
  EXPECT_THAT(report_.model_facts, Contains(AllOf(Field(&ModelFact::part, armature.part),
                                                  Field(&ModelFact::what, armature.what),
                                                  Field(&ModelFact::value, armature.value),
                                                  Field(&ModelFact::source, armature.source))));
  EXPECT_THAT(report_.model_facts, Not(Contains(Field(&ModelFact::part, "shoulder_lift"))))
      << "it was not traced";
  const auto json = nlohmann::json::parse(ReportJson(report_));
  EXPECT_THAT(
      json["model_table"].dump(),
      HasSubstr(
          R"({"part":"elbow_flex","remedy":"","source":"rig","value":"0 kg m^2, fitted","what":"armature"})"));
  EXPECT_THAT(ReportHtml(report_), HasSubstr("<td>elbow_flex</td><td>armature</td>"));
  EXPECT_THAT(ModelTableText(report_.model_facts, ""),
              HasSubstr("armature 0 kg m^2, fitted (rig)"));
}

TEST_F(ArmRigTest, Ur5esCoggingGearIsFound) {
  SpatialFault fault;
  fault.joint = 3;
  fault.torque = [](double q, double) { return 4 * std::cos(2 * M_PI * q / 0.2); };
  Trace(generator::Ur5e(), fault, "urdf", {"wrist_1_joint", "elbow_joint"});
  const double a = Found("wrist_1_joint", "position_periodic_torque", "a");
  const double b = Found("wrist_1_joint", "position_periodic_torque", "b");
  EXPECT_NEAR(std::hypot(a, b), 4, 0.4);
  EXPECT_NEAR(Found("wrist_1_joint", "position_periodic_torque", "wavelength"), 0.2, 0.004);
  ExpectHealthy("elbow_joint");
}

TEST_F(ArmRigTest, FrankasHoseIsFoundByAModelForANewerMujocoWithoutItsMeshes) {
  SpatialFault fault;
  fault.joint = 5;
  fault.torque = [](double q, double) { return -6 * (q - 1.5); };
  Trace(generator::FrankaPanda(), fault, "mjcf", {"joint6", "joint4"});
  EXPECT_NEAR(Found("joint6", "cable_spring", "k"), 6, 0.6);
  EXPECT_NEAR(Found("joint6", "cable_spring", "q0"), 1.5, 0.05);
  ExpectHealthy("joint4");
}

TEST_F(ArmRigTest, PipersFrictionThatDependsOnItsDirectionIsFound) {
  SpatialFault fault;
  fault.joint = 2;
  fault.dry_friction = [](double, double dq) { return dq > 0 ? 1.25 : 0.25; };
  Trace(generator::Piper(), fault, "urdf", {"joint3", "joint2"});
  // The mean of both directions, 0.75 Nm, is the declared frictionloss.
  EXPECT_NEAR(Found("joint3", "asymmetric_coulomb", "dFc"), 0.5, 0.05);
  ExpectHealthy("joint2");
}

}  // namespace
}  // namespace robostress::calibration
