// The joint errors in the simulator: order, gates, equality where the paper says "nominal", and how
// far the fast stepping order is from the paper's.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "sim_worker/panda_model.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

const std::vector<std::string> kDeployment = {
    "heavy_payload",      "thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
    "aged_joint_uniform", "aged_joint_shoulder",    "aged_joint_elbow"};

// Tool-space wandering of the arm above the table that meets nothing.
Eigen::VectorXf Wander(int i) {
  return Command(0.4 * std::sin(0.07 * i), 0.6 * std::cos(0.05 * i), 0.3 * std::sin(0.11 * i),
                 i / 50 % 2 ? 1 : -1);
}

// Arm positions after `settle` settle steps and each of `steps` control steps.
std::vector<Eigen::VectorXd> Simulate(PandaSim& sim, int steps, int settle = 2) {
  std::vector<Eigen::VectorXd> path;
  EXPECT_TRUE(sim.Reset(HomeState(sim), PandaHome()).ok());
  EXPECT_TRUE(sim.Settle(settle).ok());
  for (int i = 0; i < steps; ++i) {
    EXPECT_TRUE(sim.Step(Wander(i)).ok());
    path.push_back(sim.Measure().q);
  }
  return path;
}

std::vector<Eigen::VectorXd> Simulate(const Scenario& scenario, int steps,
                                      const SimOptions& options = {}) {
  auto sim = MakeTestSim(options);
  sim->SetScenario(scenario, 220);
  return Simulate(*sim, steps);
}

std::vector<Eigen::VectorXd> Simulate(const std::string& scenario, int steps,
                                      const SimOptions& options = {}, int level = 5) {
  return Simulate(MakeScenario(scenario, level).value(), steps, options);
}

SimOptions With(void (*change)(SimOptions&)) {
  SimOptions options;
  change(options);
  return options;
}

TEST(JointErrorsInSim, CleanIsTheUndisturbedSimulator) {
  auto untouched = MakeTestSim();
  EXPECT_EQ(Simulate("clean", 20), Simulate(*untouched, 20));
}

TEST(JointErrorsInSim, EveryComponentActsInEachOfTheSevenScenarios) {
  for (const std::string& name : kDeployment) {
    const Scenario scenario = MakeScenario(name, 5).value();
    const auto with_all = Simulate(scenario, 4);
    for (bool Scenario::*component : {&Scenario::friction_on, &Scenario::gravity_on,
                                      &Scenario::backlash_on, &Scenario::compliance_on}) {
      Scenario without = scenario;
      without.*component = false;
      EXPECT_NE(Simulate(without, 4), with_all) << name;
    }
  }
}

TEST(JointErrorsInSim, HeavyPayloadWithoutAGraspIsNominalBitForBit) {
  EXPECT_EQ(Simulate("heavy_payload", 60), Simulate("nominal", 60));
}

TEST(JointErrorsInSim, HeavyPayloadActsOnceAnObjectIsHeld) {
  std::vector<std::unique_ptr<PandaSim>> sims;
  for (const char* name : {"heavy_payload", "nominal"}) {
    sims.push_back(MakeTestSim());
    UseScenario(*sims.back(), name);
    PandaSim& sim = *sims.back();
    ASSERT_TRUE(sim.Reset(HomeState(sim), PandaHome()).ok());
    const auto go_to = [&](double z, double gripper, int steps) {
      for (int i = 0; i < steps && !(gripper > 0 && sim.GraspDetected()); ++i) {
        const Eigen::Vector3d u =
            20 * (Eigen::Vector3d(0.5, 0, z) - sim.Measure().tool.p_base_tool);
        ASSERT_TRUE(sim.Step(Command(u.x(), u.y(), u.z(), gripper)).ok());
      }
    };
    go_to(0.15, -1, 30);
    go_to(0.03, -1, 60);
    go_to(0.03, 1, 12);
    ASSERT_TRUE(sim.GraspDetected()) << name;
  }
  // Equal to the bit until the step in which the object is held first, different after one more.
  EXPECT_EQ(sims[0]->Measure().q, sims[1]->Measure().q);
  for (auto& sim : sims) ASSERT_TRUE(sim->Step(Command(0, 0, 0, 1)).ok());
  EXPECT_NE(sims[0]->Measure().q, sims[1]->Measure().q);
}

TEST(JointErrorsInSim, SeverityOneEqualsNominalBitForBit) {
  for (const std::string& name : kDeployment) {
    Scenario scenario = MakeScenario(name, 5).value();
    scenario.start.assign(7, {});
    scenario.end.assign(7, {});
    EXPECT_EQ(Simulate(scenario, 20), Simulate("nominal", 20)) << name;
  }
}

TEST(JointErrorsInSim, SettleStepsRunAtProgressZeroWithErrorsOn) {
  // Settling under a ramp is settling under its onset.
  auto ramp = MakeTestSim(), onset = MakeTestSim();
  ramp->SetScenario(MakeScenario("thermal_drift_backlash", 5).value(), 5);
  onset->SetScenario(MakeScenario("thermal_drift_backlash", 1).value(), 5);
  std::vector<double> start = HomeState(*ramp);
  start[3] += 0.05;
  auto clean = MakeTestSim();
  for (PandaSim* sim : {ramp.get(), onset.get(), clean.get()}) {
    ASSERT_TRUE(sim->Reset(start, PandaHome()).ok());
    ASSERT_TRUE(sim->Settle(10).ok());
  }
  EXPECT_EQ(ramp->Measure().q, onset->Measure().q);
  EXPECT_NE(ramp->Measure().q, clean->Measure().q);
  EXPECT_EQ(ramp->steps_taken(), 0);
  // The first steps after it leave the onset.
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(ramp->Step(Command(0.5, 0.5, 0)).ok());
    ASSERT_TRUE(onset->Step(Command(0.5, 0.5, 0)).ok());
  }
  EXPECT_NE(ramp->Measure().q, onset->Measure().q);
}

TEST(JointErrorsInSim, HiddenStatesDoNotSurviveAReset) {
  auto sim = MakeTestSim();
  UseScenario(*sim, "aged_joint_uniform");
  const auto first = Simulate(*sim, 30);
  EXPECT_EQ(Simulate(*sim, 30), first);
}

TEST(JointErrorsInSim, GravityTorqueIsThatOfRestWhateverTheVelocity) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  for (int i = 0; i < 12; ++i) ASSERT_TRUE(sim->Step(Command(1, 1, 0.5)).ok());
  const PandaModel panda = PandaModel::Find(sim->model()).value();
  mjData& data = sim->mutable_data();
  for (int i = 0; i < 7; ++i) data.qvel[i] = i % 2 ? 1.5 : -1;
  mj_forward(&sim->model(), &data);
  const Vector7d g = GravityTorque(sim->model(), data, panda);
  const Vector7d bias_in_motion = Eigen::Map<const Vector7d>(data.qfrc_bias);
  mju_zero(data.qvel, sim->model().nv);
  mj_forward(&sim->model(), &data);
  const Vector7d bias_at_rest = Eigen::Map<const Vector7d>(data.qfrc_bias);
  EXPECT_LT((g - bias_at_rest).cwiseAbs().maxCoeff(), 1e-10);
  EXPECT_GT((bias_in_motion - bias_at_rest).cwiseAbs().maxCoeff(),
            0.1);  // what qfrc_bias would have added
}

TEST(JointErrorsInSim, LiteralGravityLiftsTheArmAndPayloadLetsItSag) {
  double dz[2];
  for (const GravitySign sign : {GravitySign::kLiteral, GravitySign::kPayload}) {
    SimOptions options;
    options.joint_errors.gravity_sign = sign;
    auto sim = MakeTestSim(options);
    UseScenario(*sim, "isolated_gravity");
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    const double z = sim->Measure().tool.p_base_tool.z();
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
    dz[sign == GravitySign::kPayload] = sim->Measure().tool.p_base_tool.z() - z;
  }
  EXPECT_GT(dz[0], 0.02);
  EXPECT_LT(dz[1], -0.02);
}

TEST(JointErrorsInSim, FrictionLawsDifferAtRest) {
  // Mean largest joint speed while holding: sgn chatters, the others are still.
  double speed[3];
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kTanh, FrictionLaw::kStick}) {
    SimOptions options;
    options.joint_errors.friction_law = law;
    auto sim = MakeTestSim(options);
    UseScenario(*sim, "isolated_stribeck");
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    ASSERT_TRUE(sim->Settle(10).ok());
    double sum = 0;
    for (int i = 0; i < 20; ++i) {
      ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
      sum += sim->Measure().dq.cwiseAbs().maxCoeff() / 20;
    }
    speed[static_cast<int>(law)] = sum;
  }
  EXPECT_GT(speed[static_cast<int>(FrictionLaw::kSgn)], 1e-3);
  EXPECT_LT(speed[static_cast<int>(FrictionLaw::kTanh)], 5e-4);
  EXPECT_LT(speed[static_cast<int>(FrictionLaw::kStick)], 5e-5);
}

TEST(JointErrorsInSim, StickHoldsASmallCommandWhereSgnCreeps) {
  double moved[2];
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kStick}) {
    SimOptions options;
    options.joint_errors.friction_law = law;
    auto sim = MakeTestSim(options);
    UseScenario(*sim, "isolated_stribeck");
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    ASSERT_TRUE(sim->Settle(4).ok());
    const double y = sim->Measure().tool.p_base_tool.y();
    for (int i = 0; i < 16; ++i) ASSERT_TRUE(sim->Step(Command(0, 0.1, 0)).ok());
    moved[law == FrictionLaw::kStick] = sim->Measure().tool.p_base_tool.y() - y;
  }
  EXPECT_GT(moved[0], 1e-3);
  EXPECT_LT(std::abs(moved[1]), 1e-4);
}

TEST(JointErrorsInSim, EquilibriumStartHasNoTransient) {
  double settled[2];
  for (const OffsetStart start : {OffsetStart::kZero, OffsetStart::kEquilibrium}) {
    SimOptions options;
    options.joint_errors.offset_start = start;
    auto sim = MakeTestSim(options);
    UseScenario(*sim, "isolated_compliance");
    ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
    const Eigen::VectorXd q = sim->Measure().q;
    ASSERT_TRUE(sim->Settle(10).ok());
    settled[start == OffsetStart::kEquilibrium] = (sim->Measure().q - q).norm();
  }
  EXPECT_GT(settled[0], 5e-3);
  EXPECT_LT(settled[1], 1e-3);
}

TEST(JointErrorsInSim, TheJointCoordinateCarriesTheOffsetInBothModes) {
  // A rested arm under compliance sags by -g / K per joint against the motor, and the controller
  // holds the tool: after the settle steps both modes are at the same place.
  const SimOptions velocity =
      With([](SimOptions& o) { o.joint_errors.offset_mode = OffsetMode::kVelocity; });
  const Eigen::VectorXd a = Simulate("isolated_compliance", 40).back(),
                        b = Simulate("isolated_compliance", 40, velocity).back();
  EXPECT_LT((a - b).cwiseAbs().maxCoeff(), 2e-3);
  EXPECT_NE(a, b);
}

// A closed loop that grasps the cube and carries it to and fro; slip of the cube in the hand [m],
// or infinity when it is lost.
double Slip(OffsetMode mode) {
  SimOptions options;
  options.joint_errors.offset_mode = mode;
  auto sim = MakeTestSim(options);
  UseScenario(*sim, "isolated_compliance");
  EXPECT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const mjModel& m = sim->model();
  const int cube = mj_name2id(&m, mjOBJ_BODY, "cube"),
            site = mj_name2id(&m, mjOBJ_SITE, "gripper0_grip_site");
  const auto in_hand = [&] {
    using Map = Eigen::Map<const Eigen::Vector3d>;
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(sim->data().site_xmat +
                                                                           9 * site);
    return Eigen::Vector3d(
        R.transpose() * (Map(sim->data().xpos + 3 * cube) - Map(sim->data().site_xpos + 3 * site)));
  };
  const auto go_to = [&](const Eigen::Vector3d& target, double gripper, int steps) {
    for (int i = 0; i < steps; ++i) {
      const Eigen::Vector3d u = 20 * (target - sim->Measure().tool.p_base_tool);
      EXPECT_TRUE(sim->Step(Command(u.x(), u.y(), u.z(), gripper)).ok());
    }
  };
  go_to({0.5, 0, 0.15}, -1, 20);
  go_to({0.5, 0, 0.03}, -1, 40);
  go_to({0.5, 0, 0.03}, 1, 12);
  EXPECT_TRUE(sim->GraspDetected());
  const Eigen::Vector3d before = in_hand();
  for (int k = 0; k < 6; ++k) go_to({0.5, k % 2 ? -0.1 : 0.1, 0.15 + 0.02 * k}, 1, 15);
  return sim->GraspDetected() ? (in_hand() - before).norm() : INFINITY;
}

TEST(JointErrorsInSim, ATeleportedJointDoesNotDragAHeldObjectButAVelocityDoes) {
  const double teleport = Slip(OffsetMode::kTeleport), velocity = Slip(OffsetMode::kVelocity);
  EXPECT_LT(velocity, 0.012);
  EXPECT_GT(teleport, 2 * velocity);
}

// Largest distance between the tool's positions under fast and reference stepping over 200 control
// steps.
double SteppingDifference(const std::string& scenario) {
  std::unique_ptr<PandaSim> sims[2];
  for (int k = 0; k < 2; ++k) {
    SimOptions options;
    options.stepping = k == 0 ? Stepping::kFast : Stepping::kReference;
    sims[k] = MakeTestSim(options);
    UseScenario(*sims[k], scenario);
    EXPECT_TRUE(sims[k]->Reset(HomeState(*sims[k]), PandaHome()).ok());
    EXPECT_TRUE(sims[k]->Settle(10).ok());
  }
  double worst = 0;
  for (int i = 0; i < 200; ++i) {
    for (auto& sim : sims) EXPECT_TRUE(sim->Step(Wander(i)).ok());
    worst = std::max(
        worst, (sims[0]->Measure().tool.p_base_tool - sims[1]->Measure().tool.p_base_tool).norm());
  }
  return worst;
}

TEST(JointErrorsInSim, FastSteppingStaysWithinAMillimetreOfThePapersOrder) {
  // Without position errors the two are the same computation.
  EXPECT_LT(SteppingDifference("clean"), 1e-9);
  EXPECT_LT(SteppingDifference("isolated_gravity"), 1e-9);
  // With them, the fast order takes mass matrix and bias from before the offset's change (at most
  // 7e-5 rad a sub-step), which moves the tool by up to 0.5 mm in 10 s; the free backlash
  // gap amplifies rounding.
  for (const char* name : {"nominal", "aged_transmission", "aged_joint_uniform"}) {
    EXPECT_LT(SteppingDifference(name), 1e-3) << name;
  }
}

}  // namespace
}  // namespace robostress
