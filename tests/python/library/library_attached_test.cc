// Errors that act in a simulator's own arrays.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "robostress.h"

namespace robostress {
namespace {

using ::testing::Each;
using ::testing::HasSubstr;
using AttachedErrors = std::unique_ptr<robostress_errors, decltype(&robostress_errors_free)>;

constexpr size_t kPandaJoints = 7;
constexpr int kRows = 3;

struct SimulatorArrays {
  std::vector<double> qpos, qvel, ctrl, axis, anchor, com, mass;
  std::vector<int> at = {9, 2, 5, 0, 7, 3, 4};
  std::array<double, 3> tool = {0.3, -0.2, 0.9};
  robostress_arrays arrays = {};

  SimulatorArrays()
      : qpos(10, 0.2), qvel(10, 0.1), ctrl(10, 7), axis(30), anchor(30), com(30), mass(10) {
    for (size_t i = 0; i < 30; ++i) {
      axis[i] = std::sin(3.0 * static_cast<double>(i));
      anchor[i] = std::sin(5.0 * static_cast<double>(i));
      com[i] = std::cos(7.0 * static_cast<double>(i));
      mass[i / 3] = 1 + 0.1 * static_cast<double>(i);
    }
    arrays = {sizeof(arrays), qpos.data(), qvel.data(), ctrl.data(),    axis.data(),
              anchor.data(),  com.data(),  mass.data(), at.data(),      at.data(),
              at.data(),      at.data(),   at.data(),   {0.5, 0, -9.81}};
    arrays.tool = tool.data();
  }
  // How a point moves with a joint: axis x (point - anchor), or the axis of one that slides.
  std::array<double, 3> Column(size_t joint, const double* point) const {
    const auto k = 3 * static_cast<size_t>(at[joint]);
    const double *a = &axis[k], *o = &anchor[k];
    if (arrays.slides != nullptr && arrays.slides[joint] != 0) return {a[0], a[1], a[2]};
    const double x = point[0] - o[0], y = point[1] - o[1], z = point[2] - o[2];
    return {a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x};
  }
  double Holding(size_t joint, double gx, double gy, double gz) const {
    const auto column = Column(joint, &com[3 * static_cast<size_t>(at[joint])]);
    return -mass[static_cast<size_t>(at[joint])] *
           (column[0] * gx + column[1] * gy + column[2] * gz);
  }
};

class LibraryAttached : public ::testing::Test {
 protected:
  void SetUp() override {
    moment_.size = sizeof(moment_);
    moment_.step = 0.002;
    asked_.fill(4);
  }
  AttachedErrors New(const char* scenario) {
    robostress_errors* made = nullptr;
    EXPECT_EQ(robostress_errors_new(scenario, kPandaJoints, nullptr, &made, error_, sizeof(error_)),
              ROBOSTRESS_OK)
        << error_;
    return {made, robostress_errors_free};
  }
  AttachedErrors Copy(const AttachedErrors& from) {
    robostress_errors* made = nullptr;
    EXPECT_EQ(robostress_errors_copy(from.get(), &made, error_, sizeof(error_)), ROBOSTRESS_OK);
    return {made, robostress_errors_free};
  }
  robostress_code Attach(const AttachedErrors& errors) {
    return robostress_errors_attach(errors.get(), &moment_, &simulator_.arrays, asked_.data(),
                                    record_.data(), kRows, error_, sizeof(error_));
  }
  robostress_code Begin(const AttachedErrors& errors) {
    return robostress_errors_reset_attached(errors.get(), error_, sizeof(error_));
  }
  robostress_code Act(const AttachedErrors& errors) {
    return robostress_errors_act_attached(errors.get(), error_, sizeof(error_));
  }
  void AddEffect(const AttachedErrors& errors, int joint, const char* type,
                 const std::vector<double>& values) {
    ASSERT_EQ(robostress_errors_add_effect(errors.get(), joint, type, values.data(), values.size(),
                                           -1, error_, sizeof(error_)),
              ROBOSTRESS_OK)
        << error_;
  }

  // Errors of many kinds in these arrays, and in a twin that is told what the arrays mean.
  void CompareWithSubSteps() {
    const AttachedErrors errors = New("heavy_payload");
    AddEffect(errors, 1, "payload", {2});
    AddEffect(errors, 3, "payload", {1});
    AddEffect(errors, 5, "base_tilt", {0.02, 0.05});
    AddEffect(errors, 2, "base_tilt", {0.1, -0.05});
    AddEffect(errors, 4, "time_varying_gain", {0.5});
    const AttachedErrors twin = Copy(errors);
    ASSERT_EQ(Attach(errors), ROBOSTRESS_OK) << error_;
    std::vector<double> q(kPandaJoints), dq(kPandaJoints), gravity(kPandaJoints),
        mass(kPandaJoints), inertia(kPandaJoints), tilt(2 * kPandaJoints), applied(kPandaJoints),
        change(kPandaJoints);
    const auto look = [&] {
      for (size_t i = 0; i < kPandaJoints; ++i) {
        q[i] = simulator_.qpos[static_cast<size_t>(simulator_.at[i])];
        dq[i] = simulator_.qvel[static_cast<size_t>(simulator_.at[i])];
        gravity[i] = simulator_.Holding(i, 0.5, 0, -9.81);
        tilt[2 * i] = simulator_.Holding(i, 0, -9.81, 0);
        tilt[2 * i + 1] = simulator_.Holding(i, 9.81, 0, 0.5);
        const auto column = simulator_.Column(i, simulator_.tool.data());
        mass[i] = -(0.5 * column[0] - 9.81 * column[2]);
        inertia[i] = column[0] * column[0] + column[1] * column[1] + column[2] * column[2];
      }
    };
    robostress_moment given = moment_;
    given.q = q.data();
    given.dq = dq.data();
    given.gravity = gravity.data();
    given.payload_gravity = mass.data();
    given.payload_inertia = inertia.data();
    given.tilt_gravity = tilt.data();
    std::vector<double> mass_matrix(kPandaJoints * kPandaJoints), other(kPandaJoints);
    for (size_t i = 0; i < kPandaJoints; ++i) mass_matrix[(kPandaJoints + 1) * i] = 3;
    moment_.mass_matrix = given.mass_matrix = mass_matrix.data();
    moment_.other_torque = given.other_torque = other.data();
    look();
    dq.assign(kPandaJoints, 0);
    ASSERT_EQ(Begin(errors), ROBOSTRESS_OK) << error_;
    ASSERT_EQ(robostress_errors_reset(twin.get(), &given, gravity.data(), error_, sizeof(error_)),
              ROBOSTRESS_OK)
        << error_;
    for (int step = 0; step < 50; ++step) {
      if (step % 5 == 0) {
        robostress_errors_begin_control_step(errors.get(), step / 5, 1);
        robostress_errors_begin_control_step(twin.get(), step / 5, 1);
      }
      asked_[3] = 4 * std::sin(0.1 * step);
      look();
      given.time = 0.002 * step;
      ASSERT_EQ(robostress_errors_sub_step(twin.get(), &given, asked_.data(), applied.data(),
                                           change.data(), error_, sizeof(error_)),
                ROBOSTRESS_OK)
          << error_;
      ASSERT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
      EXPECT_EQ(robostress_errors_recorded(errors.get()), std::min<size_t>(step % 5 + 1, kRows));
      for (size_t i = 0; i < kPandaJoints; ++i) {
        const auto k = static_cast<size_t>(simulator_.at[i]);
        EXPECT_NEAR(simulator_.ctrl[k], applied[i], 1e-10);
        EXPECT_NEAR(simulator_.qpos[k], q[i] + change[i], 1e-13);
        if (step % 5 >= kRows) continue;
        const size_t row = 2 * kPandaJoints * static_cast<size_t>(step % 5) + i;
        EXPECT_EQ(record_[row], asked_[i]);
        EXPECT_EQ(record_[row + kPandaJoints], simulator_.ctrl[k]);
      }
      simulator_.qvel[5] = std::sin(0.3 * step);
    }
    EXPECT_GT(std::abs(simulator_.ctrl[2] - asked_[1]), 0.5);
    EXPECT_EQ(simulator_.ctrl[1], 7);
    EXPECT_EQ(simulator_.qpos[1], 0.2);
  }

  SimulatorArrays simulator_;
  robostress_moment moment_ = {};
  std::array<double, kPandaJoints> asked_;
  std::vector<double> record_ = std::vector<double>(2 * kPandaJoints * kRows, -1);
  char error_[400] = "";
};

TEST_F(LibraryAttached, ActAsASubStepGivenWhatTheArraysSay) { CompareWithSubSteps(); }

TEST_F(LibraryAttached, KnowJointsThatSlide) {
  const std::array<unsigned char, kPandaJoints> slides = {0, 1, 1, 0, 0, 0, 1};
  simulator_.arrays.slides = slides.data();
  CompareWithSubSteps();
}

TEST_F(LibraryAttached, KeepTheCommandsOfGearsThatTheyLeaveAlone) {
  const AttachedErrors errors = New("clean");
  AddEffect(errors, 1, "motor_gain", {-0.5});
  const std::array<double, kPandaJoints> gear = {3, 3, 3, 3, 3, 3, 3};
  simulator_.arrays.gear = gear.data();
  ASSERT_EQ(Attach(errors), ROBOSTRESS_OK) << error_;
  ASSERT_EQ(Begin(errors), ROBOSTRESS_OK) << error_;
  simulator_.ctrl.assign(10, 0.1);
  asked_.fill(3 * 0.1);  // a third of it is not 0.1
  ASSERT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
  EXPECT_EQ(simulator_.ctrl[9], 0.1);
  EXPECT_NEAR(simulator_.ctrl[2], 0.05, 1e-15);
  simulator_.ctrl.assign(10, 0);  // not what asks: the motors get it all the same
  ASSERT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
  EXPECT_NEAR(simulator_.ctrl[9], 0.1, 1e-15);
}

TEST_F(LibraryAttached, SayWhatIsMissing) {
  const AttachedErrors errors = New("aged_transmission");
  EXPECT_EQ(Act(errors), ROBOSTRESS_WRONG_ORDER);
  EXPECT_STREQ(error_, "no arrays are attached: call robostress_errors_attach first");
  EXPECT_EQ(Begin(errors), ROBOSTRESS_WRONG_ORDER);
  simulator_.arrays.xanchor = nullptr;
  EXPECT_EQ(Attach(errors), ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_STREQ(error_, "arrays.xanchor is NULL");
  simulator_.arrays.xanchor = simulator_.anchor.data();
  ASSERT_EQ(Attach(errors), ROBOSTRESS_OK) << error_;
  EXPECT_EQ(Act(errors), ROBOSTRESS_WRONG_ORDER);
  EXPECT_THAT(error_, HasSubstr("no episode has begun"));
  ASSERT_EQ(Begin(errors), ROBOSTRESS_OK) << error_;
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  for (double* value : {&asked_[2], &simulator_.qvel[5], &simulator_.com[15]}) {
    const double before = *value;
    *value = nothing;
    EXPECT_EQ(Act(errors), ROBOSTRESS_INVALID_ARGUMENT);
    EXPECT_THAT(error_, HasSubstr("[2] is nan, must be finite"));
    *value = before;
  }
  EXPECT_THAT(simulator_.ctrl, Each(7));
  EXPECT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
}

TEST_F(LibraryAttached, AreNotWhatACopyIsAttachedTo) {
  const AttachedErrors errors = New("aged_transmission");
  ASSERT_EQ(Attach(errors), ROBOSTRESS_OK) << error_;
  ASSERT_EQ(Begin(errors), ROBOSTRESS_OK) << error_;
  const AttachedErrors saved = Copy(errors);
  EXPECT_EQ(Act(saved), ROBOSTRESS_WRONG_ORDER);
  const std::vector<double> qpos = simulator_.qpos;
  ASSERT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
  const std::vector<double> first = simulator_.ctrl;
  ASSERT_EQ(robostress_errors_restore(errors.get(), saved.get(), error_, sizeof(error_)),
            ROBOSTRESS_OK);
  simulator_.qpos = qpos;
  simulator_.arrays.qpos = simulator_.qpos.data();
  ASSERT_EQ(Act(errors), ROBOSTRESS_OK) << error_;
  EXPECT_EQ(simulator_.ctrl, first);
}

TEST_F(LibraryAttached, ReadAGraspWhereTheScenarioDependsOnOne) {
  EXPECT_TRUE(robostress_errors_reads(New("heavy_payload").get()) & ROBOSTRESS_READS_GRASP);
  EXPECT_FALSE(robostress_errors_reads(New("nominal").get()) & ROBOSTRESS_READS_GRASP);
}

}  // namespace
}  // namespace robostress
