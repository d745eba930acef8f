// The paper's four errors in a chain: their order, their course over an episode, their hidden
// states.
#include <gtest/gtest.h>

#include <cmath>

#include "common/joint_errors/effects/compliance.h"
#include "common/joint_errors/effects/friction.h"
#include "tests/common/joint_errors/free_joints.h"

namespace robostress {
namespace {

using Vector = Vector7;
constexpr double kStep = 0.002;
const Vector kLimit = (Vector() << 80, 80, 80, 80, 80, 12, 12).finished();

JointChain Make(const std::string& scenario, const JointErrorOptions& options = {}, int level = 5) {
  JointChain stack(7, options);
  stack.SetScenario(MakeScenario(scenario, level).value(), 100);
  ResetAt(stack, Vector::Zero(), Vector::Zero());
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  return stack;
}

TEST(PaperErrors, CleanChangesNothingButSaturates) {
  JointChain stack = Make("clean");
  const Vector torque = Vector::Constant(11), dq = Vector::Constant(0.1);
  EXPECT_EQ(TorqueOf(stack, torque, torque, {.dq = dq, .limit = kLimit}), torque);
  EXPECT_EQ(MoveErrors(stack, Vector::Constant(0.3), torque), Vector::Zero());
  EXPECT_FALSE(stack.has(EffectStage::kJoint) || stack.has(EffectStage::kTransmission));
  EXPECT_EQ(TorqueOf(stack, Vector::Constant(100), torque, {.dq = dq, .limit = kLimit}), kLimit);
}

TEST(PaperErrors, SaturatesTheSumAndNotTheControllerAlone) {
  JointChain stack = Make("isolated_gravity");
  // 90 + 0.4 * (-50) = 70 on J2. Saturating the controller first would give 80 - 20 = 60.
  Vector torque = Vector::Zero(), gravity = Vector::Zero();
  torque[1] = 90;
  gravity[1] = -50;
  EXPECT_DOUBLE_EQ(TorqueOf(stack, torque, gravity, {.dq = Vector::Zero(), .limit = kLimit})[1],
                   70);
  // And a residual that drives beyond the limit is cut.
  torque[6] = 11;
  gravity[6] = 10;  // beta 0.2
  EXPECT_DOUBLE_EQ(TorqueOf(stack, torque, gravity, {.dq = Vector::Zero(), .limit = kLimit})[6],
                   12);
}

TEST(PaperErrors, ComplianceAnswersTheSameSubStepsTorque) {
  JointChain stack = Make("isolated_compliance");
  const Vector load = Vector::Constant(6);
  const Vector change = MoveErrors(stack, Vector::Zero(), load);
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters& p = stack.severity().parameters()[j];
    // A stack that is driven by the previous torque returns zero here.
    Compliance alone;
    EXPECT_DOUBLE_EQ(change[j], alone.Step(p, load[j], kStep));
    EXPECT_LT(change[j], 0);
  }
}

TEST(PaperErrors, ComplianceIsDrivenByThePerturbedSaturatedTorque) {
  JointChain stack = Make("nominal");
  const Vector dq = Vector::Constant(0.05), gravity = Vector::Constant(10),
               controller = Vector::Constant(11.9);
  const Vector load = TorqueOf(stack, controller, gravity, {.dq = dq, .limit = kLimit});
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters& p = stack.severity().parameters()[j];
    const double sum = 11.9 + StribeckTorque(p, 0.05, FrictionLaw::kSgn, 0.01) + p.beta * 10;
    EXPECT_DOUBLE_EQ(load[j], std::clamp(sum, -kLimit[j], kLimit[j]));
  }
}

TEST(PaperErrors, OffsetChangesAddUpToTheOffsetThatIsCarried) {
  JointChain stack = Make("aged_joint_uniform");
  Vector q = Vector::Zero(), carried = Vector::Zero();
  for (int t = 0; t < 500; ++t) {
    stack.BeginSubStep(kStep);
    const Vector change = MoveErrors(stack, q, Vector::Constant(8 * std::sin(0.02 * t)));
    carried += change;
    q += change +
         Vector::Constant(2e-4 *
                          std::cos(0.01 * t));  // the joint coordinate carries the offset and moves
    EXPECT_LT((carried - OffsetOf(stack)).cwiseAbs().maxCoeff(), 1e-12);
    // |eta_back| <= B and |eta_comp| of the order tau / K: an offset that accumulates would leave
    // this range.
    for (int j = 0; j < 7; ++j) {
      EXPECT_LT(std::abs(stack.offset(j)),
                stack.severity().parameters()[j].B + 1.5 * 8 / stack.severity().parameters()[j].K);
    }
  }
}

TEST(PaperErrors, BacklashSeesTheMotorAngle) {
  // A motor that moves steadily: its link trails by exactly B, whatever the joint coordinate's own
  // offset. A stack that feeds the joint coordinate back as the motor angle sees it retreat by the
  // offset, and trails by less.
  JointChain stack = Make("isolated_backlash");
  Vector q = Vector::Zero(), motor = Vector::Zero();
  for (int t = 0; t < 400; ++t) {
    const Vector change = MoveErrors(stack, q, Vector::Zero());
    q += change;
    EXPECT_LT((q - motor - OffsetOf(stack)).cwiseAbs().maxCoeff(), 1e-12);
    motor += Vector::Constant(1e-4);
    q += Vector::Constant(1e-4);
  }
  for (int j = 0; j < 7; ++j)
    EXPECT_NEAR(stack.offset(j), -stack.severity().parameters()[j].B, 1e-9);
  // After a reversal the link stands still until the motor has crossed the gap: the joint
  // coordinate does not move.
  const double stands_at = q[0];
  for (int t = 0; t < 200; ++t) {
    motor -= Vector::Constant(1e-4);
    q -= Vector::Constant(1e-4);
    q += MoveErrors(stack, q, Vector::Zero());
  }
  EXPECT_NEAR(q[0], stands_at, 1.1e-4);  // 200 * 1e-4 < 2 B = 0.0261
}

TEST(PaperErrors, RampsOverTheHorizonAndStartsAtProgressZero) {
  JointChain stack = Make("thermal_drift_backlash");
  for (const auto& [step, factor] :
       std::vector<std::pair<int, double>>{{0, 5}, {25, 7.5}, {50, 10}, {100, 15}, {180, 15}}) {
    stack.BeginControlStep(step, false);
    stack.BeginSubStep(kStep);
    EXPECT_DOUBLE_EQ(stack.severity().factors()[2].backlash, factor) << step;
    EXPECT_EQ(stack.severity().factors()[2].friction, 1);
  }
}

TEST(PaperErrors, PayloadRampsInWithTheGraspAndIsNominalBefore) {
  JointChain payload = Make("heavy_payload"), nominal = Make("nominal");
  for (int j = 0; j < 7; ++j) {
    EXPECT_EQ(payload.severity().parameters()[j].K, nominal.severity().parameters()[j].K);
    EXPECT_EQ(payload.severity().parameters()[j].beta, nominal.severity().parameters()[j].beta);
  }
  payload.BeginControlStep(10, true);
  for (int i = 1; i <= 25; ++i) {
    payload.BeginSubStep(kStep);
    EXPECT_NEAR(payload.severity().factors()[0].gravity, 1 + 3 * 0.02 * i, 1e-12);
    EXPECT_NEAR(payload.severity().factors()[0].compliance, 1 + 4 * 0.02 * i, 1e-12);
  }
  ResetAt(payload, Vector::Zero(), Vector::Zero());
  payload.BeginControlStep(0, false);
  payload.BeginSubStep(kStep);
  EXPECT_EQ(payload.severity().factors()[0].gravity, 1);  // the gate does not survive the episode
}

TEST(PaperErrors, ResetStartsHiddenStatesAnew) {
  JointChain stack = Make("aged_joint_uniform"), fresh = Make("aged_joint_uniform");
  for (int t = 0; t < 100; ++t) MoveErrors(stack, Vector::Constant(1e-3 * t), Vector::Constant(5));
  EXPECT_GT(OffsetOf(stack).norm(), 0);
  const Vector q0 = Vector::Constant(0.2);
  ResetAt(stack, q0, Vector::Zero());
  ResetAt(fresh, q0, Vector::Zero());
  EXPECT_EQ(OffsetOf(stack), Vector::Zero());
  for (int t = 0; t < 50; ++t) {
    const Vector q = q0 + Vector::Constant(1e-3 * t), load = Vector::Constant(3);
    EXPECT_EQ(MoveErrors(stack, q, load), MoveErrors(fresh, q, load));
  }
}

TEST(PaperErrors, EquilibriumStartCarriesTheStaticDeflectionFromTheBeginning) {
  JointErrorOptions options;
  options.offset_start = OffsetStart::kEquilibrium;
  JointChain stack(7, options);
  stack.SetScenario(MakeScenario("isolated_compliance", 5).value(), 100);
  const Vector holding = Vector::Constant(12);
  ResetAt(stack, Vector::Zero(), holding);
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  for (int j = 0; j < 7; ++j)
    EXPECT_DOUBLE_EQ(stack.offset(j), -12 / stack.severity().parameters()[j].K);
  // Under the same load it stays: no transient.
  EXPECT_LT(MoveErrors(stack, Vector::Zero(), holding).cwiseAbs().maxCoeff(), 1e-16);
}

TEST(PaperErrors, AnEquilibriumStartIsInTheMiddleOfTheGap) {
  JointErrorOptions options;
  options.offset_start = OffsetStart::kEquilibrium;
  JointChain stack(7, options);
  stack.SetScenario(MakeScenario("aged_joint_uniform", 5).value(), 100);
  const Vector holding = Vector::Constant(60), q = Vector::Constant(0.4);
  ResetAt(stack, q, holding);
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  for (int j = 0; j < 7; ++j) EXPECT_EQ(stack.error_offset(kPaperBacklash, j), 0);
  EXPECT_LT(MoveErrors(stack, q, holding).cwiseAbs().maxCoeff(), 1e-16);
}

TEST(PaperErrors, StickFrictionDoesNotMakeTheMotorStronger) {
  JointErrorOptions options;
  options.friction_law = FrictionLaw::kStick;
  JointChain stack = Make("isolated_stribeck", options);
  for (const double sign : {1.0, -1.0}) {
    // A joint that is pushed backwards is held by friction, beyond what the motor has left.
    const Vector torque = sign * kLimit;
    FreeJoints joints{.limit = kLimit, .pulled = Vector::Constant(-sign * 500)};
    EXPECT_EQ(TorqueOf(stack, torque, Vector::Zero(), joints), sign * kLimit);
  }
}

}  // namespace
}  // namespace robostress
