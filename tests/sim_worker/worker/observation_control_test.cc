#include "sim_worker/worker/observation_control.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "adapter/method_options.h"

namespace robostress {
namespace {

using ::testing::Each;

// Shows its step count as state and as brightness.
class CountingRobot : public Robot {
 public:
  absl::Status Reset(int initial_state) override {
    count_ = initial_state;
    return absl::OkStatus();
  }
  absl::StatusOr<Observation> Observe(const PolicySpec&) override {
    Observation observation;
    observation.instruction = "b";
    observation.views = {{"agentview", Image{2, 1, std::vector<uint8_t>(6, count_)}}};
    observation.proprioception = Eigen::VectorXf::Constant(8, static_cast<float>(count_));
    return observation;
  }
  absl::StatusOr<RobotState> Measure() override {
    RobotState state;
    state.q = Eigen::VectorXd::Constant(7, count_);
    return state;
  }
  absl::Status Step(const Eigen::VectorXf&) override {
    ++count_;
    return absl::OkStatus();
  }
  bool Success() const override { return count_ >= 100; }
  int horizon() const override { return 60; }

 private:
  uint8_t count_ = 0;
};

struct ObservationControlTest : public testing::Test {
  std::shared_ptr<Robot> Controlled(ObservationInput input) {
    return ControlObservations(robot, input, {"a", "b", "c"}, /*task=*/1);
  }
  void StepOnce(Robot& controlled) { ASSERT_TRUE(controlled.Step(Eigen::VectorXf::Zero(7)).ok()); }

  std::shared_ptr<Robot> robot = std::make_shared<CountingRobot>();
  PolicySpec spec;
};

TEST_F(ObservationControlTest, FullIsTheRobotItself) {
  EXPECT_EQ(Controlled(ObservationInput::kFull), robot);
}

TEST_F(ObservationControlTest, EveryOtherInstructionHasItsTurnAndTheOwnNever) {
  const auto controlled = Controlled(ObservationInput::kShuffledInstruction);
  std::set<std::string> seen;
  for (int state = 0; state < 4; ++state) {
    ASSERT_TRUE(controlled->Reset(state).ok());
    const Observation observation = *controlled->Observe(spec);
    seen.insert(observation.instruction);
    EXPECT_EQ(observation.proprioception[0], static_cast<float>(state));
  }
  EXPECT_EQ(seen, (std::set<std::string>{"a", "c"}));
}

TEST_F(ObservationControlTest, BlankImagesAreGreyAndTheRestIsTrue) {
  const auto controlled = Controlled(ObservationInput::kBlankImages);
  ASSERT_TRUE(controlled->Reset(7).ok());
  const Observation observation = *controlled->Observe(spec);
  EXPECT_THAT(observation.views[0].image.data, Each(128));
  EXPECT_EQ(observation.instruction, "b");
  EXPECT_EQ(observation.proprioception[0], 7.0f);
}

TEST_F(ObservationControlTest, AFrozenStateIsTheFirstOfItsEpisodeAndMeasurementsMove) {
  const auto controlled = Controlled(ObservationInput::kFrozenState);
  for (const int start : {3, 20}) {
    ASSERT_TRUE(controlled->Reset(start).ok());
    for (int step = 0; step < 3; ++step) {
      const Observation observation = *controlled->Observe(spec);
      EXPECT_EQ(observation.proprioception[0], static_cast<float>(start));
      EXPECT_EQ(observation.views[0].image.data[0], start + step);
      EXPECT_EQ(controlled->Measure()->q[0], start + step);
      StepOnce(*controlled);
    }
  }
}

}  // namespace
}  // namespace robostress
