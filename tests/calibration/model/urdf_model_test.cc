#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "calibration/model/joint_model.h"
#include "common/models/urdf_inertia.h"
#include "common/random.h"
#include "tests/calibration/generator/spatial_arm.h"
#include "tests/calibration/model/model_text.h"

namespace robostress::calibration {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;

class UrdfModelTest : public ModelText {};

// Terms of M ddq + bias = tau at a state, of whatever order the joints have in the model.
struct Dynamics {
  Matrix mass;
  Vector bias, torque, acceleration;
};

Dynamics DynamicsAt(const mjModel& shared, const std::vector<std::string>& joints, const Vector& q,
                    const Vector& dq, const Vector& ddq) {
  mjModel* model = mj_copyModel(nullptr, &shared);
  mjData* data = mj_makeData(model);
  const int n = static_cast<int>(joints.size());
  EXPECT_EQ(model->nv, n);
  std::vector<int> dof;
  for (int i = 0; i < n; ++i) {
    const int id = mj_name2id(model, mjOBJ_JOINT, joints[static_cast<size_t>(i)].c_str());
    dof.push_back(model->jnt_dofadr[id]);
    data->qpos[model->jnt_qposadr[id]] = q[i];
    data->qvel[dof.back()] = dq[i];
    data->qacc[dof.back()] = ddq[i];
  }
  mj_kinematics(model, data);
  mj_comPos(model, data);
  mj_crb(model, data);
  mj_comVel(model, data);
  Matrix full(n, n);
  mj_fullM(model, full.data(), data->qM);
  Vector bias(n), torque(n);
  mj_rne(model, data, 0, bias.data());
  mj_rne(model, data, 1, torque.data());
  Dynamics result{Matrix(n, n), Vector(n), Vector(n), Vector(n)};
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) result.mass(i, j) = full(dof[i], dof[j]);
    result.bias[i] = bias[dof[i]];
    result.torque[i] = torque[dof[i]];
  }
  // Forward: what a given torque accelerates.
  result.acceleration = result.mass.ldlt().solve(ddq - result.bias);
  mj_deleteData(data);
  mj_deleteModel(model);
  return result;
}

TEST_F(UrdfModelTest, HasTheDynamicsOfTheSameArmInMjcf) {
  RandomStream random(StreamKey("urdf against mjcf"));
  for (const generator::SpatialArm& arm :
       {generator::So101(), generator::Ur5e(), generator::FrankaPanda(), generator::Piper()}) {
    SCOPED_TRACE(arm.name);
    std::vector<std::string> joints;
    for (const generator::SpatialLink& link : arm.links) joints.push_back(link.joint);
    const auto urdf = Load(generator::UrdfOf(arm), joints);
    ASSERT_TRUE(urdf.ok()) << urdf.status();
    const auto mjcf = Load(generator::MjcfOf(arm, false), joints);
    ASSERT_TRUE(mjcf.ok()) << mjcf.status();
    const auto n = static_cast<Eigen::Index>(joints.size());
    for (int state = 0; state < 20; ++state) {
      Vector q(n), dq(n), ddq(n);
      for (Eigen::Index i = 0; i < n; ++i)
        q[i] = random.Uniform(-3, 3), dq[i] = random.Uniform(-2, 2), ddq[i] = random.Uniform(-9, 9);
      const Dynamics a = DynamicsAt(*urdf->model, joints, q, dq, ddq);
      const Dynamics b = DynamicsAt(*mjcf->model, joints, q, dq, ddq);
      // Both round at 1e-16 a term.
      const double size = 1 + b.torque.cwiseAbs().maxCoeff();
      EXPECT_LT((a.mass - b.mass).cwiseAbs().maxCoeff(), 1e-12);
      EXPECT_LT((a.bias - b.bias).cwiseAbs().maxCoeff(), 1e-12 * size);
      EXPECT_LT((a.torque - b.torque).cwiseAbs().maxCoeff(), 1e-12 * size);
      // An acceleration by the torque that its rounding is worth.
      const double pull = 1 + (b.mass.cwiseAbs() * b.acceleration.cwiseAbs()).maxCoeff();
      EXPECT_LT((b.mass * (a.acceleration - b.acceleration)).cwiseAbs().maxCoeff(), 1e-12 * pull);
    }
  }
}

// M of a double pendulum of point masses and inertias, in closed form.
TEST_F(UrdfModelTest, HasTheClosedFormOfADoublePendulum) {
  const auto loaded = Load(With("rpy=\"0.3 0 0\"", ""), {"shoulder", "elbow"});
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  const double q2 = 0.7;
  const Dynamics d = DynamicsAt(*loaded->model, {"shoulder", "elbow"}, Eigen::Vector2d(0.4, q2),
                                Vector::Zero(2), Vector::Zero(2));
  // The lower link: 1 kg at 0.1 m, and both fingers, 0.04 kg at 0.2 m.
  const double m1 = 2, c1 = 0.2, i1 = 0.03, l = 0.4, m2 = 1.04, first = 0.1 + 0.04 * 0.2,
               second = 0.01 + 0.01 + 0.04 * 0.04;
  EXPECT_NEAR(d.mass(1, 1), second, 1e-9);
  EXPECT_NEAR(d.mass(0, 1), second + l * first * std::cos(q2), 1e-9);
  EXPECT_NEAR(d.mass(0, 0), i1 + m1 * c1 * c1 + m2 * l * l + second + 2 * l * first * std::cos(q2),
              1e-9);
  EXPECT_NEAR(d.bias[1], 9.81 * first * std::sin(0.4 + q2), 1e-9);
}

TEST_F(UrdfModelTest, SaysWhatWasReadAndWhatWasAssumed) {
  Rig rig = RigOf(kTwoLinks, {"shoulder", "elbow"});
  rig.joints[1].fit = {"armature"};
  rig.joints[1].parameters = {{"damping", 0.25}};
  const auto plant = Plant::Load(rig);
  ASSERT_TRUE(plant.ok()) << plant.status();
  const std::string text = ModelTableText((*plant)->facts(), "");
  for (const char* said :
       {"URDF, 5 links, 2 of 4 joints move",
        "gravity 0 0 -9.81 m/s^2 in the base's frame (assumed)",
        "base link 'base', fixed to the world (assumed)",
        "visual and collision shapes 1 (left out)",
        "joints held at 0 finger, finger_2 (mimic of finger) (assumed)",
        "shoulder: type hinge from -2 to 2 rad; armature 0 kg m^2 (assumed); damping 0.5 Nm s/rad; "
        "frictionloss 0.1 Nm; torque limit 20 Nm (assumed)",
        "elbow: type hinge without stops; armature 0 kg m^2, fitted (rig); damping 0.25 Nm s/rad "
        "(rig); frictionloss 0 Nm (assumed); torque limit none (assumed)"})
    EXPECT_THAT(text, HasSubstr(said));
}

TEST_F(UrdfModelTest, ALimitOfEffortIsTheServosUnlessTheRigHasOne) {
  Rig rig = RigOf(kTwoLinks, {"shoulder", "elbow"});
  const auto limits = [&] {
    const auto plant = Plant::Load(rig);
    EXPECT_TRUE(plant.ok()) << plant.status();
    return std::pair(DeclaredModel(rig, **plant, 0)->servo.torque_limit,
                     DeclaredModel(rig, **plant, 1)->servo.torque_limit);
  };
  EXPECT_EQ(limits().first, 20);
  EXPECT_TRUE(std::isinf(limits().second)) << "nothing is said";
  rig.joints[0].servo.torque_limit = 7;
  EXPECT_EQ(limits().first, 7);
  rig = RigOf(With("effort=\"20\"", "effort=\"0\""), {"shoulder", "elbow"});
  EXPECT_TRUE(std::isinf(limits().first)) << "0 is what exporters write for unknown";
}

TEST_F(UrdfModelTest, GravityOfTheRigTurnsAnArm) {
  Rig rig = RigOf(kTwoLinks, {"shoulder", "elbow"});
  rig.gravity = {9.81, 0, 0};
  const auto loaded = LoadModel(rig);
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->model->opt.gravity[0], 9.81);
  EXPECT_EQ(loaded->model->opt.gravity[2], 0);
  EXPECT_THAT(ModelTableText(loaded->facts, ""),
              HasSubstr("gravity 9.81 0 0 m/s^2 in the base's frame (rig)"));
}

TEST_F(UrdfModelTest, APayloadHangsAtTheToolsLink) {
  const std::string text =
      With("</robot>",
           "<link name=\"tool0\"/><joint name=\"t\" type=\"fixed\"><origin xyz=\"0 0 -0.3\"/>"
           "<parent link=\"lower\"/><child link=\"tool0\"/></joint></robot>");
  MeasuredLog log;
  log.rows = 1;
  log.joints.resize(1);
  const auto inertia = [&](const std::string& urdf) {
    const auto plant = Plant::Load(RigOf(urdf, {"elbow"}));
    EXPECT_TRUE(plant.ok()) << plant.status();
    return (*plant)->Rows(0, log).front().payload_inertia;
  };
  EXPECT_NEAR(inertia(text), 0.09, 1e-12);
  EXPECT_NEAR(inertia(kTwoLinks), 0.04, 1e-12) << "of the last link, a finger";
}

TEST_F(UrdfModelTest, IsKnownByItsContent) {
  const auto urdf = LoadModel(RigOf(kTwoLinks, {"elbow"}, "arm.xml"));
  ASSERT_TRUE(urdf.ok()) << urdf.status();
  EXPECT_EQ(urdf->model->nv, 1) << "joints that the rig does not list are held";
  EXPECT_THAT(Refusal("<sdf/>", {"elbow"}), AllOf(HasSubstr("arm.model:1"), HasSubstr("<sdf>"),
                                                  HasSubstr("<mujoco> (MJCF) or <robot> (URDF)")));
}

TEST_F(UrdfModelTest, XacroIsRefusedWithTheCommandThatExpandsIt) {
  const auto refusal = [&](const std::string& text, const std::string& name) {
    const auto loaded = LoadModel(RigOf(text, {"elbow"}, name));
    return std::string(loaded.status().message());
  };
  const std::string macro = With("<link name=\"base\">", "<xacro:arm/>\n<link name=\"base\">");
  EXPECT_THAT(refusal(macro, "ur.urdf.xacro"), AllOf(HasSubstr("ur.urdf.xacro:3: <xacro:arm>"),
                                                     HasSubstr("`xacro ur.urdf.xacro > ur.urdf`")));
  EXPECT_THAT(refusal(macro, "arm.xacro"), HasSubstr("`xacro arm.xacro > arm.urdf`"));
  const std::string expression = With("xyz=\"0 0 -0.4\"", "xyz=\"0 0 ${-length}\"");
  EXPECT_THAT(refusal(expression, "arm.urdf"),
              AllOf(HasSubstr("xyz='0 0 ${-length}'"), HasSubstr("> arm_expanded.urdf`")));
  const std::string kept = With("<robot ", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" ");
  EXPECT_TRUE(LoadModel(RigOf(kept, {"elbow"})).ok()) << "what expanded files keep";
}

TEST_F(UrdfModelTest, RefusesWithLineValueAndRemedy) {
  const auto refusal = [&](const std::string& from, const std::string& to) {
    return Refusal(With(from, to), {"shoulder", "elbow"});
  };
  EXPECT_THAT(refusal("<mass value=\"2\"/>", "<mass value=\"-2\"/>"),
              AllOf(HasSubstr("arm.model:5: <mass> value is -2"), HasSubstr("at least 0")));
  EXPECT_THAT(refusal("value=\"2\"", "value=\"nan\""), HasSubstr("<mass> value is 'nan'"));
  EXPECT_THAT(refusal("value=\"2\"", "value=\"2,5\""), HasSubstr("as in 0.25"));
  EXPECT_THAT(refusal("value=\"2\"", "value=\"1e300\""), HasSubstr("at most 1e6"));
  EXPECT_THAT(refusal("xyz=\"0 0 -0.4\"", "xyz=\"0 0\""), HasSubstr("must be 3 numbers"));
  EXPECT_THAT(refusal("<mass value=\"2\"/>", ""),
              HasSubstr("link 'upper': <inertial> has no <mass"));
  EXPECT_THAT(refusal("ixx=\"0.03\"", "ixx=\"-0.03\""),
              AllOf(HasSubstr("arm.model:6: link 'upper': <inertia>: a principal moment is -0.03"),
                    HasSubstr("ixy")));
  EXPECT_THAT(refusal("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 0\"/>"),
              HasSubstr("joint 'shoulder': <axis xyz> has no direction"));
  EXPECT_THAT(refusal("\"continuous\"", "\"ball\""), HasSubstr("type is 'ball', must be one of"));
  EXPECT_THAT(refusal("\"continuous\"", "\"floating\""),
              HasSubstr("joint 'elbow' of the rig is floating"));
  EXPECT_THAT(refusal("<child link=\"lower\"/>", "<child link=\"lowre\"/>"),
              AllOf(HasSubstr("<child link> is 'lowre'"), HasSubstr("base, upper, lower")));
  EXPECT_THAT(refusal("<link name=\"lower\">", "<link name=\"upper\">"),
              HasSubstr("<link> 'upper' is there twice"));
  EXPECT_THAT(refusal("<joint name=\"elbow\"", "<joint name=\"shoulder\""),
              HasSubstr("<joint> 'shoulder' is there twice"));
  EXPECT_THAT(refusal("<link name=\"base\">", "<link>"), HasSubstr("<link> has no name"));
  EXPECT_THAT(refusal("<parent link=\"base\"/>", "<parent link=\"lower\"/>"),
              HasSubstr("links upper, lower, left, right carry each other in a circle"));
  EXPECT_THAT(refusal("<child link=\"left\"/>", "<child link=\"right\"/>"),
              HasSubstr("a closed chain"));
  EXPECT_THAT(refusal("</robot>", "<link name=\"stand\"/></robot>"),
              HasSubstr("links base, stand have no parent"));
  EXPECT_THAT(refusal("<mass value=\"1\"/>", "<mass value=\"1\"/><mass value=\"1\"/>"),
              HasSubstr("a second <mass>"));
  EXPECT_THAT(Refusal(kTwoLinks, {"wrist"}),
              HasSubstr("has no joint 'wrist'; it has shoulder, elbow, finger, finger_2"));
  EXPECT_THAT(Refusal("<robot/>", {"elbow"}), HasSubstr("<robot> has no <link>"));
  EXPECT_THAT(Refusal("<robot>", {"elbow"}), HasSubstr("no XML"));
  EXPECT_THAT(Refusal("", {"elbow"}), HasSubstr("arm.model"));
}

TEST_F(UrdfModelTest, ALinkThatMovesNeedsMassOnIt) {
  // All links at and behind the elbow.
  std::string light = kTwoLinks;
  const size_t lower = light.find("<link name=\"lower\">"), joints = light.find("<joint");
  light.replace(lower, joints - lower,
                "<link name=\"lower\"/><link name=\"left\"/><link name=\"right\"/>\n  ");
  EXPECT_THAT(Refusal(light, {"shoulder", "elbow"}),
              AllOf(HasSubstr("joint 'elbow' moves link 'lower'"), HasSubstr("has a mass"),
                    HasSubstr("take the joint out of the rig")));
  EXPECT_TRUE(Plant::Load(RigOf(light, {"shoulder"})).ok());
  // A link between two joints, as a cardan has it.
  std::string cardan = With("<link name=\"right\">", "<link name=\"cross\"/><link name=\"right\">");
  cardan = With("<parent link=\"upper\"/><child link=\"lower\"/>",
                "<parent link=\"upper\"/><child link=\"cross\"/>", cardan);
  cardan = With("</robot>",
                "<joint name=\"roll\" type=\"continuous\"><parent link=\"cross\"/><child "
                "link=\"lower\"/><axis xyz=\"1 0 0\"/></joint></robot>",
                cardan);
  const auto plant = Plant::Load(RigOf(cardan, {"elbow", "roll"}));
  ASSERT_TRUE(plant.ok()) << plant.status();
  EXPECT_THAT(ModelTableText((*plant)->facts(), ""), HasSubstr("cross: mass 1e-09 kg (assumed)"));
}

TEST_F(UrdfModelTest, APointOnItsOwnAxisIsRefusedUnlessTheRigGivesAnArmature) {
  const std::string text = With("<joint name=\"finger\" type=\"prismatic\">",
                                "<joint name=\"finger\" type=\"continuous\">");
  Rig rig = RigOf(text, {"finger"});
  EXPECT_THAT(std::string(Plant::Load(rig).status().message()),
              AllOf(HasSubstr("joint 'finger' moves an inertia of"), HasSubstr("armature")));
  rig.joints[0].parameters["armature"] = 0.01;
  EXPECT_TRUE(Plant::Load(rig).ok());
}

// As found in a Tiago's antenna and an iCub's head [kg m^2].
TEST_F(UrdfModelTest, WhatExportersWriteOfFramesIsNoReasonToRefuse) {
  Eigen::Matrix3d antenna;
  antenna << 2.371e-8, 6.119e-8, 1.179e-8, 6.119e-8, 2.833e-8, 7.74e-9, 1.179e-8, 7.74e-9, 3.849e-8;
  const auto repaired = RepairInertia(antenna, 1e-6);
  ASSERT_TRUE(repaired.ok()) << repaired.status();
  EXPECT_TRUE(repaired->changed);
  EXPECT_GE(repaired->after[0], 0);
  EXPECT_GE(repaired->after[0] + repaired->after[1], repaired->after[2]);
  EXPECT_FALSE(RepairInertia(antenna, 0.01).ok()) << "of a body that weighs something";
  Eigen::Matrix3d head = Eigen::Matrix3d::Zero();
  head(0, 2) = head(2, 0) = 2.40741e-35;
  const auto nothing = RepairInertia(head, 1.33687);
  ASSERT_TRUE(nothing.ok()) << nothing.status();
  EXPECT_FALSE(nothing->changed);
  EXPECT_EQ(nothing->inertia, Eigen::Matrix3d::Zero());
}

TEST_F(UrdfModelTest, AnInertiaThatNoBodyHasBecomesTheNearest) {
  const auto plant = Plant::Load(RigOf(
      With("ixx=\"0.03\" iyy=\"0.03\" izz=\"0.002\"", "ixx=\"0.03\" iyy=\"0.01\" izz=\"0.005\""),
      {"shoulder"}));
  ASSERT_TRUE(plant.ok()) << plant.status();
  EXPECT_THAT(ModelTableText((*plant)->facts(), ""),
              HasSubstr("upper: inertia principal moments 0.005 0.01 0.03 -> 0.01 0.015 0.025 kg "
                        "m^2 (repaired)"));
  // Turned, and with the sum kept to the rounding of the margin.
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.8, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  const Eigen::Vector3d moments(0.005, 0.01, 0.03), nearest(0.01, 0.015, 0.025);
  const auto repair = RepairInertia(turn * moments.asDiagonal() * turn.transpose(), 1);
  ASSERT_TRUE(repair.ok()) << repair.status();
  EXPECT_TRUE(repair->changed);
  EXPECT_LT((repair->inertia - turn * nearest.asDiagonal() * turn.transpose()).norm(), 1e-9);
  // A flat plate's moments add up exactly: it stays.
  const Eigen::Matrix3d plate = Eigen::Vector3d(0.01, 0.02, 0.03).asDiagonal();
  const auto kept = RepairInertia(plate, 1);
  ASSERT_TRUE(kept.ok()) << kept.status();
  EXPECT_FALSE(kept->changed);
  EXPECT_LT((kept->inertia - plate).norm(), 1e-10);
}

}  // namespace
}  // namespace robostress::calibration
