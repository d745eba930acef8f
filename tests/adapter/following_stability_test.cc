// The shipped preset of model following in closed loop with arms that answer more strongly and are
// seen later than the nominal one. Linear worst case: without thresholds, which only ever take
// correction away.

#include <cmath>
#include <cstdio>
#include <deque>
#include <memory>

#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "adapter/nominal_arm.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

constexpr int kRows = 5, kSteps = 600;
constexpr double kKick = 0.001;  // [m]: far from every bound, so that the loop is linear

// Asks for no motion.
class StillPolicy : public PolicyEndpoint {
 public:
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk chunk;
    chunk.prediction_id = ++predictions_;
    chunk.policy_actions = chunk.actions = Eigen::MatrixXf::Zero(kRows, 7);
    return chunk;
  }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }

 private:
  PolicySpec spec_;
  uint64_t predictions_ = 0;
};

// `gain` times as strong as the nominal arm; its pose is measured `delay` control steps late.
class LateArm {
 public:
  LateArm(double gain, int delay) : gain_(gain), seen_(delay + 1, 0.0), arm_({}) {}

  void Push(double way) { seen_.back() = position_ += way; }
  void Step(const Eigen::VectorXf& command) {
    position_ += 0.05 * arm_.Step(gain_ * command.head<6>().cast<double>())[0];
    seen_.push_back(position_);
    seen_.pop_front();
  }
  RobotState Measured() const {
    RobotState state;
    state.tool.p_base_tool.x() = seen_.front();
    return state;
  }

 private:
  double gain_, position_ = 0;
  std::deque<double> seen_;
  NominalArm arm_;
};

// The largest command of the last hundred steps over that of the first, after a push.
double WhatIsLeft(const std::string& preset, double gain, int delay) {
  StillPolicy still;
  const auto method = MakeMethod(preset, {"following_threshold=0", "integral_threshold=0"});
  EXPECT_TRUE(method.ok()) << method.status();
  const auto policy = CompensatedPolicy::Create(&still, {}, *method);
  EXPECT_TRUE(policy.ok()) << policy.status();
  EXPECT_TRUE((*policy)->StartEpisode({0, 0}).ok());
  LateArm arm(gain, delay);
  double first = 0, last = 0;
  for (int chunk = 0; chunk < kSteps / kRows; ++chunk) {
    const PredictedChunk predicted = *(*policy)->Predict({}, chunk);
    ExecutedChunk executed;
    executed.sequence = static_cast<uint64_t>(chunk) + 1;
    executed.chunk = chunk;
    executed.prediction_id = predicted.prediction_id;
    executed.final_state = arm.Measured();
    for (int row = 0; row < kRows; ++row) {
      const int step = chunk * kRows + row;
      const Eigen::VectorXf command = *(*policy)->NextCommand(predicted, executed);
      const double size = std::abs(command[0]);
      if (step < 100) first = std::max(first, size);
      if (step >= kSteps - 100) last = std::max(last, size);
      ExecutedStep& done = executed.steps.emplace_back();
      done.before = arm.Measured();
      done.policy_command = predicted.policy_actions.row(row).transpose();
      done.sent_command = command;
      arm.Step(command);
      if (step == 0) arm.Push(-kKick);
      executed.final_state = arm.Measured();
    }
    EXPECT_TRUE((*policy)->SendFeedback(executed).ok());
  }
  EXPECT_GT(first, 0);
  return last / first;
}

bool Settles(const std::string& preset, double gain, int delay) {
  return WhatIsLeft(preset, gain, delay) < 0.05;
}

// The largest multiple of the nominal arm's gain, in steps of a tenth, up to which it settles.
double GainMargin(const std::string& preset, int delay) {
  double margin = 0.9;
  while (margin < 30 && Settles(preset, margin + 0.1, delay)) margin += 0.1;
  return margin;
}

TEST(FollowingStability, ThePresetSettlesAtFarMoreThanTheGainAndDelayOfANominalArm) {
  std::printf("gain margin of ours_following_smooth by control steps of sensing delay:");
  double before = 100;
  for (const int delay : {0, 1, 2, 3}) {
    const double margin = GainMargin("ours_following_smooth", delay);
    std::printf(" %d: %.1f", delay, margin);
    EXPECT_GE(margin, 2.7) << delay;
    EXPECT_LE(margin, before) << "a later measurement is no help";
    before = margin;
  }
  int delay = 0;
  while (delay < 20 && Settles("ours_following_smooth", 1, delay + 1)) ++delay;
  std::printf("; delay margin %d control steps\n", delay);
  EXPECT_GE(delay, 6);
}

TEST(FollowingStability, TellsALoopThatDoesNotSettle) {
  EXPECT_FALSE(Settles("ours_following_smooth", 10, 3));
  EXPECT_TRUE(Settles("ours_following_smooth", 0.5, 3)) << "a weak arm is slow, not unstable";
}

}  // namespace
}  // namespace robostress
