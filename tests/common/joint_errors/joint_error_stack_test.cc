#include "common/joint_errors/joint_error_stack.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/joint_errors/friction.h"

namespace robostress {
namespace {

using Vector = JointErrorStack::Vector;
constexpr double kStep = 0.002;
const Vector kLimit = (Vector() << 80, 80, 80, 80, 80, 12, 12).finished();

JointErrorStack Make(const std::string& scenario, const JointErrorOptions& options = {},
                     int level = 5) {
  JointErrorStack stack(options);
  stack.SetScenario(MakeScenario(scenario, level).value(), 100);
  stack.Reset(Vector::Zero(), Vector::Zero());
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  return stack;
}

TEST(JointErrorStack, CleanChangesNothingButSaturates) {
  JointErrorStack stack = Make("clean");
  const Vector torque = Vector::Constant(11), dq = Vector::Constant(0.1);
  EXPECT_EQ(stack.PerturbTorque(torque, dq, torque, kLimit), torque);
  EXPECT_EQ(stack.OffsetChange(Vector::Constant(0.3), torque), Vector::Zero());
  EXPECT_FALSE(stack.any());
  EXPECT_EQ(stack.PerturbTorque(Vector::Constant(100), dq, torque, kLimit), kLimit);
}

TEST(JointErrorStack, SaturatesTheSumAndNotTheControllerAlone) {
  JointErrorStack stack = Make("isolated_gravity");
  // 90 + 0.4 * (-50) = 70 on J2. Saturating the controller first would give 80 - 20 = 60.
  Vector torque = Vector::Zero(), gravity = Vector::Zero();
  torque[1] = 90;
  gravity[1] = -50;
  EXPECT_DOUBLE_EQ(stack.PerturbTorque(torque, Vector::Zero(), gravity, kLimit)[1], 70);
  // And a residual that drives beyond the limit is cut.
  torque[6] = 11;
  gravity[6] = 10;  // beta 0.2
  EXPECT_DOUBLE_EQ(stack.PerturbTorque(torque, Vector::Zero(), gravity, kLimit)[6], 12);
}

TEST(JointErrorStack, ComplianceAnswersTheSameSubStepsTorque) {
  JointErrorStack stack = Make("isolated_compliance");
  const Vector load = Vector::Constant(6);
  const Vector change = stack.OffsetChange(Vector::Zero(), load);
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters& p = stack.parameters()[j];
    // A stack that is driven by the previous torque returns zero here.
    Compliance alone;
    EXPECT_DOUBLE_EQ(change[j], alone.Step(p, load[j], kStep));
    EXPECT_LT(change[j], 0);
  }
}

TEST(JointErrorStack, ComplianceIsDrivenByThePerturbedSaturatedTorque) {
  JointErrorStack stack = Make("nominal");
  const Vector dq = Vector::Constant(0.05), gravity = Vector::Constant(10),
               controller = Vector::Constant(11.9);
  const Vector load = stack.PerturbTorque(controller, dq, gravity, kLimit);
  for (int j = 0; j < 7; ++j) {
    const JointErrorParameters& p = stack.parameters()[j];
    const double sum = 11.9 + StribeckTorque(p, 0.05, FrictionLaw::kSgn, 0.01) + p.beta * 10;
    EXPECT_DOUBLE_EQ(load[j], std::clamp(sum, -kLimit[j], kLimit[j]));
  }
}

TEST(JointErrorStack, OffsetChangesAddUpToTheOffsetThatIsCarried) {
  JointErrorStack stack = Make("aged_joint_uniform");
  Vector q = Vector::Zero(), carried = Vector::Zero();
  for (int t = 0; t < 500; ++t) {
    stack.BeginSubStep(kStep);
    const Vector change = stack.OffsetChange(q, Vector::Constant(8 * std::sin(0.02 * t)));
    carried += change;
    q += change +
         Vector::Constant(2e-4 *
                          std::cos(0.01 * t));  // the joint coordinate carries the offset and moves
    EXPECT_LT((carried - stack.offset()).cwiseAbs().maxCoeff(), 1e-12);
    // |eta_back| <= B and |eta_comp| of the order tau / K: an offset that accumulates would leave
    // this range.
    for (int j = 0; j < 7; ++j) {
      EXPECT_LT(std::abs(stack.offset()[j]),
                stack.parameters()[j].B + 1.5 * 8 / stack.parameters()[j].K);
    }
  }
}

TEST(JointErrorStack, BacklashSeesTheMotorAngle) {
  // A motor that moves steadily: its link trails by exactly B, whatever the joint coordinate's own
  // offset. A stack that feeds the joint coordinate back as the motor angle sees it retreat by the
  // offset, and trails by less.
  JointErrorStack stack = Make("isolated_backlash");
  Vector q = Vector::Zero(), motor = Vector::Zero();
  for (int t = 0; t < 400; ++t) {
    const Vector change = stack.OffsetChange(q, Vector::Zero());
    q += change;
    EXPECT_LT((q - motor - stack.offset()).cwiseAbs().maxCoeff(), 1e-12);
    motor += Vector::Constant(1e-4);
    q += Vector::Constant(1e-4);
  }
  for (int j = 0; j < 7; ++j) EXPECT_NEAR(stack.offset()[j], -stack.parameters()[j].B, 1e-9);
  // After a reversal the link stands still until the motor has crossed the gap: the joint
  // coordinate does not move.
  const double stands_at = q[0];
  for (int t = 0; t < 200; ++t) {
    motor -= Vector::Constant(1e-4);
    q -= Vector::Constant(1e-4);
    q += stack.OffsetChange(q, Vector::Zero());
  }
  EXPECT_NEAR(q[0], stands_at, 1.1e-4);  // 200 * 1e-4 < 2 B = 0.0261
}

TEST(JointErrorStack, RampsOverTheHorizonAndStartsAtProgressZero) {
  JointErrorStack stack = Make("thermal_drift_backlash");
  for (const auto& [step, factor] :
       std::vector<std::pair<int, double>>{{0, 5}, {25, 7.5}, {50, 10}, {100, 15}, {180, 15}}) {
    stack.BeginControlStep(step, false);
    stack.BeginSubStep(kStep);
    EXPECT_DOUBLE_EQ(stack.factors()[2].backlash, factor) << step;
    EXPECT_EQ(stack.factors()[2].friction, 1);
  }
}

TEST(JointErrorStack, PayloadRampsInWithTheGraspAndIsNominalBefore) {
  JointErrorStack payload = Make("heavy_payload"), nominal = Make("nominal");
  for (int j = 0; j < 7; ++j) {
    EXPECT_EQ(payload.parameters()[j].K, nominal.parameters()[j].K);
    EXPECT_EQ(payload.parameters()[j].beta, nominal.parameters()[j].beta);
  }
  payload.BeginControlStep(10, true);
  for (int i = 1; i <= 25; ++i) {
    payload.BeginSubStep(kStep);
    EXPECT_NEAR(payload.factors()[0].gravity, 1 + 3 * 0.02 * i, 1e-12);
    EXPECT_NEAR(payload.factors()[0].compliance, 1 + 4 * 0.02 * i, 1e-12);
  }
  payload.Reset(Vector::Zero(), Vector::Zero());
  payload.BeginControlStep(0, false);
  payload.BeginSubStep(kStep);
  EXPECT_EQ(payload.factors()[0].gravity, 1);  // the gate does not survive the episode
}

TEST(JointErrorStack, ResetStartsHiddenStatesAnew) {
  JointErrorStack stack = Make("aged_joint_uniform"), fresh = Make("aged_joint_uniform");
  for (int t = 0; t < 100; ++t) stack.OffsetChange(Vector::Constant(1e-3 * t), Vector::Constant(5));
  EXPECT_GT(stack.offset().norm(), 0);
  const Vector q0 = Vector::Constant(0.2);
  stack.Reset(q0, Vector::Zero());
  fresh.Reset(q0, Vector::Zero());
  EXPECT_EQ(stack.offset(), Vector::Zero());
  for (int t = 0; t < 50; ++t) {
    const Vector q = q0 + Vector::Constant(1e-3 * t), load = Vector::Constant(3);
    EXPECT_EQ(stack.OffsetChange(q, load), fresh.OffsetChange(q, load));
  }
}

TEST(JointErrorStack, EquilibriumStartCarriesTheStaticDeflectionFromTheBeginning) {
  JointErrorOptions options;
  options.offset_start = OffsetStart::kEquilibrium;
  JointErrorStack stack(options);
  stack.SetScenario(MakeScenario("isolated_compliance", 5).value(), 100);
  const Vector holding = Vector::Constant(12);
  stack.Reset(Vector::Zero(), holding);
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  for (int j = 0; j < 7; ++j) EXPECT_DOUBLE_EQ(stack.offset()[j], -12 / stack.parameters()[j].K);
  // Under the same load it stays: no transient.
  EXPECT_LT(stack.OffsetChange(Vector::Zero(), holding).cwiseAbs().maxCoeff(), 1e-16);
}

TEST(JointErrorStack, AnEquilibriumStartIsInTheMiddleOfTheGap) {
  JointErrorOptions options;
  options.offset_start = OffsetStart::kEquilibrium;
  JointErrorStack stack(options);
  stack.SetScenario(MakeScenario("aged_joint_uniform", 5).value(), 100);
  const Vector holding = Vector::Constant(60), q = Vector::Constant(0.4);
  stack.Reset(q, holding);
  stack.BeginControlStep(0, false);
  stack.BeginSubStep(kStep);
  for (int j = 0; j < 7; ++j) EXPECT_EQ(stack.backlash_offset(j), 0);
  EXPECT_LT(stack.OffsetChange(q, holding).cwiseAbs().maxCoeff(), 1e-16);
}

TEST(JointErrorStack, StickFrictionDoesNotMakeTheMotorStronger) {
  JointErrorStack stack = Make("isolated_stribeck");
  const JointErrorStack::Matrix free = 1e-3 * JointErrorStack::Matrix::Identity();
  for (const double sign : {1.0, -1.0}) {
    // A joint that is pushed backwards is held by friction, beyond what the motor has left.
    const Vector torque = sign * kLimit, v_free = Vector::Constant(-sign);
    EXPECT_EQ(stack.AddStickFriction(torque, Vector::Zero(), v_free, free, kLimit), sign * kLimit);
  }
}

}  // namespace
}  // namespace robostress
