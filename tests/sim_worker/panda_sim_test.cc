#include "sim_worker/panda_sim.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "adapter/nominal_arm.h"
#include "adapter/panda_dynamics.h"
#include "sim_worker/panda_model.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::vector<double> Positions(const PandaSim& sim) {
  return {sim.data().qpos, sim.data().qpos + sim.model().nq};
}

TEST(PandaSim, HoldsItsPoseInClean) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const RobotState before = sim->Measure();
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  const RobotState after = sim->Measure();
  EXPECT_LT((after.tool.p_base_tool - before.tool.p_base_tool).norm(), 1e-3);
  EXPECT_LT(after.tool.q_base_tool.angularDistance(before.tool.q_base_tool), 2e-3);
  EXPECT_LT(after.dq.norm(), 1e-3);
  EXPECT_NEAR(after.gripper, 0.08, 1e-3);
  EXPECT_DOUBLE_EQ(after.stamp_s, 5.0);
  EXPECT_EQ(sim->steps_taken(), 100);
}

TEST(PandaSim, MeasuresThePoseOfThePositionsThatItReports) {
  auto sim = MakeTestSim();
  UseScenario(*sim, "aged_joint_uniform");
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(sim->Step(Command(1, 0.5, -0.5)).ok());
  const RobotState measured = sim->Measure();
  // Independent kinematics of the reported joint positions.
  mjData* data = mj_makeData(&sim->model());
  for (int i = 0; i < 7; ++i) data->qpos[i] = measured.q[i];
  mj_kinematics(&sim->model(), data);
  const int site = mj_name2id(&sim->model(), mjOBJ_SITE, "gripper0_grip_site");
  for (int i = 0; i < 3; ++i)
    EXPECT_NEAR(data->site_xpos[3 * site + i], measured.tool.p_base_tool[i], 1e-12);
  mj_deleteData(data);
}

TEST(PandaSim, ReportsTheToolInTheBaseFrame) {
  PandaScene scene = TestScene();
  scene.base_position = {-0.66, 0.1, 0.912};
  auto here = MakeTestSim(), there = MakeTestSim({}, scene);
  ASSERT_TRUE(here->Reset(HomeState(*here), PandaHome()).ok());
  ASSERT_TRUE(there->Reset(HomeState(*there), PandaHome()).ok());
  EXPECT_LT((here->Measure().tool.p_base_tool - there->Measure().tool.p_base_tool).norm(), 1e-12);
  // The home posture points down: R close to diag(1, -1, -1).
  const Eigen::Matrix3d R = here->Measure().tool.q_base_tool.toRotationMatrix();
  EXPECT_LT((R - Eigen::Vector3d(1, -1, -1).asDiagonal().toDenseMatrix()).norm(), 0.1);
}

TEST(PandaSim, MovesAlongTheCommandedDirection) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const RobotState before = sim->Measure();
  for (int i = 0; i < 16; ++i) ASSERT_TRUE(sim->Step(Command(0, 1, 0)).ok());
  const Eigen::Vector3d moved = sim->Measure().tool.p_base_tool - before.tool.p_base_tool;
  EXPECT_GT(moved.y(), 0.1);
  EXPECT_LT(std::hypot(moved.x(), moved.z()), 0.02);
}

// Beside the simulator's own masses and kinematics.
TEST(PandaSim, ThePandasDynamicsAreThoseOfItsModel) {
  auto sim = MakeTestSim();
  const mjModel& model = sim->model();
  const absl::StatusOr<PandaModel> panda = PandaModel::Find(model);
  ASSERT_TRUE(panda.ok()) << panda.status();
  const std::unique_ptr<mjData, decltype(&mj_deleteData)> data(mj_makeData(&model), mj_deleteData);
  const auto arm_at = [&](const Eigen::VectorXd& q) {
    for (int i = 0; i < 7; ++i) data->qpos[panda->qpos[i]] = q[i];
    mj_fwdPosition(&model, data.get());
    ArmState arm;
    ReadArm(model, *data, *panda, arm);
    return arm;
  };
  srand(11);
  double coupling = 0, drift = 0;
  for (int k = 0; k < 50; ++k) {
    const Eigen::VectorXd q = PandaHome() + 0.6 * Eigen::VectorXd::Random(7);
    const Eigen::VectorXd dq = Eigen::VectorXd::Random(7);
    const PandaDynamics at = PandaDynamics::At(q, dq);
    const ArmState arm = arm_at(q);
    const Eigen::Matrix<double, 6, 6> A = arm.J * arm.M.inverse() * arm.J.transpose();
    Eigen::Matrix<double, 6, 6> Lambda = Eigen::Matrix<double, 6, 6>::Zero();
    Lambda.topLeftCorner<3, 3>() = A.topLeftCorner<3, 3>().inverse();
    Lambda.bottomRightCorner<3, 3>() = A.bottomRightCorner<3, 3>().inverse();
    const Eigen::Matrix<double, 6, 6> C = A * Lambda;
    coupling = std::max(coupling, (at.coupling - C).norm() / C.norm());
    constexpr double kStep = 1e-6;
    const Eigen::Matrix<double, 6, 1> d =
        (arm_at(q + kStep * dq).J - arm_at(q - kStep * dq).J) * dq / (2 * kStep);
    drift = std::max(drift, (at.drift - d).norm() / d.norm());
  }
  printf("largest relative difference: coupling %g, drift %g\n", coupling, drift);
  EXPECT_LT(coupling, 5e-5);
  EXPECT_LT(drift, 1e-6);
}

// OSC_POSE drives position and orientation apart and compensates no swing: a nominal arm with the
// Panda's dynamics moves as the simulated one does, the one without does not.
TEST(PandaSim, ATurnMovesTheToolAsANominalPandaSays) {
  NominalArmOptions options;
  options.panda_dynamics = true;
  for (int axis = 0; axis < 6; ++axis) {
    for (const float size : {0.3F, -0.5F}) {
      auto sim = MakeTestSim();
      ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
      NominalArm panda(options), apart({});
      Eigen::VectorXf command = Command(0, 0, 0);
      command[axis] = size;
      double wrong = 0, wrong_apart = 0;
      for (int i = 0; i < 6; ++i) {
        const RobotState before = sim->Measure();
        ASSERT_TRUE(sim->Step(command).ok());
        const Eigen::Vector3d moved =
            (sim->Measure().tool.p_base_tool - before.tool.p_base_tool) / 0.05;
        const Eigen::VectorXd asked = command.head<6>().cast<double>();
        wrong += (panda.Step(asked, before).head<3>() - moved).squaredNorm();
        wrong_apart += (apart.Step(asked).head<3>() - moved).squaredNorm();
      }
      printf("axis %d size %g: %g of %g\n", axis, size, wrong, wrong_apart);
      EXPECT_LT(wrong, std::max(5e-5, 0.15 * wrong_apart)) << axis << " " << size;
    }
  }
}

// The share of a command's displacement that the arm makes of it in a step, at steady state: of a
// unit mass behind a critically damped spring that is stretched anew every 0.05 s.
TEST(PandaSim, AStifferControllerComesFartherInAStep) {
  double before = 0;
  for (const double kp : {75.0, 150.0, 600.0}) {
    SimOptions options;
    options.controller_kp = kp;
    auto sim = MakeTestSim(options);
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    double last = 0, moved = 0;
    for (int i = 0; i < 12; ++i) {
      ASSERT_TRUE(sim->Step(Command(0, 0.3, 0)).ok());
      const double y = sim->Measure().tool.p_base_tool.y();
      moved = y - last;
      last = y;
    }
    const double share = moved / (0.05 * 0.3);
    EXPECT_GT(share, 1.3 * before) << kp;
    if (kp == 150) {
      EXPECT_NEAR(share, 0.267, 0.02);
    }
    before = share;
  }
}

TEST(PandaSim, GoalReferenceDecidesTheGain) {
  // Ideal steady gain of the achieved reference: 0.267 (kp 150, damping ratio 1, 50 ms). The
  // desired reference trails by a constant lag, so its gain tends to one.
  for (const auto& [reference, low, high] : {std::tuple{GoalReference::kAchieved, 0.20, 0.28},
                                             std::tuple{GoalReference::kDesired, 0.85, 1.02}}) {
    SimOptions options;
    options.goal_reference = reference;
    auto sim = MakeTestSim(options);
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(0, 0.2, 0)).ok());
    const double y = sim->Measure().tool.p_base_tool.y();
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(0, 0.2, 0)).ok());
    const double gain = (sim->Measure().tool.p_base_tool.y() - y) / (20 * 0.2 * 0.05);
    EXPECT_GT(gain, low);
    EXPECT_LT(gain, high);
  }
}

TEST(PandaSim, KeepsTheOrientationGoalUntilACommandRotates) {
  // Started 0.15 rad off the home posture: the goal of the orientation stays at home, so the hand
  // turns back although no command rotates. With a goal at the achieved orientation it would stay
  // where it is.
  auto sim = MakeTestSim();
  std::vector<double> qpos = HomeState(*sim);
  qpos[6] += 0.15;
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const Eigen::Quaterniond home = sim->Measure().tool.q_base_tool;
  ASSERT_TRUE(sim->Reset(qpos, PandaHome()).ok());
  EXPECT_NEAR(sim->Measure().tool.q_base_tool.angularDistance(home), 0.15, 1e-6);
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(sim->Step(Command(0, 0.3, 0)).ok());
  EXPECT_LT(sim->Measure().tool.q_base_tool.angularDistance(home), 0.01);
}

TEST(PandaSim, ClipsCommandsAndRefusesWhatIsNotOne) {
  auto a = MakeTestSim(), b = MakeTestSim();
  ASSERT_TRUE(a->Reset(HomeState(*a), PandaHome()).ok());
  ASSERT_TRUE(b->Reset(HomeState(*b), PandaHome()).ok());
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(a->Step(Command(1, -1, 0.5, 1)).ok());
    ASSERT_TRUE(b->Step(Command(40, -1.2, 0.5, 0.1)).ok());
  }
  EXPECT_EQ(Positions(*a), Positions(*b));
  EXPECT_EQ(a->Step(Eigen::VectorXf::Zero(6)).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(a->Step(Command(std::nan(""), 0, 0)).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(a->steps_taken(), 5);
}

TEST(PandaSim, MotorsGiveNoMoreThanTheyCanBothWays) {
  for (const double away : {1.0, -1.0}) {
    auto sim = MakeTestSim();
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    double highest = 0, lowest = 0;
    sim->OnJointSample([&](const JointSample&) {
      for (int j = 0; j < 7; ++j) {
        const double share = sim->data().ctrl[j] / (j < 5 ? 80 : 12);
        highest = std::max(highest, share);
        lowest = std::min(lowest, share);
      }
    });
    // Thrown far from its goal, the controller asks for hundreds of Nm.
    for (int j = 0; j < 3; ++j) sim->mutable_data().qpos[j] += away;
    ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
    EXPECT_LE(highest, 1);
    EXPECT_GE(lowest, -1);
    EXPECT_EQ(away > 0 ? lowest : highest, away > 0 ? -1 : 1);
  }
}

TEST(PandaSim, GripperTakesFourControlStepsFromTheMiddleAndHoldsAtZero) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const int motor = mj_name2id(&sim->model(), mjOBJ_ACTUATOR, "gripper0_gripper_finger_joint1");
  for (int i = 1; i <= 4; ++i) {
    ASSERT_TRUE(sim->Step(Command(0, 0, 0, -1)).ok());
    EXPECT_NEAR(sim->data().ctrl[motor], 0.02 + 0.005 * i,
                1e-12);  // 25 * 0.01 of the half stroke a step
  }
  ASSERT_TRUE(sim->Step(Command(0, 0, 0, -1)).ok());
  EXPECT_NEAR(sim->data().ctrl[motor], 0.04, 1e-12);
  ASSERT_TRUE(sim->Step(Command(0, 0, 0, 1)).ok());
  EXPECT_NEAR(sim->data().ctrl[motor], 0.035, 1e-12);
  ASSERT_TRUE(sim->Step(Command(0, 0, 0, 0)).ok());
  EXPECT_NEAR(sim->data().ctrl[motor], 0.035, 1e-12);
}

// Moves the tool over the cube, down and closes; returns whether the check says "held".
bool GraspCube(PandaSim& sim) {
  const auto go_to = [&](double z, double gripper, int steps) {
    for (int i = 0; i < steps; ++i) {
      const Eigen::Vector3d u = 20 * (Eigen::Vector3d(0.5, 0, z) - sim.Measure().tool.p_base_tool);
      if (!sim.Step(Command(u.x(), u.y(), u.z(), gripper)).ok()) return;
    }
  };
  go_to(0.15, -1, 20);
  go_to(0.03, -1, 40);
  go_to(0.03, 1, 12);
  return sim.GraspDetected();
}

TEST(PandaSim, GraspNeedsBothPadsOnOneFreeBody) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  EXPECT_FALSE(sim->GraspDetected());
  ASSERT_TRUE(GraspCube(*sim));
  EXPECT_EQ(sim->held_body(), mj_name2id(&sim->model(), mjOBJ_BODY, "cube"));
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 1, 1)).ok());
  EXPECT_TRUE(sim->GraspDetected());
  EXPECT_GT(sim->data().qpos[11], 0.1);  // the cube's height
  for (int i = 0; i < 12; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0, -1)).ok());
  EXPECT_FALSE(sim->GraspDetected());
  EXPECT_EQ(sim->held_body(), -1);
}

TEST(PandaSim, ContactForcesOfASampleAreTheArmsAlone) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  double force = 0;
  sim->OnJointSample([&](const JointSample& sample) { force = sample.contact_N; });
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  ASSERT_GT(sim->data().ncon, 0) << "the cube lies on the table";
  EXPECT_EQ(force, 0);
  ASSERT_TRUE(GraspCube(*sim));
  EXPECT_GT(force, 1);
}

TEST(PandaSim, OnePadAloneIsNoGrasp) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  mjData& data = sim->mutable_data();
  const mjModel& m = sim->model();
  const auto geom = [&](const char* name) { return mj_name2id(&m, mjOBJ_GEOM, name); };
  const int pads[2] = {geom("gripper0_finger1_pad_collision"),
                       geom("gripper0_finger2_pad_collision")};
  // Puts the cube (40 mm wide) between the pads, `offset` from their middle along the closing
  // direction, and reports how many pads touch it.
  const auto touching_pads = [&](double finger, double offset) {
    data.qpos[7] = finger;
    data.qpos[8] = -finger;
    mj_kinematics(&m, &data);
    const Eigen::Map<const Eigen::Vector3d> a(data.geom_xpos + 3 * pads[0]),
        b(data.geom_xpos + 3 * pads[1]);
    const Eigen::Vector3d at = 0.5 * (a + b) + offset * (a - b).normalized();
    const double* hand = data.xquat + 4 * mj_name2id(&m, mjOBJ_BODY, "robot0_right_hand");
    std::copy(at.data(), at.data() + 3, data.qpos + 9);
    std::copy(hand, hand + 4, data.qpos + 12);
    mj_forward(&m, &data);
    bool touches[2] = {false, false};
    for (int c = 0; c < data.ncon; ++c) {
      for (int i = 0; i < 2; ++i) {
        const mjContact& contact = data.contact[c];
        const int cube = geom("cube");
        touches[i] |= (contact.geom1 == pads[i] && contact.geom2 == cube) ||
                      (contact.geom1 == cube && contact.geom2 == pads[i]);
      }
    }
    return touches[0] + touches[1];
  };
  // Open, the inner faces are 39.5 mm from the middle; the cube reaches 0.3 mm into one of them.
  for (const double offset : {0.0198, -0.0198}) {
    EXPECT_EQ(touching_pads(0.04, offset), 1);
    EXPECT_FALSE(sim->GraspDetected());
  }
  EXPECT_EQ(touching_pads(0.0203, 0), 2);
  EXPECT_TRUE(sim->GraspDetected());
}

TEST(PandaSim, AFixedBodyBetweenThePadsIsNotHeld) {
  PandaScene scene = TestScene();
  const std::string joint = "<freejoint name=\"cube_joint\"/>";
  scene.world_xml.erase(scene.world_xml.find(joint), joint.size());
  auto sim = MakeTestSim({}, scene);
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  EXPECT_FALSE(GraspCube(*sim));
  EXPECT_GT(sim->Measure().gripper, 0.03);  // the pads do press on it
}

TEST(PandaSim, RepeatsAnEpisodeBitForBit) {
  auto sim = MakeTestSim();
  UseScenario(*sim, "aged_joint_uniform");
  std::vector<std::vector<double>> runs;
  for (int run = 0; run < 2; ++run) {
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    ASSERT_TRUE(sim->Settle(10).ok());
    GraspCube(*sim);
    for (int i = 0; i < 10; ++i) ASSERT_TRUE(sim->Step(Command(0.3, 0.2, 0.5, 1)).ok());
    runs.push_back(Positions(*sim));
  }
  EXPECT_EQ(runs[0], runs[1]);
}

TEST(PandaSim, RestoreContinuesBitForBitWithHiddenStatesAndContacts) {
  auto sim = MakeTestSim();
  UseScenario(*sim, "heavy_payload");
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  ASSERT_TRUE(GraspCube(*sim));
  const auto snapshot = sim->Save();
  const auto continue_run = [&] {
    for (int i = 0; i < 20; ++i)
      EXPECT_TRUE(sim->Step(Command(0.2, -0.4, 0.6, i < 15 ? 1 : -1)).ok());
    return Positions(*sim);
  };
  const std::vector<double> first = continue_run();
  sim->Restore(*snapshot);
  EXPECT_TRUE(sim->GraspDetected());
  EXPECT_EQ(continue_run(), first);
  // Also in another simulator of the same model.
  auto other =
      PandaSim::Create(CompileModel("copy", ComposePandaScene(TestScene())).value(), {}).value();
  other->Restore(*snapshot);
  for (int i = 0; i < 20; ++i)
    ASSERT_TRUE(other->Step(Command(0.2, -0.4, 0.6, i < 15 ? 1 : -1)).ok());
  EXPECT_EQ(Positions(*other), first);
}

TEST(PandaSim, SeesStatesThatWereWrittenFromOutside) {
  // The bias torque of the first sub-step must be that of the written posture.
  auto a = MakeTestSim(), b = MakeTestSim();
  std::vector<double> qpos = HomeState(*a);
  qpos[3] += 0.1;
  ASSERT_TRUE(a->Reset(qpos, PandaHome()).ok());
  ASSERT_TRUE(b->Reset(HomeState(*b), PandaHome()).ok());
  b->mutable_data().qpos[3] = qpos[3];
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(a->Step(Command(0, 0, -1)).ok());
    ASSERT_TRUE(b->Step(Command(0, 0, -1)).ok());
  }
  EXPECT_EQ(Positions(*a), Positions(*b));
}

TEST(PandaSim, FindsAnArmWhoseJointsAreNotFirst) {
  // The same scene with the objects before the robot, as in other composers.
  const std::string xml = ComposePandaScene(TestScene());
  const size_t world = xml.find("<worldbody>") + 11, robot_end = xml.find("<light pos=\"0.5");
  const size_t world_end = xml.find("</worldbody>");
  const std::string swapped = xml.substr(0, world) + xml.substr(robot_end, world_end - robot_end) +
                              xml.substr(world, robot_end - world) + xml.substr(world_end);
  auto usual = MakeTestSim();
  auto other = PandaSim::Create(CompileModel("swapped", swapped).value(), {}).value();
  const std::vector<double> qpos = HomeState(*usual);
  std::vector<double> moved(qpos.begin() + 9, qpos.end());
  moved.insert(moved.end(), qpos.begin(), qpos.begin() + 9);
  for (PandaSim* sim : {usual.get(), other.get()}) UseScenario(*sim, "aged_joint_uniform");
  ASSERT_TRUE(usual->Reset(qpos, PandaHome()).ok());
  ASSERT_TRUE(other->Reset(moved, PandaHome()).ok());
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(usual->Step(Command(0.3, 0.5, 0.2)).ok());
    ASSERT_TRUE(other->Step(Command(0.3, 0.5, 0.2)).ok());
  }
  EXPECT_LT((usual->Measure().q - other->Measure().q).norm(), 1e-9);
}

TEST(PandaSim, ReportsADivergedState) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  sim->mutable_data().qvel[3] = 1e11;
  const absl::Status status = sim->Step(Command(0, 0, 0));
  EXPECT_EQ(status.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(status.message()), HasSubstr("diverged"));
  // A reset makes it usable again.
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  EXPECT_TRUE(sim->Step(Command(0, 0, 0)).ok());
}

TEST(PandaSim, ReportsTorquesThatAreNoNumbers) {
  // At every joint: how a vector's numbers are compared may depend on their place in it.
  for (int joint = 0; joint < 7; ++joint) {
    Scenario scenario;
    scenario.effects.push_back({joint, "position_periodic_torque", {1, 0, 1e-310}});
    auto sim = MakeTestSim();
    sim->SetScenario(scenario, 220);
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    absl::Status status;
    for (int i = 0; i < 5 && status.ok(); ++i) status = sim->Step(Command(0.3, 0.5, 0.2));
    EXPECT_EQ(status.code(), absl::StatusCode::kInternal) << joint;
    EXPECT_THAT(std::string(status.message()),
                testing::AllOf(HasSubstr("diverged"), HasSubstr("torque is no number")));
  }
}

TEST(PandaSim, NamesWhatAModelLacks) {
  const auto bad_xml =
      CompileModel("kitchen scene", "<mujoco><worldbody><geom/></worldbody></mujoco>");
  EXPECT_EQ(bad_xml.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(bad_xml.status().message()), HasSubstr("kitchen scene"));
  const auto empty = PandaSim::Create(
      CompileModel("empty", "<mujoco><option timestep=\"0.002\"/><worldbody/></mujoco>").value(),
      {});
  EXPECT_EQ(empty.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(empty.status().message()), HasSubstr("robot0_joint1"));
  std::string xml = ComposePandaScene(TestScene());
  xml.replace(xml.find("timestep=\"0.002\""), 16, "timestep=\"0.004\"");
  EXPECT_EQ(PandaSim::Create(CompileModel("slow", xml).value(), {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  auto sim = MakeTestSim();
  const std::vector<double> short_state(5, 0.0);
  EXPECT_EQ(sim->Reset(short_state, PandaHome()).code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace robostress
