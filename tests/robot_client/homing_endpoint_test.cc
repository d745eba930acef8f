#include "robot_client/homing_endpoint.h"

#include <gtest/gtest.h>

#include <vector>

namespace robostress {
namespace {

constexpr double kPeriod = 1.0 / 30;
const ArmVector kHome = {0.1, 1.2, -1.0, 0, 0.9, 0, 0.07};

class Listener : public PolicyEndpoint {
 public:
  struct Heard {
    int started = 0, predicted = 0;
    std::vector<uint64_t> feedback;
    absl::Status answer;
  };
  explicit Listener(Heard* heard) : heard_(heard) {
    spec_.state_dim = spec_.action_dim = ArmAxes().count();
    spec_.horizon = 50;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override {
    ++heard_->started;
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    ++heard_->predicted;
    return PredictedChunk{};
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    heard_->feedback.push_back(executed.sequence);
    return heard_->answer;
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

 private:
  Heard* const heard_;
  PolicySpec spec_;
};

ExecutedChunk Chunk(int episode, uint64_t sequence) {
  ExecutedChunk chunk;
  chunk.episode = episode;
  chunk.sequence = sequence;
  return chunk;
}

TEST(HomingEndpoint, LeadsStraightHomeNoFasterThanItsSpeed) {
  Listener::Heard heard;
  HomingEndpoint endpoint(std::make_unique<Listener>(&heard), ArmAxes(), kHome, kPeriod);
  ASSERT_TRUE(endpoint.StartEpisode({0, kHomingEpisode}).ok());
  Observation observation;
  observation.proprioception = Eigen::VectorXf::Zero(ArmAxes().count());
  const auto way = endpoint.Predict(observation, 0);
  ASSERT_TRUE(way.ok()) << way.status();
  ASSERT_EQ(way->actions.rows(), 50);
  Eigen::VectorXf before = observation.proprioception;
  for (int row = 0; row < 50; ++row) {
    for (int j = 0; j < ArmAxes().joints; ++j) {
      EXPECT_LE(std::abs(way->actions(row, j) - before[j]),
                HomingEndpoint::kJointSpeed * kPeriod + 1e-5)
          << "row " << row << " joint " << j;
      // All joints are on their way by the same share.
      EXPECT_NEAR(way->actions(row, j) / kHome[1],
                  way->actions(row, 1) * kHome[j] / kHome[1] / kHome[1], 1e-5);
    }
    EXPECT_FLOAT_EQ(way->actions(row, ArmAxes().joints), 0.07f) << "the gripper opens at once";
    before = way->actions.row(row).transpose();
  }
  observation.proprioception = before;
  for (int i = 0; i < 3; ++i)
    observation.proprioception = endpoint.Predict(observation, i)->actions.row(49).transpose();
  ArmVector end{};
  for (int i = 0; i < ArmAxes().count(); ++i) end[i] = observation.proprioception[i];
  EXPECT_TRUE(IsHome(ArmAxes(), end, kHome));
  EXPECT_FALSE(IsHome(ArmAxes(), ArmVector{}, kHome));
  EXPECT_EQ(heard.started, 0) << "the policy hears nothing of it";
  EXPECT_EQ(heard.predicted, 0);
}

TEST(HomingEndpoint, PassesThePolicysFeedbackOnWithoutGapsAndKeepsItsOwn) {
  Listener::Heard heard;
  HomingEndpoint endpoint(std::make_unique<Listener>(&heard), ArmAxes(), kHome, kPeriod);
  EXPECT_TRUE(endpoint.SendFeedback(Chunk(kHomingEpisode, 1)).ok());
  EXPECT_TRUE(endpoint.SendFeedback(Chunk(0, 2)).ok());
  EXPECT_TRUE(endpoint.SendFeedback(Chunk(0, 3)).ok());
  EXPECT_TRUE(endpoint.SendFeedback(Chunk(kHomingEpisode, 4)).ok());
  heard.answer = absl::InvalidArgumentError("refused for good");
  EXPECT_FALSE(endpoint.SendFeedback(Chunk(1, 5)).ok());
  heard.answer = absl::UnavailableError("kept, sent again later");
  EXPECT_FALSE(endpoint.SendFeedback(Chunk(1, 5)).ok());
  heard.answer = absl::OkStatus();
  EXPECT_TRUE(endpoint.SendFeedback(Chunk(1, 6)).ok());
  EXPECT_EQ(heard.feedback, (std::vector<uint64_t>{1, 2, 3, 3, 4}));
  EXPECT_TRUE(endpoint.StartEpisode({0, 3}).ok());
  EXPECT_TRUE(endpoint.Predict({}, 0).ok());
  EXPECT_EQ(heard.predicted, 1);
}

}  // namespace
}  // namespace robostress
