#include <gmock/gmock.h>

#include "tests/calibration/generator/spatial_arm.h"
#include "tests/calibration/model/model_text.h"

namespace robostress::calibration {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class MjcfReductionTest : public ModelText {};

constexpr char kNewer[] = R"(<mujoco model="arm">
  <compiler angle="degree" autolimits="true" meshdir="assets"/>
  <option integrator="implicitfast" gravity="0 0 -9.8"/>
  <default><joint armature="0.1"/>
    <default class="elbow"><joint damping="2" frictionloss="0.3" actuatorfrcrange="-9 9"/>
      <position kp="10" kv="2"/></default></default>
  <asset><mesh file="upper.obj"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base"><geom type="mesh" mesh="upper"/>
      <body name="upper" euler="0 90 0" gravcomp="1">
        <inertial pos="0 0 -0.2" mass="2" diaginertia="0.03 0.03 0.002"/>
        <joint name="shoulder" axis="0 1 0" range="-90 90"/>
        <geom type="mesh" mesh="upper"/>
        <body name="lower" pos="0 0 -0.4">
          <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.001"/>
          <joint name="elbow" class="elbow" axis="0 1 0"/>
          <site name="attachment_site" pos="0 0 -0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position class="elbow" joint="elbow" inheritrange="1"/></actuator>
  <keyframe><key qpos="0 0"/></keyframe>
</mujoco>
)";

TEST_F(MjcfReductionTest, AModelForANewerMujocoIsReadWithoutItsMeshes) {
  const auto plant = Plant::Load(RigOf(kNewer, {"shoulder", "elbow"}));
  ASSERT_TRUE(plant.ok()) << plant.status();
  EXPECT_EQ((*plant)->passive(0).armature, 0.1);
  EXPECT_EQ((*plant)->passive(1).damping, 2);
  EXPECT_EQ((*plant)->passive(1).frictionloss, 0.3);
  EXPECT_NEAR((*plant)->travel(0), M_PI, 1e-12) << "in degrees";
  const std::string text = ModelTableText((*plant)->facts(), "");
  EXPECT_THAT(text, AllOf(HasSubstr("MJCF, 3 bodies, 2 joints"), HasSubstr("gravity 0 0 -9.8"),
                          HasSubstr("elements actuator, asset, geom (left out)"),
                          HasSubstr("gravcomp of 1 bodies (left out)"),
                          HasSubstr("shapes all (left out)"), HasSubstr("upper.obj")));
  EXPECT_TRUE(Load(With("upper.obj\"", "0\" name=\"upper\"", kNewer), {"elbow"}).ok())
      << "MuJoCo throws where a mesh file's name has no ending";
  const auto loaded = Load(kNewer, {"elbow"});
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_THAT(ModelTableText(loaded->facts, ""), HasSubstr("joints held at 0 shoulder (assumed)"));
}

TEST_F(MjcfReductionTest, IsLeftAloneWhereMujocoReadsIt) {
  const generator::SpatialArm arm = generator::Ur5e();
  const auto loaded = Load(generator::MjcfOf(arm, false), {"elbow_joint"});
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_THAT(ModelTableText(loaded->facts, ""), Not(HasSubstr("left out")));
}

// A newer file in two parts, whose shapes need no file, in millimetres of a mesh that is there.
TEST_F(MjcfReductionTest, ShapesAreKeptWhereTheirFilesAre) {
  const std::string mesh = "<mesh file=\"upper.obj\"";
  ASSERT_TRUE(MakeDirectories(folder + "/assets").ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/assets/upper.obj",
                                  "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 -400\n"
                                  "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
                  .ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/hand.xml",
                                  "<mujocoinclude><body name=\"hand\" pos=\"0 0 -0.3\">"
                                  "<joint name=\"wrist\" range=\"-10 10\"/>"
                                  "<geom type=\"box\" size=\"0.1 0.1 0.1\" mass=\"0.5\"/></body>"
                                  "</mujocoinclude>")
                  .ok());
  const std::string text = With(
      "<site", "<include file=\"hand.xml\"/><site",
      With(mesh, mesh + " scale=\"0.001 0.001 0.001\"", With(" autolimits=\"true\"", "", kNewer)));
  const auto loaded = Load(With("qpos=\"0 0\"", "name=\"home\" qpos=\"0 0 0.1\"", text), {"wrist"});
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  const mjModel& model = *loaded->model;
  EXPECT_EQ(model.ngeom, 4) << "plane, two of the mesh, the box of the hand";
  EXPECT_EQ(model.body_mass[mj_name2id(&model, mjOBJ_BODY, "hand")], 0.5);
  EXPECT_TRUE(model.jnt_limited[mj_name2id(&model, mjOBJ_JOINT, "wrist")])
      << "newer files mean their ranges";
  EXPECT_NEAR(model.geom_rbound[1], 0.3, 0.15) << "the mesh, in metres";
  EXPECT_EQ(model.nkey, 1);
}

// The same file, once as MuJoCo reads it and once with a word that makes it a newer one.
TEST_F(MjcfReductionTest, WhatPlacesOrWeighsIsKept) {
  const std::string text =
      R"(<mujoco><compiler angle="radian" autolimits="true" exactmeshinertia="true"/>
    <option/><default><default class="far"><site pos="0 0 0.3"/></default><default class="tip"><site pos="0.1 0.2 0" euler="0 0 1"/></default></default>
    <asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.15  0.05 0.02 0.02"
      face="0 2 1  0 1 4  1 3 4  3 0 4  1 2 3  2 0 3"/></asset>
    <worldbody><body name="a"><joint name="j" stiffness="3" springdamper="0.2 0.8"/>
      <geom type="mesh" mesh="wedge"/><site name="plain" class="far"/><site name="tip" class="tip"/>
      <body name="b"><joint name="k"/><geom type="mesh" mesh="wedge" mass="1" shellinertia="true"/>
        <site name="along" type="capsule" size="0.01" fromto="0.1 0 0 0.2 0.1 0"/></body>
    </body></worldbody></mujoco>)";
  const auto plain = Load(text, {"j", "k"});
  const auto newer =
      Load(With("<option/>", "<option integrator=\"implicitfast\"/>", text), {"j", "k"});
  ASSERT_TRUE(plain.ok() && newer.ok()) << plain.status() << newer.status();
  const mjModel &a = *plain->model, &b = *newer->model;
  ASSERT_EQ(a.nsite, b.nsite);
  for (int i = 0; i < 3 * a.nsite; ++i) EXPECT_EQ(a.site_pos[i], b.site_pos[i]) << i;
  for (int i = 0; i < 4 * a.nsite; ++i) EXPECT_EQ(a.site_quat[i], b.site_quat[i]) << i;
  for (int i = 0; i < a.nbody; ++i) EXPECT_EQ(a.body_mass[i], b.body_mass[i]) << i;
  for (int i = 0; i < 3 * a.nbody; ++i) EXPECT_EQ(a.body_inertia[i], b.body_inertia[i]) << i;
  for (int i = 0; i < a.nv; ++i) EXPECT_EQ(a.dof_damping[i], b.dof_damping[i]) << i;
  EXPECT_GT(a.dof_damping[0], 0);
}

TEST_F(MjcfReductionTest, AMissingMeshIsNamedWhereItsMassIsNeeded) {
  const std::string inertial =
      "<inertial pos=\"0 0 -0.2\" mass=\"2\" diaginertia=\"0.03 0.03 0.002\"/>";
  EXPECT_THAT(Refusal(With(inertial, "", kNewer), {"elbow"}),
              AllOf(HasSubstr("nor without its actuators: "), HasSubstr("upper.obj"),
                    HasSubstr("nor without its shapes: ")));
}

TEST_F(MjcfReductionTest, MassesThatComeFromShapesAreRefused) {
  const std::string inertial =
      "<inertial pos=\"0 0 -0.2\" mass=\"2\" diaginertia=\"0.03 0.03 0.002\"/>";
  EXPECT_THAT(Refusal(With(inertial, "", kNewer), {"elbow"}),
              AllOf(HasSubstr("unrecognized attribute"), HasSubstr("arm.model:11"),
                    HasSubstr("body 'upper' has shapes and no <inertial>")));
  EXPECT_THAT(Refusal(With("angle=\"degree\"", "angle=\"degree\" inertiafromgeom=\"true\"", kNewer),
                      {"elbow"}),
              HasSubstr("masses come from shapes"));
  EXPECT_THAT(
      Refusal(With("<worldbody>", "<worldbody><include file=\"table.xml\"/>", kNewer), {"elbow"}),
      HasSubstr("table.xml"));
  EXPECT_THAT(Refusal(With("0.01 0.01 0.001", "0.01 much", kNewer), {"elbow"}),
              HasSubstr("Element 'inertial', line 16"))
      << "what MuJoCo names is the file's";
  EXPECT_THAT(Refusal(With("<worldbody>", "<worldbody><frame/>", kNewer), {"elbow"}),
              HasSubstr("<frame> places bodies"));
}

}  // namespace
}  // namespace robostress::calibration
