#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/rollout/session_spec.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/types.h"

// What the tests of the conversions send, and how they damage it.
namespace robostress {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

inline RobotState MakeState(double x) {
  RobotState state;
  state.stamp_s = 0.05 * x;
  state.q = Eigen::VectorXd::LinSpaced(7, x, x + 1.0 / 3);
  state.dq = -state.q;
  state.tool.p_base_tool = Eigen::Vector3d(x, 0.1, 1e-17);
  state.tool.q_base_tool =
      Eigen::Quaterniond(Eigen::AngleAxisd(0.3 + x, Eigen::Vector3d(1, 2, 3).normalized()));
  state.gripper = 0.04;
  return state;
}

inline ExecutedChunk MakeChunk(bool with_base) {
  ExecutedChunk chunk;
  chunk.sequence = 7;
  chunk.task = 3;
  chunk.episode = 2;
  chunk.chunk = 5;
  chunk.prediction_id = 11;
  chunk.last_of_episode = true;
  for (int i = 0; i < 2; ++i) {
    ExecutedStep& step = chunk.steps.emplace_back();
    step.before = MakeState(i);
    step.policy_command = Eigen::VectorXf::Constant(3, 0.1f * static_cast<float>(i));
    step.sent_command = Eigen::VectorXf::Constant(3, -0.3f);
    if (with_base) step.base_command = Eigen::VectorXf::Constant(3, 1e-30f);
  }
  chunk.final_state = MakeState(2);
  return chunk;
}

inline Observation MakeObservation() {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  observation.views.push_back({"agentview", {2, 1, {1, 2, 3, 254, 255, 0}}});
  observation.proprioception = Eigen::VectorXf::LinSpaced(2, -1, 0.3f);
  return observation;
}

inline RequestedSession MakeSession() {
  RequestedSession spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = "nano";
  spec.severity = 3;
  spec.seed = -5;
  spec.mode = ExecutionMode::kAsync;
  spec.goal_reference = GoalReference::kDesired;
  spec.method_yaml = "{method: ours_nominal, noise_stream: \"null\"}";
  return spec;
}

// Through the wire format, as a peer would see it.
template <class Message>
Message Transmit(const Message& message) {
  Message out;
  EXPECT_TRUE(out.ParseFromString(message.SerializeAsString()));
  return out;
}

// One damaged message and what the error must say.
template <class Message>
struct Hostile {
  std::function<void(Message&)> damage;
  const char* message;
};

template <class Message>
void ExpectRefused(const Message& good, const std::vector<Hostile<Message>>& cases) {
  ASSERT_TRUE(FromProto(good).ok()) << FromProto(good).status();
  for (const Hostile<Message>& hostile : cases) {
    Message message = good;
    hostile.damage(message);
    const auto result = FromProto(message);
    EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument) << hostile.message;
    EXPECT_THAT(std::string(result.status().message()), ::testing::HasSubstr(hostile.message));
  }
}

}  // namespace robostress
