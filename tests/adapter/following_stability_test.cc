// The shipped preset of model following in closed loop with arms that answer more strongly and are
// seen later than the nominal one. Linear worst case: without thresholds, which only ever take
// correction away.

#include <cmath>
#include <cstdio>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "adapter/nominal_arm.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

constexpr int kRows = 5, kSteps = 600;
constexpr double kKick = 0.001;  // [m]: far from every bound, so that the loop is linear

// Asks for the same displacement in x at every step.
class SteadyPolicy : public PolicyEndpoint {
 public:
  float asked = 0;

  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk chunk;
    chunk.prediction_id = ++predictions_;
    chunk.policy_actions = Eigen::MatrixXf::Zero(kRows, 7);
    chunk.policy_actions.col(0).setConstant(asked);
    chunk.actions = chunk.policy_actions;
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
  bool blocked = false;

  LateArm(double gain, int delay) : gain_(gain), seen_(delay + 1, 0.0), arm_({}) {}

  void Push(double way) { seen_.back() = position_ += way; }
  void Step(const Eigen::VectorXf& command) {
    const double way = 0.05 * arm_.Step(gain_ * command.head<6>().cast<double>())[0];
    if (!blocked) position_ += way;
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

// A method around SteadyPolicy and an arm; `each(step, sent x)` after every command.
class Loop {
 public:
  Loop(const std::string& preset, const std::vector<std::string>& overrides) {
    const auto method = MakeMethod(preset, overrides);
    EXPECT_TRUE(method.ok()) << method.status();
    auto policy = CompensatedPolicy::Create(&asking, {}, *method);
    EXPECT_TRUE(policy.ok()) << policy.status();
    policy_ = *std::move(policy);
    EXPECT_TRUE(policy_->StartEpisode({0, 0}).ok());
  }

  template <class Arm, class Each>
  void Run(int steps, Arm& arm, const Each& each) {
    for (int chunk = 0; chunk < steps / kRows; ++chunk, ++chunk_) {
      const PredictedChunk predicted = *policy_->Predict({}, chunk_);
      ExecutedChunk executed;
      executed.sequence = static_cast<uint64_t>(chunk_) + 1;
      executed.chunk = chunk_;
      executed.prediction_id = predicted.prediction_id;
      executed.final_state = arm.Measured();
      for (int row = 0; row < kRows; ++row) {
        const Eigen::VectorXf command = *policy_->NextCommand(predicted, executed);
        ExecutedStep& done = executed.steps.emplace_back();
        done.before = arm.Measured();
        done.policy_command = predicted.policy_actions.row(row).transpose();
        done.sent_command = command;
        arm.Step(command);
        each(chunk * kRows + row, command[0]);
        executed.final_state = arm.Measured();
      }
      EXPECT_TRUE(policy_->SendFeedback(executed).ok());
    }
  }

  SteadyPolicy asking;

 private:
  std::unique_ptr<CompensatedPolicy> policy_;
  int chunk_ = 0;
};

// The largest command of the last hundred steps over that of the first, after a push.
double WhatIsLeft(const std::string& preset, double gain, int delay) {
  Loop loop(preset, {"following_threshold=0", "integral_threshold=0"});
  LateArm arm(gain, delay);
  double first = 0, last = 0;
  loop.Run(kSteps, arm, [&](int step, float command) {
    const double size = std::abs(command);
    if (step < 100) first = std::max(first, size);
    if (step >= kSteps - 100) last = std::max(last, size);
    if (step == 0) arm.Push(-kKick);
  });
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

struct AfterABlock {
  double most = 0;      // what was added to the command at most, while the policy asked for 0.5
  double jump = 0;      // largest change of a command from step to step
  double farthest = 0;  // [m] the arm went, let go, while the policy asked for nothing
  int steps = 0;        // until commands are zero
};

// Something holds the arm for so many control steps, then lets it go.
AfterABlock LetGo(int held, const std::vector<std::string>& overrides) {
  Loop loop("ours_following_smooth", overrides);
  LateArm arm(1, 1);
  AfterABlock after;
  double before = 0;
  const auto watch = [&](int step, double command) {
    if (loop.asking.asked != 0) after.most = std::max(after.most, command - loop.asking.asked);
    after.jump = std::max(after.jump, std::abs(command - before));
    before = command;
    if (loop.asking.asked == 0 && std::abs(command) > 0.01) after.steps = step + 1;
  };
  loop.asking.asked = 0.5F;
  loop.Run(50, arm, watch);
  arm.blocked = true;
  loop.Run(held, arm, watch);
  arm.blocked = false;
  loop.asking.asked = 0;
  const double held_at = arm.Measured().tool.p_base_tool.x();
  loop.Run(400, arm, [&](int step, double command) {
    watch(step, command);
    const double way = std::abs(arm.Measured().tool.p_base_tool.x() - held_at);
    after.farthest = std::max(after.farthest, way);
  });
  return after;
}

TEST(FollowingStability, WhatAHeldArmBuildsUpIsForgottenWithinTheEnvelope) {
  double farthest = 0, farthest_open = 0;
  for (const int held : {10, 20, 30, 40, 60, 100}) {
    const AfterABlock open = LetGo(held, {"envelope_share=0"}), within = LetGo(held, {});
    std::printf(
        "held for %.1f s: added %.2f, within the envelope %.2f; let go %.3f m in %d steps, "
        "within it %.3f m in %d\n",
        held / 20., open.most, within.most, open.farthest, open.steps, within.farthest,
        within.steps);
    for (const AfterABlock& after : {open, within}) {
      EXPECT_LE(after.most, 1.0 + 1e-6) << "0.5 of each way";
      EXPECT_LE(after.jump, 0.6 * 1.5 + 1e-6) << "smoothed";
    }
    farthest = std::max(farthest, within.farthest);
    farthest_open = std::max(farthest_open, open.farthest);
  }
  EXPECT_GT(farthest_open, 0.3) << "what the envelope is for";
  EXPECT_LT(farthest, 0.07);
  EXPECT_LT(LetGo(100, {}).farthest, 0.02);
  EXPECT_LT(LetGo(100, {}).steps, 10);
}

TEST(FollowingStability, TellsALoopThatDoesNotSettle) {
  EXPECT_FALSE(Settles("ours_following_smooth", 10, 3));
  EXPECT_TRUE(Settles("ours_following_smooth", 0.5, 3)) << "a weak arm is slow, not unstable";
}

}  // namespace
}  // namespace robostress
