#include "common/rpc/convert_chunks.h"

#include <google/protobuf/stubs/logging.h>

#include <cmath>

#include "common/random.h"
#include "common/rollout/message_limits.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_specs.h"
#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

void ExpectEqual(const RobotState& a, const RobotState& b) {
  EXPECT_EQ(a.stamp_s, b.stamp_s);
  EXPECT_EQ(a.q, b.q);
  EXPECT_EQ(a.dq, b.dq);
  EXPECT_EQ(a.tool.p_base_tool, b.tool.p_base_tool);
  EXPECT_EQ(a.tool.q_base_tool.coeffs(), b.tool.q_base_tool.coeffs());
  EXPECT_EQ(a.gripper, b.gripper);
}

TEST(ConvertTest, ExecutedChunkSurvivesTheWireExactlyWithAndWithoutBaseCommands) {
  for (const bool with_base : {false, true}) {
    const ExecutedChunk sent = MakeChunk(with_base);
    const absl::StatusOr<ExecutedChunk> got = FromProto(Transmit(ToProto(sent)));
    ASSERT_TRUE(got.ok()) << got.status();
    EXPECT_EQ(got->sequence, 7u);
    EXPECT_EQ(got->task, 3);
    EXPECT_EQ(got->episode, 2);
    EXPECT_EQ(got->chunk, 5);
    EXPECT_EQ(got->prediction_id, 11u);
    EXPECT_TRUE(got->last_of_episode);
    ASSERT_EQ(got->steps.size(), 2u);
    for (int i = 0; i < 2; ++i) {
      ExpectEqual(got->steps[i].before, sent.steps[i].before);
      EXPECT_EQ(got->steps[i].policy_command, sent.steps[i].policy_command);
      EXPECT_EQ(got->steps[i].sent_command, sent.steps[i].sent_command);
      EXPECT_EQ(got->steps[i].base_command, sent.steps[i].base_command);
    }
    ExpectEqual(got->final_state, sent.final_state);
  }
}

TEST(ConvertTest, PredictionSurvivesTheWireAndOmitsEqualPolicyActions) {
  PredictedChunk sent;
  sent.prediction_id = 4;
  sent.adapter_version = 9;
  sent.actions = Eigen::MatrixXf::Random(4, 3);
  sent.policy_actions = sent.actions;
  EXPECT_FALSE(ToProto(sent, 2).has_policy_actions());
  for (const bool corrected : {false, true}) {
    if (corrected) sent.policy_actions.array() += 0.25f;
    if (corrected) sent.base_actions = Eigen::MatrixXf::Random(4, 3);
    const absl::StatusOr<PredictedChunk> got = FromProto(Transmit(ToProto(sent, 2)));
    ASSERT_TRUE(got.ok()) << got.status();
    EXPECT_EQ(got->actions, sent.actions);
    EXPECT_EQ(got->policy_actions, sent.policy_actions);
    EXPECT_EQ(got->base_actions.size(), sent.base_actions.size());
    if (corrected) {
      EXPECT_EQ(got->base_actions, sent.base_actions);
    }
    EXPECT_EQ(got->adapter_version, 9u);
  }
}

TEST(ConvertTest, RefusesHostileExecutedChunks) {
  using M = v1::ExecutedChunk;
  ExpectRefused<M>(
      ToProto(MakeChunk(true)),
      {{[](M& m) { m.set_sequence(0); }, "chunk.sequence is 0"},
       {[](M& m) { m.add_masked(true); }, "chunk.masked has 1 values for 2 steps"},
       {[](M& m) { m.set_task(4000000000u); }, "chunk.task is 4000000000, must be 0 to"},
       {[](M& m) { m.clear_states(); }, "chunk.states size is 0, must be 2 to"},
       {[](M& m) { m.mutable_states()->RemoveLast(); },
        "chunk.policy_commands is 2 x 3, must be 1 x 3"},
       {[](M& m) { m.mutable_states(1)->set_q(3, kNan); },
        "chunk.states[1]: state.q[3] is nan, must be finite"},
       {[](M& m) { m.mutable_states(1)->mutable_q()->RemoveLast(); },
        "state.q has 6 joints, state.dq 7"},
       {[](M& m) {
          m.mutable_states(2)->mutable_q()->RemoveLast();
          m.mutable_states(2)->mutable_dq()->RemoveLast();
        },
        "chunk.states[2].q has 6 joints, states[0] has 7"},
       {[](M& m) { m.mutable_states(0)->set_q_base_tool(0, 5); }, "state.q_base_tool has norm"},
       {[](M& m) { m.mutable_states(0)->clear_q_base_tool(); },
        "state.q_base_tool has 0 values, must have 4"},
       {[](M& m) { m.mutable_states(0)->add_p_base_tool(1); },
        "state.p_base_tool has 4 values, must have 3"},
       {[](M& m) { m.mutable_states(0)->set_stamp_s(HUGE_VAL); }, "state.stamp_s is inf"},
       {[](M& m) { m.mutable_policy_commands()->set_rows(0); },
        "chunk.policy_commands.rows is 0, must be 1 to"},
       {[](M& m) { m.mutable_policy_commands()->set_rows(4294967295u); },
        "chunk.policy_commands.rows is 4294967295"},
       {[](M& m) { m.mutable_sent_commands()->set_cols(2); },
        "chunk.sent_commands has 6 values, 2 x 2 needs 4"},
       {[](M& m) { m.mutable_base_commands()->set_data(1, HUGE_VALF); },
        "chunk.base_commands[0,1] is inf"},
       {[](M& m) { m.clear_sent_commands(); }, "chunk.sent_commands.rows is 0"}});
}

TEST(ConvertTest, MessagesAreAsLargeAsWhatAPolicyTakes) {
  PolicySpec nano;
  nano.cameras = {"agentview", "wrist"};
  nano.image_width = nano.image_height = nano.max_view_side = 64;
  const size_t views = 2 * 64 * 64 * 3 * 8;
  EXPECT_GT(LargestObservationBytes(nano, nano.max_view_side), views);
  EXPECT_LT(LargestObservationBytes(nano, nano.max_view_side), views + (100 << 10));
  EXPECT_GT(LargestObservationBytes(nano, 1280), 2u * 1280 * 1280 * 3 * 8);
  // A whole horizon of the most joints fits as protobuf writes it.
  ExecutedChunk chunk = MakeChunk(/*with_base=*/true);
  ExecutedStep step = chunk.steps[0];
  step.before.q = step.before.dq = Eigen::VectorXd::Constant(WireLimits::kDof, 0.1);
  step.policy_command = step.sent_command = step.base_command =
      Eigen::VectorXf::Constant(nano.action_dim, 0.1f);
  chunk.final_state = step.before;
  chunk.steps.assign(static_cast<size_t>(nano.horizon), step);
  EXPECT_LT(ToProto(chunk).ByteSizeLong(), LargestExecutedBytes(nano));
  EXPECT_LT(LargestExecutedBytes(nano), 100u << 10);
}

// Flips random bytes of valid messages: whatever still parses is accepted or refused with a reason,
// never a crash.
TEST(ConvertTest, SurvivesRandomDamage) {
  const google::protobuf::LogSilencer silence;  // about broken UTF-8
  RandomStream random(StreamKey("convert_test"));
  int accepted = 0, refused = 0;
  const auto attack = [&](const auto& good) {
    std::string bytes = good.SerializeAsString();
    for (int flips = 1 + random.UniformInt(4); flips > 0; --flips) {
      const int position = random.UniformInt(static_cast<int>(bytes.size()));
      bytes[static_cast<size_t>(position)] = static_cast<char>(random.UniformInt(256));
    }
    auto message = good;
    if (!message.ParseFromString(bytes)) return;
    const absl::Status status = FromProto(message).status();
    ++(status.ok() ? accepted : refused);
    if (!status.ok()) {
      EXPECT_FALSE(status.message().empty());
    }
  };
  for (int i = 0; i < 2000; ++i) {
    attack(ToProto(MakeChunk(true)));
    attack(ToProto(MakeObservation()));
    attack(ToProto(MakeSession()));
  }
  EXPECT_GT(accepted, 100);
  EXPECT_GT(refused, 100);
}

TEST(ConvertTest, MasksSurviveTheWire) {
  ExecutedChunk chunk = MakeChunk(false);
  EXPECT_TRUE(FromProto(Transmit(ToProto(chunk)))->masked.empty());
  chunk.masked = {true, false};
  EXPECT_EQ(FromProto(Transmit(ToProto(chunk)))->masked, chunk.masked);
}

TEST(ConvertTest, RefusesHostilePredictions) {
  PredictedChunk prediction;
  prediction.actions = prediction.policy_actions = Eigen::MatrixXf::Zero(4, 3);
  using P = v1::PredictResponse;
  ExpectRefused<P>(ToProto(prediction, 0), {{[](P& m) { m.clear_actions(); }, "actions.rows is 0"},
                                            {[](P& m) {
                                               *m.mutable_base_actions() = ToProto(
                                                   Eigen::MatrixXf(Eigen::MatrixXf::Zero(4, 2)));
                                             },
                                             "base_actions is 4 x 2, must be 4 x 3"}});
}

TEST(ConvertTest, RunningRowsSurviveTheWireAndHostileOnesAreRefused) {
  RunningRows sent;
  sent.actions = Eigen::MatrixXf::Random(3, 2);
  sent.held = 2;
  const absl::StatusOr<RunningRows> got = FromProto(Transmit(ToProto(sent)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(got->actions, sent.actions);
  EXPECT_EQ(got->held, 2);
  using M = v1::RunningRows;
  ExpectRefused<M>(
      ToProto(sent),
      {{[](M& m) { m.set_held(4); }, "running.held is 4, must be 0 to 3"},
       {[](M& m) { m.clear_actions(); }, "running.actions.rows is 0, must be 1 to"},
       {[](M& m) { m.mutable_actions()->set_data(1, HUGE_VALF); }, "running.actions[0,1] is inf"},
       {[](M& m) { m.mutable_actions()->add_data(1); },
        "running.actions has 7 values, 3 x 2 needs 6"}});
}

}  // namespace
}  // namespace robostress
