#include <gtest/gtest.h>

#include <cmath>

#include "calibration/model/joint_simulation.h"
#include "calibration/search/signatures.h"
#include "common/random.h"

namespace robostress::calibration {
namespace {

constexpr double kRowTime = 0.005;  // [s]
constexpr int kLogRows = 400;
constexpr double kTooMuch = 3;  // [Nm] a torque limit that the log goes beyond

// A link of gravity 4 Nm that sways, and a torque that was logged.
struct Swaying {
  Swaying() {
    log.dt = kRowTime, log.rows = kLogRows;
    JointRecord record;
    for (int k = 0; k < kLogRows; ++k) {
      const double t = k * kRowTime, w = 2 * M_PI * 0.7;
      record.q.push_back(0.8 * std::sin(w * t));
      record.dq.push_back(0.8 * w * std::cos(w * t));
      record.ddq.push_back(-0.8 * w * w * std::sin(w * t));
      record.tau.push_back(4 * std::sin(record.q.back()) + 0.3 * record.ddq.back());
      record.temperature.push_back(25 + t);
    }
    record.q_smooth = record.q;
    record.motion = {record.q, record.dq, record.ddq};
    log.joints = {record, record};
    track.log = &log;
    PlantRow row;
    row.inertia = 0.3;
    row.gravity = {0, 4, 0};
    row.payload_gravity = {0, 3, 0};
    row.payload_inertia = 0.09;
    row.tilt_gravity = {PlantTerm{4, 0, 0}, PlantTerm{0, 4, 0}};
    track.rows = {row};
    model.input = JointInput::kInverse;
  }
  std::vector<double> Predict() {
    std::vector<double> predicted(kLogRows);
    JointSimulation(track).Predict(model, 0, {}, {}, absl::MakeSpan(predicted));
    return predicted;
  }
  JointRecord& record() { return log.joints[0]; }

  MeasuredLog log;
  JointTrack track;
  JointModel model;
};

// What a torque is predicted with may not be that torque: friction of 0.9 times the torque as it
// was logged would explain whatever was logged.
TEST(InverseLoad, NoEffectPredictsTheLoggedTorqueFromItself) {
  for (const Candidate& candidate : CandidatesFor(Swaying().model, {1}, true)) {
    const EffectInfo& effect = *candidate.effect;
    Swaying joint;
    EffectInstance instance{&effect, {}, candidate.partner};
    for (const EffectParameter& parameter : effect.parameters)
      instance.values.push_back(parameter.inverse ? kTooMuch
                                : parameter.fixed ? parameter.starts[0]
                                                  : 0.4 * parameter.upper);
    joint.model.effects = {instance};
    const std::vector<double> before = joint.Predict();
    RandomStream random(StreamKey("inverse load"));
    for (double& tau : joint.record().tau) tau *= 1 + 0.2 * random.Normal();
    const std::vector<double> after = joint.Predict();
    for (int k = 0; k < kLogRows; ++k) {
      // Beyond its limit a motor's torque does not say what was asked of it.
      const bool limited =
          effect.type == "torque_saturation" && std::abs(joint.record().tau[k]) > kTooMuch;
      if (limited) continue;
      EXPECT_EQ(before[k], after[k]) << effect.type << " row " << k;
      ASSERT_TRUE(std::isfinite(after[k])) << effect.type;
    }
  }
}

// L = T + mu |L| sgn(dq): the load in closed form, on either side.
TEST(InverseLoad, FrictionFollowsTheLoadOfTheModel) {
  Swaying joint;
  joint.model.frictionloss = 0.2;
  joint.model.effects = {{FindEffect("load_dependent_friction").value(), {0.3}}};
  const std::vector<double> predicted = joint.Predict();
  for (int k = 0; k < kLogRows; ++k) {
    const JointRecord& r = joint.record();
    const double sign = r.dq[k] > 0 ? 1 : -1;
    const double bare = 4 * std::sin(r.q[k]) + 0.3 * r.ddq[k] + 0.2 * sign;
    EXPECT_NEAR(predicted[k], bare / (1 - 0.3 * sign * (bare > 0 ? 1 : -1)), 1e-9) << k;
  }
}

// The torque that was asked for is the drive stage turned over.
TEST(InverseLoad, WhatWasAskedOfTheMotorComesBackFromItsTorque) {
  JointModel model;
  model.effects = {{FindEffect("motor_gain").value(), {-0.12}},
                   {FindEffect("time_varying_gain").value(), {0.01}},
                   {FindEffect("deadzone").value(), {0.2}},
                   {FindEffect("torque_saturation").value(), {6}}};
  const EffectChain chain(model);
  JointMoment moment;
  moment.t = 3;
  for (const double asked : {-20.0, -6.0, -1.0, 2.0, 5.0, 9.0})
    EXPECT_NEAR(chain.Asked(chain.Drive(asked, moment), asked, moment), asked, 0.012) << asked;
}

// A limit of nearly nothing, of a model whose load is nearly nothing, explains a torque no better
// than any other: the shares are compared.
TEST(InverseLoad, ATorqueLimitOfNearlyNothingExplainsNothing) {
  Swaying joint;
  joint.track.rows[0] = PlantRow();
  joint.model.frictionloss = 1e-4;
  joint.model.effects = {{FindEffect("torque_saturation").value(), {1e-4}}};
  const std::vector<double> predicted = joint.Predict();
  double left = 0, whole = 0;
  for (int k = 0; k < kLogRows; ++k) {
    left += std::pow(predicted[k] - joint.record().tau[k], 2);
    whole += std::pow(joint.record().tau[k], 2);
  }
  EXPECT_GT(left, 0.5 * whole);
}

}  // namespace
}  // namespace robostress::calibration
