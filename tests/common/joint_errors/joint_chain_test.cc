// The chain of effects at the joints of an arm: what its stages add up to, for any number of
// joints.
#include "common/joint_errors/joint_chain.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/joint_errors/effects/backlash.h"
#include "common/joint_errors/effects/compliance.h"
#include "common/joint_errors/effects/friction.h"
#include "common/joint_errors/effects/gravity_residual.h"
#include "common/random.h"
#include "tests/common/joint_errors/free_joints.h"

namespace robostress {
namespace {

constexpr double kStep = 0.002;  // [s]

// A moment with every field of its own.
JointMoment Moment() {
  JointMoment m;
  m.t = 12;
  m.h = kStep;
  m.q = 0.7;
  m.dq = -0.4;
  m.drive = -5;
  m.gravity = 8;
  m.payload_gravity = 3;
  m.payload_inertia = 0.25;
  return m;
}

Scenario At(int joint, const std::vector<std::pair<std::string, std::vector<double>>>& effects) {
  Scenario scenario;
  for (const auto& [type, values] : effects) scenario.effects.push_back({joint, type, values});
  return scenario;
}

TEST(JointChain, AddsUpWhatTheEffectsOfAJointDo) {
  JointChain chain(7);
  chain.SetScenario(At(3, {{"payload", {2}},
                           {"gravity_error", {0.1}},
                           {"payload", {0.5}},
                           {"asymmetric_coulomb", {0.3}},
                           {"load_dependent_friction", {0.1}}}),
                    1);
  const std::vector<JointMoment> moments(7, Moment());
  chain.Reset(moments);
  std::vector<double> torque(7, 1);
  chain.AddTorques(moments, absl::MakeSpan(torque));
  EXPECT_NEAR(torque[3], 1 - 6 + 0.8 - 1.5, 1e-12);
  EXPECT_NEAR(chain.inertia()[3], 0.5 + 0.125, 1e-12);
  EXPECT_NEAR(chain.dry()[3].forward, 0.3 + 0.5, 1e-12);
  EXPECT_NEAR(chain.dry()[3].backward, -0.3 + 0.5, 1e-12);
  EXPECT_EQ(torque[2], 1);
  EXPECT_TRUE(chain.sticks());
  EXPECT_EQ(chain.reads(), kGravityField | kPayloadFields | kDriveField);
}

TEST(JointChain, AnEpisodeBeginsAtTheStaticDeflectionAndInTheMiddleOfTheGap) {
  // q is the link's angle; the motor stands 5/500 on. Nothing moves, so nothing changes.
  JointChain chain(7);
  chain.SetScenario(At(3, {{"compliance", {500, 15, 0.7}}, {"backlash", {0.001}}}), 1);
  std::vector<JointMoment> moments(7, Moment());
  chain.Reset(moments);
  EXPECT_NEAR(chain.offset(3), 5.0 / 500, 1e-12);
  moments[3].q = chain.MotorAngle(3, moments[3].q);
  std::vector<double> change(7);
  chain.MoveEffects(moments, absl::MakeSpan(change));
  for (const double c : change) EXPECT_NEAR(c, 0, 1e-12);
}

TEST(JointChain, ACopyGoesOnAloneFromTheSameHiddenState) {
  JointChain chain(1);
  chain.SetScenario(At(0, {{"presliding_hysteresis", {2, 0.05}}}), 1);
  JointMoment moment;
  moment.h = kStep;
  const auto torque_of = [&](JointChain& of) {
    double torque = 0;
    of.AddTorques({&moment, 1}, {&torque, 1});
    return torque;
  };
  chain.Reset({&moment, 1});
  moment.dq = 1;
  for (int i = 0; i < 10; ++i) torque_of(chain);
  JointChain copy = chain;
  const double ahead = torque_of(chain);
  EXPECT_LT(ahead, -0.5);
  EXPECT_EQ(torque_of(copy), ahead);
  moment.dq = -1;
  for (int i = 0; i < 20; ++i) torque_of(chain);
  moment.dq = 0;
  EXPECT_EQ(torque_of(copy), ahead);
  EXPECT_GT(torque_of(chain), 0);
}

// An effect of every stage at each joint, of a size of the joint's own.
Scenario EveryStage(int joints) {
  Scenario scenario;
  for (int j = 0; j < joints; ++j) {
    const double size = 1 + 0.1 * j;
    for (const auto& [type, values] : std::vector<std::pair<std::string, std::vector<double>>>{
             {"servo_lag", {0.01 * size}},
             {"deadzone", {0.3 * size}},
             {"stribeck_friction", {1 * size, 1.5 * size, 0.1, 0.2 * size}},
             {"gravity_error", {0.1 * size}},
             {"backlash", {0.01 * size}},
             {"compliance", {800 * size, 15, 0.7}},
             {"encoder_gain", {0.01 * size}}})
      scenario.effects.push_back({j, type, values});
  }
  return scenario;
}

TEST(JointChain, OfAnyNumberOfJointsIsThatManyChainsOfOne) {
  for (const int joints : {1, 2, 6, 7, 14}) {
    const Scenario all = EveryStage(joints);
    JointChain chain(joints);
    chain.SetScenario(all, 1);
    std::vector<JointChain> alone(joints, JointChain(1));
    for (int j = 0; j < joints; ++j) {
      Scenario own;
      for (ScenarioEffect effect : all.effects) {
        if (effect.joint != j) continue;
        effect.joint = 0;
        own.effects.push_back(effect);
      }
      alone[j].SetScenario(own, 1);
    }
    std::vector<JointMoment> moments(joints, Moment());
    chain.Reset(moments);
    for (int j = 0; j < joints; ++j) alone[j].Reset({&moments[j], 1});
    for (int i = 0; i < 200; ++i) {
      std::vector<double> torque(joints), change(joints);
      for (int j = 0; j < joints; ++j) {
        moments[j].t = kStep * i;
        moments[j].q = 0.3 * std::sin(0.05 * i + j);
        moments[j].dq = 0.3 * std::cos(0.05 * i + j);
        torque[j] = 4 * std::sin(0.11 * i + j);
      }
      std::vector<JointMoment> own = moments;
      std::vector<double> own_torque = torque;
      chain.Drive(absl::MakeSpan(moments), absl::MakeSpan(torque));
      chain.AddTorques(moments, absl::MakeSpan(torque));
      chain.MoveEffects(moments, absl::MakeSpan(change));
      for (int j = 0; j < joints; ++j) {
        double own_change = 0;
        alone[j].Drive({&own[j], 1}, {&own_torque[j], 1});
        alone[j].AddTorques({&own[j], 1}, {&own_torque[j], 1});
        alone[j].MoveEffects({&own[j], 1}, {&own_change, 1});
        ASSERT_EQ(torque[j], own_torque[j]) << joints << " joints, joint " << j + 1;
        ASSERT_EQ(change[j], own_change);
        ASSERT_EQ(chain.dry()[j].forward, alone[j].dry()[0].forward);
        ASSERT_EQ(chain.Reading(j, 0.5), alone[j].Reading(0, 0.5));
      }
    }
  }
}

// The paper's order on the laws themselves, joint by joint: what a chain does to the bit.
struct PlainJoint {
  Backlash gap;
  Compliance spring;
  double offset = 0;

  double Torque(const Scenario& s, const JointErrorOptions& o, const JointErrorParameters& p,
                double asked, const JointMoment& m, double limit) const {
    double torque = asked;
    if (s.friction_on) torque += StribeckTorque(p, m.dq, o.friction_law, o.tanh_width);
    if (s.gravity_on) torque += GravityResidual(p, m.gravity, o.gravity_sign);
    return std::clamp(torque, -limit, limit);
  }
  double Change(const Scenario& s, const JointErrorParameters& p, double q, double load) {
    double next = 0;
    if (s.backlash_on) next += gap.Step(p, q - offset);
    if (s.compliance_on) next += spring.Step(p, load, kStep);
    const double change = next - offset;
    offset = next;
    return change;
  }
};

TEST(JointChain, HoldsThePapersLawsToTheBit) {
  const double limit = 12;
  for (const std::string& name : ScenarioNames()) {
    for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kTanh}) {
      for (const GravitySign sign : {GravitySign::kLiteral, GravitySign::kPayload}) {
        const JointErrorOptions options{.friction_law = law, .gravity_sign = sign};
        const Scenario scenario = MakeScenario(name, 4).value();
        JointChain chain(7, options);
        chain.SetScenario(scenario, 10);
        Vector7 q = Vector7::Constant(0.2);
        ResetAt(chain, q, Vector7::Zero());
        std::array<PlainJoint, 7> plain;
        for (int j = 0; j < 7; ++j) plain[j].gap.Reset(q[j]);
        RandomStream random(StreamKey("paper's laws"));
        for (int i = 0; i < 400; ++i) {
          if (i % 25 == 0) chain.BeginControlStep(i / 25, i > 100 && i < 300);
          chain.BeginSubStep(kStep);
          Vector7 asked, gravity, dq;
          for (int j = 0; j < 7; ++j) {
            asked[j] = random.Uniform(-14, 14), gravity[j] = random.Uniform(-20, 20);
            dq[j] = random.Uniform(-0.4, 0.4);
          }
          q += kStep * dq;
          const Vector7 load =
              TorqueOf(chain, asked, gravity, {.dq = dq, .limit = Vector7::Constant(limit)});
          const Vector7 change = MoveErrors(chain, q, load, kStep);
          const auto moments = MomentsOf(q, dq, gravity, kStep);
          for (int j = 0; j < 7; ++j) {
            const JointErrorParameters& p = chain.severity().parameters()[j];
            ASSERT_EQ(load[j], plain[j].Torque(scenario, options, p, asked[j], moments[j], limit))
                << name << " step " << i << " joint " << j + 1;
            ASSERT_EQ(change[j], plain[j].Change(scenario, p, q[j], load[j])) << name;
          }
          q += change;
        }
      }
    }
  }
}

// Joints of constant masses at rest, on which nothing else acts.
template <int n>
struct AtRest {
  using Vector = Eigen::Matrix<double, n, 1>;
  using Inverse = Eigen::Matrix<double, n, n>;
  Inverse M;
  double rest = 0, h = kStep;
  Vector Limited(const Vector& torque) const { return torque; }
  Vector Net(const Vector& torque) const { return torque; }
  Inverse MassMatrix() const { return M; }
  Vector Velocities() const { return Vector::Zero(); }
};

TEST(JointChain, FrictionThatSticksIsOneProblemOfAllJoints) {
  JointChain chain(2);
  chain.SetScenario(At(0, {{"stribeck_friction", {3, 3, 0.1, 0}}}), 1);
  std::vector<JointMoment> moments(2);
  for (JointMoment& moment : moments) moment.h = kStep;
  chain.Reset(moments);
  AtRest<2> joints{.M = (Eigen::Matrix2d() << 2, 1, 1, 2).finished()};
  const Eigen::Vector2d asked(0, 2), none(0, 0);
  // M^-1 (f, 2) leaves joint 1 at rest where f = 1, although only joint 2 is driven.
  const Eigen::Vector2d torque = SubStepTorque(chain, absl::MakeSpan(moments), asked, none, joints);
  EXPECT_NEAR(torque[0], 1, 1e-9);
  EXPECT_NEAR(torque[1], 2, 1e-12);
  // Held as on a rest, both stand still.
  joints.rest = 50;
  EXPECT_NEAR(SubStepTorque(chain, absl::MakeSpan(moments), asked, none, joints).norm(), 0, 1e-9);
}

TEST(JointChain, AddedInertiaTakesTheTorqueThatAcceleratesIt) {
  JointChain chain(1);
  chain.SetScenario(At(0, {{"payload", {2}}}), 1);
  JointMoment moment;
  moment.payload_inertia = 0.5;  // of 1 kg; with 2 kg the joint is twice as heavy
  using Vector1 = AtRest<1>::Vector;
  const AtRest<1> joint{.M = AtRest<1>::Inverse(1.0)};
  const Vector1 asked(4.0), none(0.0);
  EXPECT_NEAR(SubStepTorque(chain, {&moment, 1}, asked, none, joint)[0], 2, 1e-12);
}

}  // namespace
}  // namespace robostress
