#include "robot_client/piper/piper_model.h"

#include <gtest/gtest.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "robot_client/arm_path.h"
#include "robot_client/emulator/piper_mjcf.h"
#include "robot_client/emulator/piper_plant.h"
#include "robot_client/piper/kinematics.h"

namespace robostress::piper {
namespace {

ArmVector Random(std::mt19937& random, double scale = 1) {
  ArmVector v{};
  for (int j = 0; j < kJoints; ++j) {
    const double middle = 0.5 * (kJointRanges[j].lower + kJointRanges[j].upper);
    const double half = 0.5 * scale * (kJointRanges[j].upper - kJointRanges[j].lower);
    v[j] = std::uniform_real_distribution<double>(middle - half, middle + half)(random);
  }
  v[kJoints] = std::uniform_real_distribution<double>(0, 0.07)(random);
  return v;
}

// MuJoCo's inverse dynamics of our MJCF, without contacts, limits and the fingers' coupling.
TEST(PiperModel, GivesTheTorquesOfMuJoCosInverseDynamics) {
  for (const double payload : {0.0, 0.5}) {
    PiperScene scene;
    scene.payload_kg = payload;
    auto plant = *PiperPlant::Create(ComposePiperScene(scene), {});
    mjModel* model = const_cast<mjModel*>(&plant->model());
    model->opt.disableflags |= mjDSBL_CONSTRAINT;
    mjData* data = &plant->data();
    const PiperModel ours(Zero::kSince_1_6_3, {});
    std::mt19937 random(11);
    std::normal_distribution<double> rate(0, 2);
    double worst = 0, largest = 0;
    for (int i = 0; i < 500; ++i) {
      const ArmVector q = Random(random);
      ArmVector dq{}, ddq{};
      mj_resetData(model, data);
      for (int j = 0; j < kJoints; ++j) {
        dq[j] = rate(random);
        ddq[j] = rate(random);
        const int joint =
            mj_name2id(model, mjOBJ_JOINT, ("piper_joint" + std::to_string(j + 1)).c_str());
        data->qpos[model->jnt_qposadr[joint]] = q[j];
        data->qvel[model->jnt_dofadr[joint]] = dq[j];
        data->qacc[model->jnt_dofadr[joint]] = ddq[j];
      }
      for (const char* finger : {"piper_finger1", "piper_finger2"})
        data->qpos[model->jnt_qposadr[mj_name2id(model, mjOBJ_JOINT, finger)]] = 0.5 * q[kJoints];
      mj_inverse(model, data);
      const ArmVector torque = ours.Torque(q, dq, ddq, payload);
      for (int j = 0; j < kJoints; ++j) {
        const int joint =
            mj_name2id(model, mjOBJ_JOINT, ("piper_joint" + std::to_string(j + 1)).c_str());
        const double expected = data->qfrc_inverse[model->jnt_dofadr[joint]];
        worst = std::max(worst, std::abs(torque[j] - expected));
        largest = std::max(largest, std::abs(expected));
      }
    }
    // The payload is a point here and a ball of 3 cm there: 2/5 m r^2 = 2e-4 kg m^2.
    EXPECT_LT(worst, payload > 0 ? 0.01 : 1e-6);
    EXPECT_GT(largest, 10);
  }
}

TEST(PiperModel, DistancesAreThoseOfThePartsItCovers) {
  WorkspaceOptions workspace;
  const PiperModel model(Zero::kSince_1_6_3, workspace);
  auto plant = *PiperPlant::Create(ComposePiperScene({}), {});
  std::mt19937 random(3);
  const mjModel& m = plant->model();
  for (int i = 0; i < 300; ++i) {
    const ArmVector q = Random(random);
    JointVector joints;
    std::copy_n(q.begin(), kJoints, joints.begin());
    plant->Reset(joints, q[kJoints]);
    // The lowest point of the gripper's and the pads' boxes, corner by corner.
    double lowest = 10;
    for (int g = 0; g < m.ngeom; ++g) {
      if (m.geom_type[g] != mjGEOM_BOX) continue;
      for (int corner = 0; corner < 8; ++corner) {
        double z = plant->data().geom_xpos[3 * g + 2];
        for (int k = 0; k < 3; ++k)
          z += plant->data().geom_xmat[9 * g + 6 + k] * m.geom_size[3 * g + k] *
               ((corner >> k & 1) != 0 ? 1 : -1);
        lowest = std::min(lowest, z);
      }
    }
    EXPECT_LT(model.ClearanceAt(q)[ArmModel::kTable], lowest + 0.008) << "some millimetres";
  }
}

// Outermost points of the vendor's meshes (Piper_ros, piper_description) along the axes of our
// frames [m]. What the capsules leave out goes into the table.
TEST(PiperModel, TheVendorsLinksAreInsideOfTheCapsules) {
  struct Outermost {
    int link;
    Eigen::Vector3d point;
  };
  const Outermost kOutermost[] = {
      {2, {0.316, -0.002, 0.042}},   {2, {0.284, 0.032, 0.042}},   {2, {-0.022, -0.012, 0.049}},
      {2, {-0.031, 0.001, -0.042}},  {2, {0.230, -0.065, -0.001}}, {2, {0.307, 0.012, -0.049}},
      {3, {0.030, -0.001, 0.033}},   {3, {0, 0.030, 0.026}},       {3, {-0.013, -0.019, 0.041}},
      {3, {-0.050, -0.159, -0.002}}, {3, {-0.038, -0.215, 0.008}}, {3, {0.005, -0.041, -0.040}},
      {4, {0.030, 0.030, 0}},        {4, {-0.002, 0.034, -0.018}}, {4, {0.001, 0.023, 0.029}},
      {4, {-0.033, -0.004, -0.023}}, {4, {0, -0.029, -0.024}},     {4, {-0.020, -0.020, -0.036}},
      {5, {0.030, -0.001, -0.027}},  {5, {0, 0.023, -0.029}},      {5, {0, -0.030, 0.030}},
      {5, {-0.030, 0, -0.027}},      {5, {0.014, -0.091, 0.012}},  {5, {0.012, -0.014, -0.031}},
      {6, {0.030, 0.001, 0.048}},    {6, {-0.004, 0.074, 0.062}},  {6, {0.009, 0.073, 0.067}},
      {6, {-0.041, -0.004, 0.054}},  {6, {0.003, -0.071, 0.067}},  {6, {-0.017, -0.022, 0}}};
  const PiperModel model(Zero::kSince_1_6_3, {});
  std::mt19937 random(9);
  for (int i = 0; i < 100000; ++i) {
    const ArmVector q = Random(random);
    JointVector joints;
    std::copy_n(q.begin(), kJoints, joints.begin());
    const auto poses = LinkPoses(joints, Zero::kSince_1_6_3);
    const double table = model.ClearanceAt(q)[ArmModel::kTable];
    for (const auto& [link, point] : kOutermost)
      ASSERT_LE(table, (poses[link - 1] * point).z() + 1e-3) << "link " << link;
  }
}

TEST(PiperModel, KnowsTableBoxAndItself) {
  const PiperModel model(Zero::kSince_1_6_3, {});
  const ArmVector rest{}, raised{0, 1.2, -1.0, 0, 0.5, 0, 0.05}, into_table{0, 2.2, -1, 0, 1, 0, 0};
  EXPECT_GT(model.ClearanceAt(raised)[ArmModel::kTable], 0.05);
  for (int face = 0; face < 6; ++face)
    EXPECT_GT(model.ClearanceAt(raised)[ArmModel::kBox + face], 0.1);
  EXPECT_GT(model.ClearanceAt(raised)[ArmModel::kItself], 0.05);
  EXPECT_LT(model.ClearanceAt(into_table)[ArmModel::kTable], -0.05);
  EXPECT_GT(model.ClearanceAt(rest)[ArmModel::kItself], -0.02) << "folded on its rest";
  WorkspaceOptions narrow;
  narrow.upper = {0.2, 0.2, 1};
  EXPECT_LT(PiperModel(Zero::kSince_1_6_3, narrow).ClearanceAt(raised)[ArmModel::kBox + 3], 0);
  WorkspaceOptions wide;
  wide.margin = 0.04;
  EXPECT_NEAR(PiperModel(Zero::kSince_1_6_3, wide).ClearanceAt(raised)[ArmModel::kTable],
              model.ClearanceAt(raised)[ArmModel::kTable] - 0.04, 1e-12);
  // J5 as far as it goes with the elbow folded: the gripper against the upper arm.
  double least = 1;
  std::mt19937 random(5);
  for (int i = 0; i < 20000; ++i)
    least = std::min(least, model.ClearanceAt(Random(random))[ArmModel::kItself]);
  EXPECT_LT(least, -0.02) << "some poses within the joints' limits are impossible";
}

// The folded elbow is the arm's rearmost part, and the wrist lifts the gripper.
TEST(PiperModel, AnElbowOutOfOneFaceOpensNoOther) {
  const ArmVector rest{}, lifted{0, 0, 0, 0, -1.0, 0, 0};
  constexpr int kBack = ArmModel::kBox, kTop = ArmModel::kBox + 5;
  WorkspaceOptions workspace;
  const PiperModel wide(Zero::kSince_1_6_3, workspace);
  const ArmModel::Clearance now = wide.ClearanceAt(rest), next = wide.ClearanceAt(lifted);
  ASSERT_NEAR(next[kBack], now[kBack], 1e-9) << "the wrist moves no elbow";
  ASSERT_LT(next[kTop], now[kTop] - 0.02);
  workspace.lower[0] += now[kBack] + 0.05;  // the elbow is 50 mm out of the back
  workspace.upper[2] -= next[kTop] + 0.01;  // a lifted gripper would be 10 mm out of the top
  const PiperModel model(Zero::kSince_1_6_3, workspace);
  EXPECT_EQ(CrossedBound(model.ClearanceAt(rest), model.ClearanceAt(lifted)), kTop);
  EXPECT_EQ(CrossedBound(model.ClearanceAt(lifted), model.ClearanceAt(rest)), ArmModel::kBounds);
  EXPECT_EQ(BrokenBound(model.ClearanceAt(rest)), kBack);
  EXPECT_STREQ(BoundName(static_cast<ArmModel::Bound>(kTop)), "the workspace box");
}

TEST(ArmPath, IsStraightAndNeverFasterThanItsLimits) {
  const ArmVector from{0, 1.2, -1.0, 0, 0.5, 0, 0.05}, to{0.9, 0.6, -0.4, 0.2, 0.1, -0.3, 0};
  const PathLimits limits;
  constexpr double kPeriod = 1.0 / 30;
  const ArmPath path = StraightPath(ArmAxes(), from, to, limits, kPeriod);
  EXPECT_EQ(path.rows.back(), to);
  double fastest = 0, hardest = 0;
  ArmVector before = from, speed{};
  for (const ArmVector& row : path.rows) {
    const double share = (row[0] - from[0]) / (to[0] - from[0]);
    for (int j = 0; j < kJoints; ++j) {
      EXPECT_NEAR(row[j], from[j] + share * (to[j] - from[j]), 1e-12);
      const double v = (row[j] - before[j]) / kPeriod;
      fastest = std::max(fastest, std::abs(v));
      hardest = std::max(hardest, std::abs(v - speed[j]) / kPeriod);
      speed[j] = v;
    }
    before = row;
  }
  EXPECT_LE(fastest, limits.joint_velocity);
  EXPECT_GT(fastest, 0.9 * limits.joint_velocity);
  EXPECT_LE(hardest, limits.joint_acceleration);
}

TEST(ArmPath, ThatLeadsIntoTheTableIsRefusedAndSaysHowDeep) {
  const PiperModel model(Zero::kSince_1_6_3, {});
  const ArmVector raised{0, 1.2, -1.0, 0, 0.5, 0, 0.05}, into_table{0, 2.2, -1, 0, 1, 0, 0};
  ArmLimits limits;
  for (int j = 0; j < kJoints; ++j) {
    limits.lower[j] = kJointRanges[j].lower;
    limits.upper[j] = kJointRanges[j].upper;
  }
  limits.upper[kJoints] = 0.07;
  EXPECT_TRUE(CheckPose("home", raised, limits, &model).ok());
  const absl::Status pose = CheckPose("home", into_table, limits, &model);
  EXPECT_NE(pose.message().find("home lies 8"), absl::string_view::npos) << pose;
  const ArmPath path = StraightPath(ArmAxes(), raised, into_table, {}, 1.0 / 30);
  EXPECT_TRUE(absl::IsFailedPrecondition(CheckPath(model, path)));
  ArmPath out = path;
  std::reverse(out.rows.begin(), out.rows.end());
  EXPECT_TRUE(CheckPath(model, out).ok()) << "out of it is free";
  const ArmPath half = StraightPath(ArmAxes(), into_table, raised, {}, 1.0 / 30);
  ArmPath back_in = half;
  back_in.rows.resize(half.rows.size() / 2);
  for (size_t i = back_in.rows.size(); i-- > back_in.rows.size() / 2;)
    back_in.rows.push_back(half.rows[i]);
  EXPECT_FALSE(CheckPath(model, back_in).ok()) << "half out, and in again";
  ArmVector beyond = raised;
  beyond[4] = 2;
  EXPECT_NE(CheckPose("home", beyond, limits, &model).message().find("J5 is 2.0000"),
            absl::string_view::npos);
}

}  // namespace
}  // namespace robostress::piper
