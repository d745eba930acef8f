#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "calibration/model/joint_simulation.h"

namespace robostress::calibration {
namespace {

// A joint without gravity: M ddq = torque - d dq, driven by a constant torque from rest.
struct Coasting {
  explicit Coasting(double dt) {
    log.dt = dt, log.rows = static_cast<int>(std::lround(1 / dt));
    JointRecord record;
    record.tau.assign(log.rows, 1.0);
    record.q.assign(log.rows, 0.0);
    record.q_smooth = record.dq = record.ddq = record.q;
    log.joints = {record};
    track.log = &log;
    track.single = true;
    PlantRow row;
    row.inertia = 0.1;
    track.rows = {row};
    model.input = JointInput::kTorque;
  }
  std::vector<double> Predict() {
    std::vector<double> predicted(log.rows);
    JointSimulation(track).Predict(model, 0, {}, {}, absl::MakeSpan(predicted));
    return predicted;
  }
  MeasuredLog log;
  JointTrack track;
  JointModel model;
};

TEST(KernelAccuracy, DampedMotionFollowsItsClosedFormToSecondOrder) {
  // v = (1 - e^-rt) / d, r = d / M = 40 1/s: an implicit Euler step would be 1e-4 off.
  const auto worst = [](double dt) {
    Coasting joint(dt);
    joint.model.damping = 4;
    const std::vector<double> q = joint.Predict();
    double error = 0;
    for (int k = 0; k < joint.log.rows; ++k) {
      const double t = k * dt, r = 40;
      error = std::max(error, std::abs(q[k] - (t - (1 - std::exp(-r * t)) / r) / 4));
    }
    return error;
  };
  EXPECT_LT(worst(1e-3), 1e-6);
  // A quarter at half the step.
  EXPECT_NEAR(worst(5e-4) / worst(1e-3), 0.25, 0.05);
}

TEST(KernelAccuracy, HeavyDampingNeitherRingsNorGrows) {
  Coasting joint(1e-3);
  joint.model.damping = 5000;  // h d / M = 50
  const std::vector<double> q = joint.Predict();
  for (int k = 1; k < joint.log.rows; ++k) EXPECT_GE(q[k], q[k - 1]);
  EXPECT_NEAR(q.back(), 1.0 / 5000, 0.05 / 5000);
}

TEST(KernelAccuracy, DryFrictionStopsAJointWhereItsEnergyIsSpent) {
  Coasting joint(1e-3);
  for (int k = 300; k < joint.log.rows; ++k) joint.log.joints[0].tau[k] = 0;
  joint.model.frictionloss = 0.4;
  const std::vector<double> q = joint.Predict();
  // 0.6 Nm over 0.3 s, then friction alone until rest: way 0.6 / 0.4 of the way before.
  const double way = 0.5 * (0.6 / 0.1) * 0.3 * 0.3;
  EXPECT_NEAR(q.back(), way * (1 + 0.6 / 0.4), 2e-3 * way);
  EXPECT_EQ(q[joint.log.rows - 1], q[joint.log.rows - 100]) << "creeps";
}

// M ddq = 1 - c - r (s - 1/2) over a row from rest: q = T^2 / M ((1 - c) / 2 + r / 12).
TEST(KernelAccuracy, WhatOtherJointsPushRisesWithinARow) {
  Coasting joint(1e-2);
  joint.track.single = false;
  joint.track.rows.assign(joint.log.rows, joint.track.rows[0]);
  for (PlantRow& row : joint.track.rows) row.coupling = 0.4, row.coupling_rise = 3;
  EXPECT_NEAR(joint.Predict()[1], 1e-4 / 0.1 * (0.6 / 2 + 3.0 / 12), 3e-6);
  // The same of a partner's acceleration, whose inertia an effect adds.
  for (PlantRow& row : joint.track.rows) row.coupling = row.coupling_rise = 0;
  JointRecord partner = joint.log.joints[0];
  partner.motion = {partner.q, partner.q, std::vector<double>(joint.log.rows, 4.0),
                    std::vector<double>(joint.log.rows, 30.0)};
  joint.log.joints.push_back(partner);
  joint.model.effects = {{*FindEffect("cross_joint_inertia"), {0.1}, 1}};
  EXPECT_NEAR(joint.Predict()[1], 1e-4 / 0.1 * (0.6 / 2 + 3.0 / 12), 3e-6);
}

TEST(KernelAccuracy, AModelThatRunsAwayStaysANumber) {
  Coasting joint(1e-3);
  EffectInstance cubic;
  cubic.info = *FindEffect("position_dependent_torque");
  cubic.values = {0, 0, 1e9};
  joint.model.effects = {cubic};
  for (const double q : joint.Predict()) EXPECT_TRUE(std::isfinite(q));
}

// Far from its target a servo gives its limit, and the joint what that accelerates it by.
TEST(KernelAccuracy, AServoGivesNoMoreThanItsLimit) {
  Coasting joint(1e-3);
  joint.log.joints[0].command.assign(joint.log.rows, 1e3);
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 50;
  joint.model.servo.torque_limit = 2;
  const std::vector<double> q = joint.Predict();
  const double t = (joint.log.rows - 1) * joint.log.dt;
  EXPECT_NEAR(q.back(), 0.5 * (2 / 0.1) * t * t, 1e-3);
}

// At full voltage V a motor ends at the speed whose back EMF is V: dq = V / kt (1 - e^-rt),
// r = kt^2 / (R M).
TEST(KernelAccuracy, AMotorAtFullVoltageEndsAtItsNoLoadSpeed) {
  Coasting joint(1e-3);
  joint.log.joints[0].command.assign(joint.log.rows, 1e3);
  joint.model.input = JointInput::kPositionTarget;
  Servo& servo = joint.model.servo;
  servo.type = Servo::Type::kDcMotor;
  servo.kp = 100, servo.vin = 12, servo.kt = 1.5, servo.R = 2;
  const std::vector<double> q = joint.Predict();
  const double t = (joint.log.rows - 1) * joint.log.dt;
  const double r = servo.kt * servo.kt / (servo.R * 0.1);
  EXPECT_NEAR(q.back(), servo.vin / servo.kt * (t - (1 - std::exp(-r * t)) / r), 1e-3);
}

// At its limit a motor damps no motion; within it the servo's kd does.
TEST(KernelAccuracy, ADriveAtItsLimitDampsNothing) {
  Coasting joint(1e-3);
  joint.log.joints[0].command.assign(joint.log.rows, 1e3);
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 50;
  joint.model.servo.kd = 40;
  joint.model.effects = {{*FindEffect("torque_saturation"), {2}}};
  const std::vector<double> q = joint.Predict();
  const double t = (joint.log.rows - 1) * joint.log.dt;
  EXPECT_NEAR(q.back(), 0.5 * (2 / 0.1) * t * t, 1e-3);
}

// A stiff servo follows a limited command; where a sub-step ends it would be half of one ahead.
TEST(KernelAccuracy, AServoGetsTheMeanOfALimitedCommandOverASubStep) {
  Coasting joint(1e-3);
  joint.log.joints[0].command.assign(joint.log.rows, 1e3);
  joint.log.joints[0].command[0] = 0;
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 1000;
  joint.model.servo.kd = 20;
  joint.model.effects = {{*FindEffect("rate_limit"), {2}}};
  const std::vector<double> q = joint.Predict();
  // At constant speed it stays behind by kd / kp of it.
  const double t = (joint.log.rows - 2) * joint.log.dt;  // that it has moved
  EXPECT_NEAR(q.back(), 2 * (t - 20.0 / 1000), 2e-5);
}

// Sent between rows as a curve that the limit is above, or held and late by part of a row.
TEST(KernelAccuracy, ALimitThatIsNotReachedChangesNoCommand) {
  for (const bool continuous : {true, false}) {
    Coasting joint(1e-3);
    std::vector<double>& command = joint.log.joints[0].command;
    for (int k = 0; k < joint.log.rows; ++k) command.push_back(0.1 * std::sin(0.02 * k));
    joint.model.input = JointInput::kPositionTarget;
    joint.model.servo.kp = 1000;
    joint.model.servo.kd = 20;
    joint.model.continuous_command = continuous;
    joint.model.command_shift = 0.375;
    const std::vector<double> free = joint.Predict();
    joint.model.effects = {{*FindEffect("rate_limit"), {continuous ? 3.0 : 1e4}}};
    const std::vector<double> limited = joint.Predict();
    // What jumps is up to half a part of a sub-step late, at 2 rad/s.
    const double within = continuous ? 1e-5 : 2 * 1e-3 / 16 + 1e-6;
    for (int k = 0; k < joint.log.rows; ++k) EXPECT_NEAR(limited[k], free[k], within) << k;
  }
}

// Two encoders; the motor swings as a cosine, read at `dt`.
struct BetweenEncoders : Coasting {
  static constexpr double kOmega = 20;
  explicit BetweenEncoders(double dt, const std::string& effect, std::vector<double> values)
      : Coasting(dt) {
    model.input = JointInput::kTransmission;
    model.effects = {{*FindEffect(effect), std::move(values)}};
    JointRecord& record = log.joints[0];
    record.tau.clear();
    for (int k = 0; k < log.rows; ++k) record.q_motor.push_back(std::cos(kOmega * k * dt));
  }
};

TEST(KernelAccuracy, ALagBetweenEncodersIsThatOfTheMotionAndNotOfItsRows) {
  BetweenEncoders joint(4e-3, "servo_lag", {0.01});
  const std::vector<double> q = joint.Predict();
  const double late = 0.01 * joint.kOmega, size = 1 / std::sqrt(1 + late * late);
  for (int k = 50; k + 2 < joint.log.rows; ++k)
    EXPECT_NEAR(q[k], size * std::cos(joint.kOmega * k * 4e-3 - std::atan(late)), 1e-4) << k;
}

TEST(KernelAccuracy, ADelayBetweenEncodersFollowsTheCurveBetweenRows) {
  BetweenEncoders joint(4e-3, "transport_delay", {0.0062});
  const std::vector<double> q = joint.Predict();
  for (int k = 5; k + 2 < joint.log.rows; ++k)
    EXPECT_NEAR(q[k], std::cos(joint.kOmega * (k * 4e-3 - 0.0062)), 1e-4) << k;
}

TEST(KernelAccuracy, AGapBetweenEncodersIsTakenUpWhereTheMotorTurnsBetweenRows) {
  BetweenEncoders joint(1.7e-2, "backlash", {0.1});
  const std::vector<double> q = joint.Predict();
  const auto largest = std::max_element(q.begin() + 10, q.end());
  EXPECT_NEAR(*largest, 0.9, 2e-3);  // the largest reading of the motor is up to 0.014 less
  EXPECT_NEAR(*std::min_element(q.begin() + 10, q.end()), -0.9, 2e-3);
}

// Runs that begin within a motion of the same model, of which its link alone is read.
// smoothed: rows each side that the velocity is a mean over, which rounds corners.
void ExpectRunsGoOnBehind(const std::string& effect, std::vector<double> values, double within,
                          int smoothed = 1, double omega = 0.012) {
  Coasting joint(2e-3);
  joint.log.rows = 1000;
  JointRecord& record = joint.log.joints[0];
  record.tau.clear();
  record.q.assign(1000, 0);
  record.q_smooth = record.dq = record.ddq = record.q;
  for (int k = 0; k < 1000; ++k) record.command.push_back(0.5 * (1 - std::cos(omega * k)));
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 40;
  joint.model.servo.kd = 3;
  joint.model.effects = {{*FindEffect(effect), std::move(values)}};
  std::vector<double> whole(1000), runs(1000);
  JointSimulation(joint.track).Predict(joint.model, 0, {}, {}, absl::MakeSpan(whole));
  record.q = record.q_smooth = whole;
  for (int k = smoothed; k + smoothed < 1000; ++k)
    record.dq[k] = (whole[k + smoothed] - whole[k - smoothed]) / (smoothed * 4e-3);
  JointSimulation(joint.track).Predict(joint.model, 100, {}, {}, absl::MakeSpan(runs));
  for (int k = 200; k + 1 < 1000; ++k) EXPECT_NEAR(runs[k], whole[k], within) << k;
}

TEST(KernelAccuracy, ARunBehindAWaveOfTheTransmissionBeginsWhereTheMotorIs) {
  ExpectRunsGoOnBehind("transmission_error", {0.02, -0.01, 0.3}, 5e-4);
}

TEST(KernelAccuracy, ARunBehindASoftTransmissionBeginsWhereTheMotorIs) {
  ExpectRunsGoOnBehind("compliance", {60, 9, 0.6}, 1e-3);
}

TEST(KernelAccuracy, ARunInAGapBeginsWhereTheMotorTurnedRoundBefore) {
  ExpectRunsGoOnBehind("backlash", {0.02}, 1e-4, 6, 0.0127);
}

// A servo that reads the link of a motor which crosses a gap, by sub-steps of 1 ms and of 0.1 ms.
TEST(KernelAccuracy, AServoReadsALinkThatStandsWhileItsMotorCrossesAGap) {
  std::vector<double> q[2];
  for (int fine = 0; fine < 2; ++fine) {
    const double dt = fine ? 1e-4 : 1e-3;
    Coasting joint(dt);
    for (int k = 0; k < joint.log.rows; ++k)
      joint.log.joints[0].command.push_back(0.5 * (1 - std::cos(12 * k * dt)));
    joint.model.input = JointInput::kPositionTarget;
    joint.model.servo.kp = 160;
    joint.model.servo.kd = 4;
    joint.model.servo.feedback = ServoFeedback::kLink;
    joint.model.frictionloss = 0.5;
    joint.model.continuous_command = true;
    joint.model.effects = {{*FindEffect("backlash"), {0.01}}};
    q[fine] = joint.Predict();
  }
  for (int k = 0; k < 1000; ++k) EXPECT_NEAR(q[0][k], q[1][10 * k], 5e-5) << k;
}

// Half a row late is 0.02 rad here.
TEST(KernelAccuracy, ACommandGoesOnBetweenRowsWhereTheModelSaysSo) {
  Coasting joint(1e-2);
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 1000;
  joint.model.servo.kd = 20;
  for (int k = 0; k < joint.log.rows; ++k)
    joint.log.joints[0].command.push_back(std::cos(4 * k * 1e-2));
  joint.model.continuous_command = true;
  const std::vector<double> q = joint.Predict();
  // 0.1 ddq = kp (c - q) - kd dq of c = cos 4t.
  const double in_phase = 1000 - 0.1 * 16, behind = 20 * 4;
  const double size = 1000 / std::hypot(in_phase, behind), late = std::atan2(behind, in_phase);
  for (int k = 50; k + 2 < joint.log.rows; ++k)
    EXPECT_NEAR(q[k], size * std::cos(4 * k * 1e-2 - late), 1e-4) << k;
}

TEST(KernelAccuracy, AKnownMassIsMovedAndHeld) {
  Coasting joint(1e-3);
  joint.log.joints[0].command.assign(joint.log.rows, 0);
  joint.model.input = JointInput::kPositionTarget;
  joint.model.servo.kp = 100;
  joint.model.servo.kd = 10;
  joint.track.rows[0].payload_inertia = 0.25;
  joint.track.rows[0].payload_gravity.c = 4;
  joint.track.known_mass = 0.5;
  EXPECT_NEAR(joint.Predict().back(), -0.5 * 4 / 100, 1e-6);
}

TEST(KernelAccuracy, ADriveThatIsOffGivesNothing) {
  Coasting joint(1e-3);
  joint.log.joints[0].enable.assign(joint.log.rows, 1.0);
  for (int k = 300; k < joint.log.rows; ++k) joint.log.joints[0].enable[k] = 0;
  const std::vector<double> q = joint.Predict();
  // Speed stays at 1 Nm / 0.1 kg m^2 * 0.3 s.
  EXPECT_NEAR((q[900] - q[400]) / 0.5, 3.0, 1e-6);
}

// A motor swings by torque alone and drags the link through a gap. Windows that begin within the
// gap know neither from the link's reading.
void ExpectRunsFromWithinAGap(bool velocity_of_motor) {
  constexpr double kOmega = 2 * M_PI, kHalfWidth = 0.05;
  Coasting joint(1e-3);
  JointRecord& record = joint.log.joints[0];
  record.velocity_of_motor = velocity_of_motor;
  double link = 0;
  int within = 0;
  for (int k = 0; k < joint.log.rows; ++k) {
    const double t = k * 1e-3, before = link;
    const double motor = 10 / (kOmega * kOmega) * (1 - std::cos(kOmega * t));
    link = std::clamp(link, motor - kHalfWidth, motor + kHalfWidth);
    within += k > 100 && link == before;
    record.tau[k] = std::cos(kOmega * (t + 5e-4));
    record.q[k] = record.q_smooth[k] = link;
    const double speed = 10 / kOmega * std::sin(kOmega * t);
    record.dq[k] = velocity_of_motor || link != before ? speed : 0;
  }
  ASSERT_GT(within, 120);
  EffectInstance gap;
  gap.info = *FindEffect("backlash");
  gap.values = {kHalfWidth};
  joint.model.effects = {gap};
  std::vector<double> predicted(joint.log.rows);
  JointSimulation(joint.track).Predict(joint.model, 50, {}, {}, absl::MakeSpan(predicted));
  for (int k = 0; k < joint.log.rows; ++k)
    EXPECT_NEAR(predicted[k], record.q[k], 0.02 * 2 * kHalfWidth) << k;
}

TEST(KernelAccuracy, AMotorWithinAGapFollowsItsLoggedVelocity) { ExpectRunsFromWithinAGap(true); }

TEST(KernelAccuracy, AMotorWithinAGapFollowsTheModel) { ExpectRunsFromWithinAGap(false); }

}  // namespace
}  // namespace robostress::calibration
