// Built-in scenarios at arms that are no Panda.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/scenarios.h"
#include "robostress.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ArmErrors = std::unique_ptr<robostress_errors, decltype(&robostress_errors_free)>;

constexpr int kArmJoints = 6;

std::vector<double> PandaElbows() {
  std::vector<double> values;
  const JointErrorParameters p = NominalPandaErrors()[4];
  for (int i = 0; i < kArmJoints; ++i)
    for (const double value : {p.Fc, p.Fs, p.vs, p.sigma_v, p.B, p.M_eff, p.D, p.K, p.beta})
      values.push_back(value * (1 + 0.1 * i));
  return values;
}

class LibraryArms : public ::testing::Test {
 protected:
  robostress_code New(const char* scenario, int joints, const double* nominal, ArmErrors& handle) {
    robostress_options options;
    options.size = sizeof(options);
    robostress_options_default(&options);
    options.nominal = nominal;
    robostress_errors* made = nullptr;
    const auto code =
        robostress_errors_new(scenario, joints, &options, &made, error_, sizeof(error_));
    handle.reset(made);
    return code;
  }
  ArmErrors errors_{nullptr, robostress_errors_free};
  char error_[400] = "";
};

// A motion of `joints`: torques and offsets of the library and of the chain, bit by bit.
void ExpectChain(robostress_errors* errors, JointChain chain) {
  const auto n = static_cast<size_t>(chain.joints());
  std::vector<double> q(n, 0.1), dq(n, 0), gravity(n, 2), payload(n, 0.3), applied(n), change(n);
  robostress_moment moment = {};
  moment.size = sizeof(moment);
  moment.step = 0.002;
  moment.q = q.data();
  moment.dq = dq.data();
  moment.gravity = gravity.data();
  moment.payload_gravity = moment.payload_inertia = payload.data();
  char error[200] = "";
  ASSERT_EQ(robostress_errors_reset(errors, &moment, nullptr, error, sizeof(error)), ROBOSTRESS_OK)
      << error;
  std::vector<JointMoment> moments(n);
  for (size_t i = 0; i < n; ++i) moments[i] = {.h = 0.002, .q = q[i], .gravity = gravity[i]};
  chain.Reset(moments);
  for (int step = 0; step < 100; ++step) {
    robostress_errors_begin_control_step(errors, step, 1);
    chain.BeginControlStep(step, true);
    chain.BeginSubStep(0.002);
    moment.time = 0.002 * step;
    for (size_t i = 0; i < n; ++i) {
      dq[i] = std::sin(0.05 * step + static_cast<double>(i));
      moments[i] = {.t = moment.time,
                    .h = 0.002,
                    .q = chain.MotorAngle(static_cast<int>(i), q[i]),
                    .dq = dq[i],
                    .gravity = gravity[i]};
    }
    std::vector<double> torque(n, 5), moved(n, 0);
    chain.Drive(absl::MakeSpan(moments), absl::MakeSpan(torque));
    chain.AddTorques(moments, absl::MakeSpan(torque));
    chain.MoveErrors(q, torque, 0.002, absl::MakeSpan(moved));
    const std::vector<double> asked(n, 5);
    ASSERT_EQ(robostress_errors_sub_step(errors, &moment, asked.data(), applied.data(),
                                         change.data(), error, sizeof(error)),
              ROBOSTRESS_OK)
        << error;
    ASSERT_EQ(applied, torque) << "sub-step " << step;
    ASSERT_EQ(change, moved) << "sub-step " << step;
    for (size_t i = 0; i < n; ++i) q[i] += 0.002 * dq[i] + change[i];
  }
}

TEST_F(LibraryArms, WearAlikeByNominalValuesOfTheirOwn) {
  const std::vector<double> values = PandaElbows();
  for (const char* name : {"aged_joint_uniform", "thermal_drift_backlash", "heavy_payload"}) {
    Scenario scenario = *MakeScenario(name, 5);
    scenario.start.resize(kArmJoints);
    scenario.end.resize(kArmJoints);
    scenario.nominal.clear();
    for (size_t i = 0; i < kArmJoints; ++i) {
      const double* p = &values[9 * i];
      scenario.nominal.push_back({p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]});
    }
    JointChain chain(kArmJoints);
    chain.SetScenario(scenario, 300);
    ASSERT_EQ(New(name, kArmJoints, values.data(), errors_), ROBOSTRESS_OK) << error_;
    ExpectChain(errors_.get(), chain);
  }
}

TEST_F(LibraryArms, OfSevenJointsKeepWhichOnesAreWorn) {
  std::vector<double> values = PandaElbows();
  values.insert(values.end(), values.begin(), values.begin() + 9);
  Scenario scenario = *MakeScenario("aged_joint_elbow", 5);
  for (size_t i = 0; i < 7; ++i) {
    const double* p = &values[9 * i];
    scenario.nominal[i] = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]};
  }
  JointChain chain(7);
  chain.SetScenario(scenario, 300);
  ASSERT_EQ(New("aged_joint_elbow", 7, values.data(), errors_), ROBOSTRESS_OK) << error_;
  ExpectChain(errors_.get(), chain);
}

// A simulator with more joints and bodies than the arm has: its arrays in any order.
TEST_F(LibraryArms, ActInASimulatorsArrays) {
  const std::vector<double> values = PandaElbows();
  ASSERT_EQ(New("aged_joint_uniform", kArmJoints, values.data(), errors_), ROBOSTRESS_OK) << error_;
  robostress_errors* copied = nullptr;
  const std::vector<int> at = {9, 2, 5, 0, 7, 3};
  std::vector<double> qpos(10, 0.2), qvel(10, 0.1), ctrl(10, 7), axis(30), anchor(30), com(30),
      mass(10);
  for (size_t i = 0; i < 30; ++i) {
    axis[i] = std::sin(3.0 * static_cast<double>(i));
    anchor[i] = std::sin(5.0 * static_cast<double>(i));
    com[i] = std::cos(7.0 * static_cast<double>(i));
    mass[i / 3] = 1 + 0.1 * static_cast<double>(i);
  }
  robostress_arrays arrays = {sizeof(arrays), qpos.data(), qvel.data(), ctrl.data(),    axis.data(),
                              anchor.data(),  com.data(),  mass.data(), at.data(),      at.data(),
                              at.data(),      at.data(),   at.data(),   {0.5, 0, -9.81}};
  std::vector<double> q(kArmJoints), dq(kArmJoints, 0.1), gravity(kArmJoints), asked(kArmJoints, 4),
      applied(kArmJoints), change(kArmJoints), acted(kArmJoints);
  for (size_t i = 0; i < kArmJoints; ++i) {
    const auto k = static_cast<size_t>(3 * at[i]);
    const double x = com[k] - anchor[k], y = com[k + 1] - anchor[k + 1],
                 z = com[k + 2] - anchor[k + 2];
    gravity[i] = -mass[k / 3] * (axis[k] * (y * -9.81) + axis[k + 1] * (z * 0.5 + x * 9.81) -
                                 axis[k + 2] * (y * 0.5));
    q[i] = 0.2;
  }
  robostress_moment moment = {};
  moment.size = sizeof(moment);
  moment.step = 0.002;
  moment.q = q.data();
  moment.dq = dq.data();
  moment.gravity = gravity.data();
  ASSERT_EQ(robostress_errors_reset(errors_.get(), &moment, nullptr, error_, sizeof(error_)),
            ROBOSTRESS_OK)
      << error_;
  ASSERT_EQ(robostress_errors_copy(errors_.get(), &copied, nullptr, 0), ROBOSTRESS_OK);
  const ArmErrors twin(copied, robostress_errors_free);
  ASSERT_EQ(robostress_errors_sub_step(errors_.get(), &moment, asked.data(), applied.data(),
                                       change.data(), error_, sizeof(error_)),
            ROBOSTRESS_OK);
  robostress_moment rest = {};
  rest.size = sizeof(rest);
  rest.step = 0.002;
  ASSERT_EQ(robostress_errors_act(twin.get(), &rest, &arrays, asked.data(), acted.data(), error_,
                                  sizeof(error_)),
            ROBOSTRESS_OK)
      << error_;
  for (size_t i = 0; i < kArmJoints; ++i) {
    EXPECT_NEAR(acted[i], applied[i], 1e-12);
    EXPECT_EQ(ctrl[static_cast<size_t>(at[i])], acted[i]);
    EXPECT_NEAR(qpos[static_cast<size_t>(at[i])], 0.2 + change[i], 1e-15);
  }
  EXPECT_EQ(ctrl[1], 7);
  EXPECT_EQ(qpos[1], 0.2);
  arrays.ctrl_index = nullptr;
  EXPECT_EQ(robostress_errors_act(twin.get(), &rest, &arrays, asked.data(), nullptr, error_,
                                  sizeof(error_)),
            ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_STREQ(error_, "arrays.ctrl_index is NULL");
}

TEST_F(LibraryArms, AreToldWhatCannotBe) {
  std::vector<double> values = PandaElbows();
  const auto refuses = [&](const char* scenario, const double* nominal, const char* words) {
    EXPECT_EQ(New(scenario, kArmJoints, nominal, errors_), ROBOSTRESS_INVALID_ARGUMENT) << words;
    EXPECT_THAT(error_, HasSubstr(words));
  };
  refuses("aged_joint_uniform", nullptr, "the arm has 6; give its own as options.nominal");
  refuses("aged_joint_shoulder", values.data(), "wears some of the seven joints of a Panda only");
  values[9 * 2 + 7] = 0;
  refuses("aged_joint_uniform", values.data(), "nominal[2].K is 0, must be finite and above 0");
  values[9 * 1] = -1;
  refuses("aged_joint_uniform", values.data(), "nominal[1].Fc is -1, must be finite and at least");
}

}  // namespace
}  // namespace robostress
