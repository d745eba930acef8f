#include "calibration/model/urdf_output.h"

#include <gmock/gmock.h>

#include <cmath>
#include <random>
#include <set>

#include "common/models/hull.h"
#include "common/models/urdf_model.h"
#include "common/models/urdf_shapes.h"
#include "tests/calibration/model/model_text.h"

namespace robostress::calibration {
namespace {

using Eigen::Vector3d;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// Everything that MJCF says in another way than URDF.
constexpr char kArm[] = R"(<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyx" autolimits="true"/>
  <asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.15"/></asset>
  <default><geom density="700"/></default>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <geom type="box" size="0.1 0.2 0.05" pos="0.3 0 0.05" euler="20 0 0"/>
    <body name="base" pos="0.1 -0.2 0.3" euler="30 40 -70">
      <geom type="cylinder" size="0.06 0.05"/>
      <body name="turret" pos="0 0.02 0.1" quat="0.9 0.1 -0.3 0.2">
        <joint name="pan" axis="0.1 0.2 1" pos="0.01 0.02 0.03" ref="25" range="-170 150" damping="0.4" frictionloss="0.2"/>
        <joint name="lift" type="slide" axis="1 0 0.2" pos="0.2 0 0" ref="0.05" range="-0.1 0.3"/>
        <joint name="tilt" axis="0 1 0" pos="-0.02 0 0.05"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.05 0.3" size="0.04"/>
        <geom type="sphere" size="0.2" contype="0" conaffinity="0" mass="0"/>
        <site name="mark" pos="0.1 0 0.1" euler="0 90 10"/>
        <body name="upper" pos="0.1 0.05 0.3" euler="0 90 0">
          <inertial pos="0.02 0.01 0.1" mass="2.5" fullinertia="0.03 0.04 0.02 0.001 -0.002 0.003"/>
          <joint name="elbow" axis="1 0 0" range="-120 120"/>
          <geom type="mesh" mesh="wedge" pos="0.01 0.02 0.03" euler="10 20 30"/>
          <geom type="ellipsoid" size="0.05 0.12 0.03" pos="0 0 0.2"/>
          <body name="egg" pos="0 0 0.4"><geom type="ellipsoid" size="0.04 0.03 0.06" contype="0" conaffinity="0"/>
            <joint type="ball" name="loosely"/></body>
          <body name="left" pos="0 0.05 0.3"><geom type="box" size="0.01 0.02 0.04"/>
            <joint name="left_finger" type="slide" axis="0 1 0" range="0 0.04" ref="0.01"/></body>
          <body name="right" pos="0 -0.05 0.3"><geom type="box" size="0.01 0.02 0.04"/>
            <joint name="right_finger" type="slide" axis="0 -1 0" range="0 0.04" ref="0.02"/>
            <site name="tilt"/></body>
        </body>
      </body>
    </body>
    <body name="cup" pos="1 0 0"><freejoint/><geom type="sphere" size="0.05"/>
      <body name="lid"><joint name="lid"/><geom type="sphere" size="0.02"/></body></body>
    <body name="goal" mocap="true"><geom type="sphere" size="0.05"/></body>
  </worldbody>
  <actuator>
    <motor joint="pan" gear="2" forcelimited="true" forcerange="-10 12"/>
    <motor joint="elbow" gear="3"/>
  </actuator>
  <equality><joint joint1="left_finger" joint2="right_finger" polycoef="0.001 0.5 0 0 0"/></equality>
</mujoco>
)";
const std::vector<std::string> kJoints = {"pan",   "lift",        "tilt",
                                          "elbow", "left_finger", "right_finger"};

class UrdfOutputTest : public ModelText {
 protected:
  void Compile(const std::string& mjcf) {
    auto compiled = CompileModel("arm.xml", mjcf);
    ASSERT_TRUE(compiled.ok()) << compiled.status();
    mjcf_ = std::move(*compiled);
    auto written = UrdfOf(*mjcf_, "arm_meshes");
    ASSERT_TRUE(written.ok()) << written.status();
    out_ = std::move(*written);
    ASSERT_TRUE(MakeDirectories(folder + "/arm_meshes").ok());
    for (const auto& [path, bytes] : out_.meshes)
      ASSERT_TRUE(WriteFileAtomically(folder + "/" + path, bytes).ok());
    auto file = XmlFile::Parse(folder + "/arm.urdf", out_.xml);
    ASSERT_TRUE(file.ok()) << file.status();
    file_ = std::make_unique<XmlFile>(std::move(*file));
    auto read = ReadUrdf(*file_, out_.joints);
    ASSERT_TRUE(read.ok()) << read.status() << out_.xml;
    read_ = std::move(*read);
    auto again = CompileModel("arm.urdf", read_.xml);
    ASSERT_TRUE(again.ok()) << again.status();
    urdf_ = std::move(*again);
  }

  // Both at the same joint positions and velocities, drawn within 2 rad and 0.3 m.
  void Move(std::mt19937& stream, mjData* mjcf, mjData* urdf) const {
    mj_resetData(mjcf_.get(), mjcf);
    for (const std::string& name : out_.joints) {
      const int a = mj_name2id(mjcf_.get(), mjOBJ_JOINT, name.c_str());
      const int b = mj_name2id(urdf_.get(), mjOBJ_JOINT, name.c_str());
      const double most = mjcf_->jnt_type[a] == mjJNT_SLIDE ? 0.3 : 2;
      std::uniform_real_distribution<double> uniform(-most, most);
      mjcf->qpos[mjcf_->jnt_qposadr[a]] = urdf->qpos[urdf_->jnt_qposadr[b]] = uniform(stream);
      mjcf->qvel[mjcf_->jnt_dofadr[a]] = urdf->qvel[urdf_->jnt_dofadr[b]] = uniform(stream);
    }
    mj_forward(mjcf_.get(), mjcf);
    mj_forward(urdf_.get(), urdf);
  }
  std::vector<double> MassMatrix(const mjModel& model, const mjData& data) const {
    std::vector<double> full(static_cast<size_t>(model.nv * model.nv)), mine;
    mj_fullM(&model, full.data(), data.qM);
    for (const std::string& row : out_.joints)
      for (const std::string& column : out_.joints)
        mine.push_back(full[static_cast<size_t>(Dof(model, row) * model.nv + Dof(model, column))]);
    return mine;
  }
  static int Dof(const mjModel& model, const std::string& joint) {
    return model.jnt_dofadr[mj_name2id(&model, mjOBJ_JOINT, joint.c_str())];
  }
  const urdf::Joint& JointOf(const std::string& name) const {
    return *std::find_if(read_.joints.begin(), read_.joints.end(),
                         [&](const urdf::Joint& joint) { return joint.name == name; });
  }

  CompiledModel mjcf_, urdf_;
  UrdfOutput out_;
  std::unique_ptr<XmlFile> file_;
  UrdfModel read_;
};

struct DataDeleter {
  void operator()(mjData* data) const { mj_deleteData(data); }
};
using Data = std::unique_ptr<mjData, DataDeleter>;

TEST_F(UrdfOutputTest, MovesAndWeighsAsMujocoHasIt) {
  Compile(kArm);
  EXPECT_EQ(out_.joints, kJoints);
  const Data a(mj_makeData(mjcf_.get())), b(mj_makeData(urdf_.get()));
  std::mt19937 stream(7);
  for (int state = 0; state < 50; ++state) {
    Move(stream, a.get(), b.get());
    for (const std::string& name : out_.bodies) {
      const int mine = mj_name2id(mjcf_.get(), mjOBJ_BODY, name.c_str());
      const int its = mj_name2id(urdf_.get(), mjOBJ_BODY, name.c_str());
      ASSERT_GE(its, 0) << name;
      for (int i = 0; i < 3; ++i)
        EXPECT_NEAR(a->xipos[3 * mine + i], b->xipos[3 * its + i], 1e-12) << name;
    }
    for (const auto& [site, link] : {std::pair("mark", "mark"), std::pair("tilt", "tilt")}) {
      const int mine = mj_name2id(mjcf_.get(), mjOBJ_SITE, site);
      const int its = mj_name2id(urdf_.get(), mjOBJ_BODY, link);
      for (int i = 0; i < 3; ++i)
        EXPECT_NEAR(a->site_xpos[3 * mine + i], b->xpos[3 * its + i], 1e-12);
      for (int i = 0; i < 9; ++i)
        EXPECT_NEAR(a->site_xmat[9 * mine + i], b->xmat[9 * its + i], 1e-12);
    }
    for (const std::string& joint : kJoints)
      EXPECT_NEAR(a->qfrc_bias[Dof(*mjcf_, joint)], b->qfrc_bias[Dof(*urdf_, joint)], 3e-8)
          << joint << "; links between joints weigh 1e-9 kg for MuJoCo";
    const auto mass = MassMatrix(*mjcf_, *a), its_mass = MassMatrix(*urdf_, *b);
    for (size_t i = 0; i < mass.size(); ++i) EXPECT_NEAR(mass[i], its_mass[i], 3e-9);
  }
}

TEST_F(UrdfOutputTest, SaysWhatJointsCanAndWhatItLeavesOut) {
  Compile(kArm);
  EXPECT_EQ(JointOf("pan").type, "revolute");
  EXPECT_NEAR(JointOf("pan").lower, -170 * M_PI / 180, 1e-12);
  EXPECT_NEAR(JointOf("pan").upper, 150 * M_PI / 180, 1e-12);
  EXPECT_EQ(JointOf("pan").effort, 24) << "of the motor, times its gear";
  EXPECT_EQ(JointOf("pan").damping, 0.4);
  EXPECT_EQ(JointOf("pan").friction, 0.2);
  EXPECT_EQ(JointOf("tilt").type, "continuous");
  EXPECT_EQ(JointOf("elbow").effort, 0) << "nobody says it";
  EXPECT_EQ(JointOf("lift").type, "prismatic");
  // left - 0.01 = 0.001 + 0.5 (right - 0.02)
  const tinyxml2::XMLElement* mimic = JointOf("left_finger").element->FirstChildElement("mimic");
  ASSERT_NE(mimic, nullptr);
  EXPECT_EQ(AttributeOf(*mimic, "joint"), "right_finger");
  EXPECT_EQ(mimic->DoubleAttribute("multiplier"), 0.5);
  EXPECT_NEAR(mimic->DoubleAttribute("offset"), 0.001, 1e-12);
  EXPECT_THAT(out_.sites, testing::ElementsAre("mark", "tilt"));
  EXPECT_THAT(
      ModelTableText(out_.facts, ""),
      AllOf(HasSubstr("planes and height fields 1 (left out)"),
            HasSubstr("bodies that stand on nothing cup, goal (left out)"),
            HasSubstr("joints held at 0 loosely"),
            HasSubstr("shapes that touch nothing 1 (left out)"),
            HasSubstr("effort 1e+06 of lift, tilt, elbow, left_finger, right_finger (assumed)"),
            HasSubstr("capsules 3"), Not(HasSubstr("tendons")), Not(HasSubstr("stiffness"))));
  EXPECT_THAT(out_.xml, AllOf(Not(HasSubstr("cup")), Not(HasSubstr("lid"))));
}

TEST_F(UrdfOutputTest, TellsWhatIsNoTree) {
  Compile(R"(<mujoco><worldbody>
    <body name="a"><joint name="j" stiffness="50"/><geom size="0.1"/><site name="s"/>
      <body name="b" pos="0.3 0 0"><joint name="k"/><geom size="0.1"/><site name="t"/></body></body>
    <body name="c" pos="0.6 0 0"><joint name="l"/><geom size="0.1"/></body></worldbody>
    <tendon><spatial name="rope" stiffness="20"><site site="s"/><site site="t"/></spatial></tendon>
    <equality><connect body1="b" body2="c" anchor="0.3 0 0"/></equality></mujoco>)");
  EXPECT_THAT(ModelTableText(out_.facts, ""),
              AllOf(HasSubstr("stiffness of j (left out)"), HasSubstr("tendons 1 (left out)"),
                    HasSubstr("equality 1 of connect, weld or tendon (left out)")));
}

// Nameless parts get names that no other part has, and a name of the file stays its own.
TEST_F(UrdfOutputTest, GivesEveryPartANameOfItsOwn) {
  Compile(R"(<mujoco><worldbody>
    <body name="joint_1x"><joint name="joint_1"/><geom size="0.1"/>
      <body pos="0.3 0 0"><joint/><geom size="0.1"/><site name="body_2"/><site name="body_2_link" pos="0.1 0 0"/>
        <body name="body_2" pos="0.3 0 0"><joint name="joint_3"/><geom size="0.1"/><site/></body></body></body>
    </worldbody></mujoco>)");
  std::set<std::string> joints(out_.joints.begin(), out_.joints.end());
  EXPECT_EQ(joints.size(), 3u) << out_.xml;
  std::set<std::string> links, all_joints;
  for (const auto* e = file_->root().FirstChildElement(); e != nullptr;
       e = e->NextSiblingElement()) {
    const std::string name = AttributeOf(*e, "name"), kind = e->Name();
    EXPECT_TRUE(kind != "link" || links.insert(name).second) << name;
    EXPECT_TRUE(kind != "joint" || all_joints.insert(name).second) << name;
  }
  EXPECT_EQ(links.count("body_2"), 1u);
  EXPECT_THAT(out_.sites, testing::Contains("body_2_link")) << "the file's own";
  const int mark = mj_name2id(urdf_.get(), mjOBJ_BODY, "body_2_link");
  ASSERT_GE(mark, 0);
  EXPECT_NEAR(urdf_->body_pos[3 * mark], 0.1, 1e-12);
}

// What was written is read by MuJoCo itself, with its meshes beside it: of bodies of one joint
// each, and without capsules, which it does not know.
TEST_F(UrdfOutputTest, MujocoReadsItWithItsMeshes) {
  Compile(R"(<mujoco><asset><mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.15"/></asset>
    <worldbody><body name="a"><joint name="j"/><geom type="mesh" mesh="wedge"/>
      <body name="b" pos="0 0 0.3"><joint name="k" type="slide"/><geom type="box" size="0.1 0.2 0.1"/></body></body>
    </worldbody></mujoco>)");
  const std::string path = folder + "/arm.urdf";
  ASSERT_TRUE(WriteFileAtomically(path, out_.xml).ok());
  char why[500] = "";
  const CompiledModel model(mj_loadXML(path.c_str(), nullptr, why, sizeof why));
  ASSERT_NE(model, nullptr) << why;
  EXPECT_EQ(model->nmesh, 1);
}

// Points on the surface of a shape, in its frame, that the hulls must hold, and which way is out.
std::vector<std::pair<Vector3d, Vector3d>> Surface(const mjModel& model, int geom,
                                                   std::mt19937& stream) {
  const double* size = model.geom_size + 3 * geom;
  std::vector<std::pair<Vector3d, Vector3d>> points;
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1, 1);
  if (model.geom_type[geom] == mjGEOM_MESH) {
    const int mesh = model.geom_dataid[geom];
    for (int k = 0; k < model.mesh_vertnum[mesh]; ++k) {
      const float* v = model.mesh_vert + 3 * (model.mesh_vertadr[mesh] + k);
      const Vector3d corner(v[0], v[1], v[2]);
      points.emplace_back(corner, corner.normalized());
    }
    return points;
  }
  for (int k = 0; k < 40; ++k) {
    const Vector3d way = Vector3d(normal(stream), normal(stream), normal(stream)).normalized();
    const Vector3d flat = Vector3d(way.x(), way.y(), 0).normalized();
    switch (model.geom_type[geom]) {
      case mjGEOM_SPHERE:
        points.emplace_back(size[0] * way, way);
        break;
      case mjGEOM_CAPSULE:
        points.emplace_back(size[0] * way + Vector3d(0, 0, std::copysign(size[1], way.z())), way);
        break;
      case mjGEOM_CYLINDER:
        points.emplace_back(size[0] * flat + Vector3d(0, 0, size[1] * uniform(stream)), flat);
        break;
      case mjGEOM_BOX:
        points.emplace_back(Vector3d(size[0], size[1] * uniform(stream), size[2] * uniform(stream)),
                            Vector3d::UnitX());
        break;
      case mjGEOM_ELLIPSOID:
        points.emplace_back(Eigen::Map<const Vector3d>(size).cwiseProduct(way), Vector3d::Zero());
        break;
      default:
        break;
    }
  }
  return points;
}

TEST_F(UrdfOutputTest, ShapesHoldWhatMujocoTouches) {
  Compile(kArm);
  const auto shapes = ReadUrdfShapes(*file_, read_, {});
  ASSERT_TRUE(shapes.ok()) << shapes.status();
  EXPECT_EQ(shapes->meshes, 1);
  EXPECT_THAT(shapes->missing, testing::IsEmpty());
  const Data a(mj_makeData(mjcf_.get())), b(mj_makeData(urdf_.get()));
  std::mt19937 stream(8);
  Move(stream, a.get(), b.get());
  std::set<int> kinds;
  for (int geom = 0; geom < mjcf_->ngeom; ++geom) {
    const std::string body = mj_id2name(mjcf_.get(), mjOBJ_BODY, mjcf_->geom_bodyid[geom]);
    const bool unseen = body == "turret" && mjcf_->geom_type[geom] == mjGEOM_SPHERE;
    if (mjcf_->geom_type[geom] == mjGEOM_PLANE || body == "cup" || body == "lid" ||
        body == "goal" || unseen)
      continue;
    kinds.insert(mjcf_->geom_type[geom]);
    size_t link = 0;
    while (read_.links[link].name != body) ++link;
    const int its = mj_name2id(urdf_.get(), mjOBJ_BODY, body.c_str());
    using Rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const auto distance = [&](const Vector3d& point) {
      const Vector3d world = Eigen::Map<const Vector3d>(a->geom_xpos + 3 * geom) +
                             Eigen::Map<const Rows>(a->geom_xmat + 9 * geom) * point;
      const Vector3d local = Eigen::Map<const Rows>(b->xmat + 9 * its).transpose() *
                             (world - Eigen::Map<const Vector3d>(b->xpos + 3 * its));
      double least = 1;
      for (const Hull& part : shapes->links[link].parts)
        least = std::min(least, Distance(part, {{local}, 0}, Eigen::Isometry3d::Identity()));
      return least;
    };
    for (const auto& [point, out] : Surface(*mjcf_, geom, stream)) {
      EXPECT_LE(distance(point), 2e-6) << body;
      if (!out.isZero()) {
        EXPECT_GT(distance(point + 0.01 * out), 0.002) << body;
      }
    }
  }
  EXPECT_EQ(kinds.size(), 5U) << "box, cylinder, capsule, mesh, ellipsoid";
}

TEST_F(UrdfOutputTest, RefusesWhatNoJointMoves) {
  const auto refusal = [](const std::string& mjcf) {
    const auto compiled = CompileModel("arm.xml", mjcf);
    return std::string(UrdfOf(**compiled, "meshes").status().message());
  };
  EXPECT_EQ(refusal("<mujoco><worldbody><geom size=\"1\"/></worldbody></mujoco>"),
            "no joint turns or slides");
  EXPECT_THAT(refusal("<mujoco><worldbody><body name=\"cart\"><freejoint/><geom size=\"1\"/>"
                      "<body><joint/><geom size=\"1\"/></body></body></worldbody></mujoco>"),
              HasSubstr("bodies with a free joint (cart); take the free joint of the arm out"));
  for (const char* number : {"nan", "1e7"})
    EXPECT_THAT(
        refusal(absl::StrCat("<mujoco><worldbody><body name=\"arm\" pos=\"0 ", number,
                             " 0\"><joint/><geom size=\"1\"/></body></worldbody></mujoco>")),
        HasSubstr("body 'arm': a number of its place is"));
}

}  // namespace
}  // namespace robostress::calibration
