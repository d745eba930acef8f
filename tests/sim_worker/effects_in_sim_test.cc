// The effect library in the simulator: each stage where its comment says, one implementation with
// the paper's errors, dry friction that holds, readings that only the controller sees.
#include <gtest/gtest.h>

#include <cmath>

#include "common/joint_errors/effects/effect_library.h"
#include "common/joint_errors/joint_chain.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

constexpr double kSubStep = 0.002;

// A scenario with one effect; values in the library's order.
Scenario With(int joint, const std::string& type, std::vector<double> values) {
  Scenario scenario;
  scenario.name = type;
  scenario.effects.push_back({joint, type, std::move(values)});
  return scenario;
}

Eigen::VectorXf Wander(int i) {
  return Command(0.4 * std::sin(0.07 * i), 0.6 * std::cos(0.05 * i), 0.3 * std::sin(0.11 * i));
}

struct Path {
  std::vector<JointSample> asked;                 // of every sub-step
  std::vector<JointSample::Vector> motor, truth;  // torque given to MuJoCo, joint angles
};

// Settles two control steps and wanders for `steps`.
Path Record(PandaSim& sim, int steps) {
  Path path;
  sim.OnJointSample([&](const JointSample& sample) {
    path.asked.push_back(sample);
    path.motor.push_back(Eigen::Map<const JointSample::Vector>(sim.data().ctrl));
  });
  sim.OnSubStep(
      [&] { path.truth.push_back(Eigen::Map<const JointSample::Vector>(sim.data().qpos)); });
  EXPECT_TRUE(sim.Reset(HomeState(sim), PandaHome()).ok());
  EXPECT_TRUE(sim.Settle(2).ok());
  for (int i = 0; i < steps; ++i) EXPECT_TRUE(sim.Step(Wander(i)).ok());
  sim.OnJointSample(nullptr);
  sim.OnSubStep(nullptr);
  return path;
}
Path Record(const Scenario& scenario, int steps, const SimOptions& options = {}) {
  auto sim = MakeTestSim(options);
  sim->SetScenario(scenario, 220);
  return Record(*sim, steps);
}

double LargestDistance(const Path& a, const Path& b) {
  double largest = 0;
  for (size_t i = 0; i < a.truth.size(); ++i)
    largest = std::max(largest, (a.truth[i] - b.truth[i]).cwiseAbs().maxCoeff());
  return largest;
}

TEST(EffectsInSim, ADelayGivesTheMotorWhatTheControllerAskedForEarlier) {
  const Path path = Record(With(1, "transport_delay", {5 * kSubStep}), 20);
  double change = 0;
  for (size_t i = 5; i < path.motor.size(); ++i) {
    EXPECT_EQ(path.motor[i][1], path.asked[i - 5].tau[1]) << i;
    EXPECT_EQ(path.motor[i][0], path.asked[i].tau[0]) << i;
    change = std::max(change, std::abs(path.asked[i].tau[1] - path.asked[i - 5].tau[1]));
  }
  EXPECT_GT(change, 1);
}

TEST(EffectsInSim, ADriveLosesItsDeadZoneAndSaturates) {
  const Path dead = Record(With(3, "deadzone", {0.5}), 10);
  const Path weak = Record(With(3, "torque_saturation", {6}), 10);
  for (size_t i = 0; i < dead.motor.size(); ++i) {
    const double asked = dead.asked[i].tau[3];
    EXPECT_NEAR(dead.motor[i][3], std::copysign(std::max(0.0, std::abs(asked) - 0.5), asked),
                1e-12);
    EXPECT_LE(std::abs(weak.motor[i][3]), 6 + 1e-12);
  }
}

TEST(EffectsInSim, AnErrorOfThePaperAndTheSameEffectAreOneLaw) {
  // Gravity residual.
  Scenario paper = MakeScenario("isolated_gravity", 5).value(), ours;
  for (int j = 0; j < 7; ++j)
    ours.effects.push_back(
        {j, "gravity_error", {Scale(NominalPandaErrors()[j], paper.end[j]).beta}});
  EXPECT_LT(LargestDistance(Record(paper, 30), Record(ours, 30)), 1e-9);
  // Stribeck friction under the law that stops a joint.
  SimOptions stick;
  stick.joint_errors.friction_law = FrictionLaw::kStick;
  paper = MakeScenario("isolated_stribeck", 5).value();
  ours.effects.clear();
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters p = Scale(NominalPandaErrors()[j], paper.end[j]);
    ours.effects.push_back({j, "stribeck_friction", {p.Fc, p.Fs, p.vs, p.sigma_v}});
  }
  EXPECT_LT(LargestDistance(Record(paper, 30, stick), Record(ours, 30)), 1e-7);
  // Compliance from its static deflection.
  SimOptions deflected;
  deflected.joint_errors.offset_start = OffsetStart::kEquilibrium;
  paper = MakeScenario("isolated_compliance", 5).value();
  ours.effects.clear();
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters p = Scale(NominalPandaErrors()[j], paper.end[j]);
    const double frequency = std::sqrt(p.K / p.M_eff) / (2 * M_PI);
    ours.effects.push_back(
        {j, "compliance", {p.K, frequency, p.D / (2 * std::sqrt(p.K * p.M_eff))}});
  }
  EXPECT_LT(LargestDistance(Record(paper, 30, deflected), Record(ours, 30)), 1e-7);
}

TEST(EffectsInSim, DryFrictionHoldsAJointInsteadOfChattering) {
  Scenario sticky;
  for (int j = 0; j < 7; ++j)
    sticky.effects.push_back({j, "stribeck_friction", {j < 4 ? 4.35 : 0.96, 5, 0.15, 0.5}});
  auto sim = MakeTestSim();
  sim->SetScenario(sticky, 220);
  Record(*sim, 10);
  double speed = 0;
  sim->OnSubStep([&] { speed = std::max(speed, std::abs(sim->data().qvel[1])); });
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  speed = 0;
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  EXPECT_LT(speed, 1e-5);
}

TEST(EffectsInSim, BacklashLeavesTheLinkWithinItsGap) {
  const double B = 0.01;
  auto sim = MakeTestSim();
  sim->SetScenario(With(1, "backlash", {B}), 220);
  double largest = 0;
  sim->OnSubStep([&] { largest = std::max(largest, std::abs(sim->joint_chain().offset(1))); });
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  for (int i = 0; i < 60; ++i) ASSERT_TRUE(sim->Step(Wander(3 * i)).ok());
  EXPECT_NEAR(largest, B, 1e-9);
}

TEST(EffectsInSim, APayloadSagsAndIsHeavyToMove) {
  Scenario loaded;
  for (int j = 0; j < 7; ++j) loaded.effects.push_back({j, "payload", {1.0}});
  const Path clean = Record(Scenario(), 20), heavy = Record(loaded, 20);
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  // At the first sub-step the motor's torque lacks what holds 1 kg at the tool, and what moves it.
  const double lever =
      sim->data().site_xpos[3 * mj_name2id(&sim->model(), mjOBJ_SITE, "gripper0_grip_site")];
  EXPECT_NEAR(clean.motor[1][1] - heavy.motor[1][1], -9.81 * lever, 0.15 * 9.81 * lever);
  EXPECT_GT(LargestDistance(clean, heavy), 0.01);
}

TEST(EffectsInSim, AnEffectOfSizeZeroChangesNothingOfThePapersErrors) {
  const Scenario paper = MakeScenario("aged_joint_uniform", 5).value();
  Scenario beside = paper;
  beside.effects.push_back({3, "gravity_error", {0}});
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kTanh, FrictionLaw::kStick}) {
    SimOptions options;
    options.joint_errors.friction_law = law;
    EXPECT_LT(LargestDistance(Record(paper, 20, options), Record(beside, 20, options)), 1e-9);
  }
}

TEST(EffectsInSim, APayloadTakesTheTorqueThatAcceleratesIt) {
  // Of 2 kg at J2 the joint has asked - 2 g1 - 2 |r|^2 ddq, g1 and r from the tool's place.
  auto sim = MakeTestSim();
  sim->SetScenario(With(1, "payload", {2}), 220);
  const int site = mj_name2id(&sim->model(), mjOBJ_SITE, "gripper0_grip_site");
  double largest = 0, error = 0;
  sim->OnJointSample([&](const JointSample& sample) {
    const mjData& d = sim->data();
    const Eigen::Vector3d axis(d.xaxis + 3), anchor(d.xanchor + 3), tool(d.site_xpos + 3 * site);
    const Eigen::Vector3d column = axis.cross(tool - anchor);
    const double gravity = column.z() * 9.81;
    const double inertial = 2 * column.squaredNorm() * (d.qvel[1] - sample.dq[1]) / kSubStep;
    largest = std::max(largest, std::abs(inertial));
    if (std::max(std::abs(sample.tau[1]), std::abs(d.ctrl[1])) > 75) return;  // near the limit
    error = std::max(error, std::abs(sample.tau[1] - 2 * gravity - inertial - d.ctrl[1]));
  });
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  for (int i = 0; i < 6; ++i) ASSERT_TRUE(sim->Step(Command(1, 0, i % 2 ? 1 : -1)).ok());
  EXPECT_GT(largest, 2);
  EXPECT_LT(error, 0.2 * largest);
}

TEST(EffectsInSim, TransmissionsInARowBeginAtRestAndEachSeesItsOwnMotor) {
  // An effect that turns the link by 0.1 rad wherever it stands, beside the paper's gap of 0.013
  // rad: nothing moves, so the gap stays in its middle, and later within its bounds.
  Scenario scenario = MakeScenario("isolated_backlash", 5).value();
  scenario.effects.push_back({3, "transmission_error", {0.1, 0, 1e6}});
  auto sim = MakeTestSim();
  sim->SetScenario(scenario, 220);
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  const double gap = sim->joint_chain().error_offset(kPaperBacklash, 3);
  EXPECT_NEAR(sim->joint_chain().offset(3) - gap, 0.1, 1e-9);
  EXPECT_LT(std::abs(gap), 2e-3);
  // An effect that depends on the motor's angle sees the motor's angle.
  const double wave = 2 * M_PI / 0.5, a = 0.03;
  sim->SetScenario(With(3, "transmission_error", {a, 0, 0.5}), 220);
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(0, 0, 0)).ok());
  const double offset = sim->joint_chain().offset(3), link = sim->data().qpos[3];
  EXPECT_NEAR(offset, a * std::cos(wave * (link - offset)), 1e-3);
  EXPECT_GT(std::abs(offset - a * std::cos(wave * link)), 5e-3) << "a place where it matters";
}

TEST(EffectsInSim, AnEncodersOffsetIsSeenByTheControllerAndTheLogAlone) {
  const double offset = 0.05;
  auto sim = MakeTestSim();
  sim->SetScenario(With(0, "encoder_offset", {offset}), 220);
  std::vector<double> read, is;
  sim->OnJointSample([&](const JointSample& sample) { read.push_back(sample.q[0]); });
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  is.push_back(sim->data().qpos[0]);
  sim->OnSubStep([&] { is.push_back(sim->data().qpos[0]); });
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(sim->Step(Command(1, 0, 0)).ok());
  for (size_t i = 0; i < read.size(); ++i) EXPECT_NEAR(read[i], is[i] + offset, 1e-12);
  // A command along x, in the frame that the controller believes in, leads to the side.
  const Eigen::Vector3d tool = sim->Measure().tool.p_base_tool;
  EXPECT_EQ(sim->Measure().q[0], sim->data().qpos[0]);
  auto straight = MakeTestSim();
  ASSERT_TRUE(straight->Reset(HomeState(*straight), PandaHome()).ok());
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(straight->Step(Command(1, 0, 0)).ok());
  const Eigen::Vector3d expected = straight->Measure().tool.p_base_tool;
  EXPECT_LT(tool.y() - expected.y(), -0.003);
}

TEST(EffectsInSim, CouplingReadsTheOtherJoint) {
  Scenario coupled = With(4, "cross_joint_coupling", {2});
  coupled.effects[0].coupled = 1;
  const Path path = Record(coupled, 5);
  // Torque -k q_2; the joint angle at a sub-step's start is that of the one before's end.
  for (size_t i = 1; i < path.motor.size(); ++i) {
    const double expected =
        std::clamp(path.asked[i].tau[4] - 2 * path.truth[i - 1][1], -80.0, 80.0);
    EXPECT_NEAR(path.motor[i][4], expected, 1e-9);
  }
}

TEST(EffectsInSim, ASnapshotHoldsHiddenStates) {
  Scenario scenario = With(1, "transport_delay", {0.011});
  scenario.effects.push_back({3, "presliding_hysteresis", {2, 0.02}});
  scenario.effects.push_back({5, "backlash", {0.01}});
  auto sim = MakeTestSim();
  sim->SetScenario(scenario, 220);
  Record(*sim, 12);
  const auto snapshot = sim->Save();
  const auto go_on = [&] {
    for (int i = 0; i < 8; ++i) EXPECT_TRUE(sim->Step(Wander(40 + i)).ok());
    return sim->Measure().q;
  };
  const Eigen::VectorXd first = go_on();
  sim->Restore(*snapshot);
  EXPECT_EQ(go_on(), first);
}

TEST(EffectsInSim, EveryEffectRunsInEverySteppingAndStaysFinite) {
  for (const Stepping stepping : {Stepping::kFast, Stepping::kReference, Stepping::kParity}) {
    SimOptions options;
    options.stepping = stepping;
    Scenario all;
    for (const EffectInfo& info : EffectLibrary()) {
      ScenarioEffect effect{1, info.type, {}};
      // A tenth of what the library starts fits with, at signals of 10 Nm, 1 rad, 1 rad/s, 5 ms.
      for (const EffectParameter& p : info.parameters)
        effect.values.push_back(p.inverse ? 1000 : p.fixed ? p.starts[0] : 0.1 * p.starts[0]);
      if (info.coupled) effect.coupled = 2;
      if (info.type == "transport_delay" || info.type == "servo_lag") effect.values = {0.004};
      all.effects.push_back(std::move(effect));
    }
    const Path path = Record(all, 5, options);
    for (const JointSample::Vector& q : path.truth) ASSERT_TRUE(q.allFinite());
  }
}

}  // namespace
}  // namespace robostress
