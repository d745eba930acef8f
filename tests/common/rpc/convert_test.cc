#include "common/rpc/convert.h"

#include <gmock/gmock.h>
#include <google/protobuf/stubs/logging.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "common/config.h"
#include "common/random.h"
#include "common/rpc/message_limits.h"
#include "common/rpc/refusal.h"
#include "common/rpc/spec_checks.h"
#include "tests/common/rpc/fake_policy_server.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

RobotState MakeState(double x) {
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

ExecutedChunk MakeChunk(bool with_base) {
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

Observation MakeObservation() {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  observation.views.push_back({"agentview", {2, 1, {1, 2, 3, 254, 255, 0}}});
  observation.proprioception = Eigen::VectorXf::LinSpaced(2, -1, 0.3f);
  return observation;
}

SessionSpec MakeSession() {
  SessionSpec spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = "nano";
  spec.severity = 3;
  spec.seed = -5;
  spec.mode = ExecutionMode::kAsync;
  spec.goal_reference = GoalReference::kDesired;
  spec.method.adapt = true;
  spec.method.learning_rate = 1.0 / 3e4;
  spec.method.target = TargetReference::kNominal;
  spec.method.noise_stream = "null";
  return spec;
}

void ExpectEqual(const RobotState& a, const RobotState& b) {
  EXPECT_EQ(a.stamp_s, b.stamp_s);
  EXPECT_EQ(a.q, b.q);
  EXPECT_EQ(a.dq, b.dq);
  EXPECT_EQ(a.tool.p_base_tool, b.tool.p_base_tool);
  EXPECT_EQ(a.tool.q_base_tool.coeffs(), b.tool.q_base_tool.coeffs());
  EXPECT_EQ(a.gripper, b.gripper);
}

// Through the wire format, as a peer would see it.
template <class Message>
Message Transmit(const Message& message) {
  Message out;
  EXPECT_TRUE(out.ParseFromString(message.SerializeAsString()));
  return out;
}

TEST(ConvertTest, SessionSpecSurvivesTheWireExactly) {
  const SessionSpec sent = MakeSession();
  const absl::StatusOr<SessionSpec> got = FromProto(Transmit(ToProto(sent)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(ToProto(*got).SerializeAsString(), ToProto(sent).SerializeAsString());
  EXPECT_EQ(got->method.learning_rate, sent.method.learning_rate);
  EXPECT_EQ(got->method.target, TargetReference::kNominal);
  EXPECT_EQ(got->mode, ExecutionMode::kAsync);
  EXPECT_EQ(got->goal_reference, GoalReference::kDesired);
  EXPECT_EQ(got->seed, -5);
}

TEST(ConvertTest, ObservationSurvivesTheWireExactly) {
  const Observation sent = MakeObservation();
  const absl::StatusOr<Observation> got = FromProto(Transmit(ToProto(sent)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(got->instruction, sent.instruction);
  ASSERT_EQ(got->views.size(), 1u);
  EXPECT_EQ(got->views[0].camera, "agentview");
  EXPECT_EQ(got->views[0].image.data, sent.views[0].image.data);
  EXPECT_EQ(got->proprioception, sent.proprioception);
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

TEST(ConvertTest, PolicySpecAndStatsSurviveTheWire) {
  PolicySpec spec = FakeSpec();
  spec.cameras = {"agentview", "robot0_eye_in_hand"};
  spec.resizes_images = true;
  spec.max_view_side = 640;
  spec.action_low = {-1, -2, 0};
  spec.action_high = {1, 0.5f, 0};
  const absl::StatusOr<PolicySpec> got = FromProto(Transmit(ToProto(spec)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(ToProto(*got).SerializeAsString(), ToProto(spec).SerializeAsString());
  EXPECT_EQ(got->action_low, spec.action_low);
  EXPECT_EQ(got->action_high, spec.action_high);
  EXPECT_TRUE(got->resizes_images);
  EXPECT_EQ(got->max_view_side, 640);
  const SessionStats stats{12, 3, 0.5, 0.25};
  const absl::StatusOr<SessionStats> got_stats = FromProto(ToProto(stats));
  ASSERT_TRUE(got_stats.ok());
  EXPECT_EQ(got_stats->feedback_chunks, 12u);
  EXPECT_EQ(got_stats->adapter_distance, 0.5);
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
    EXPECT_THAT(std::string(result.status().message()), HasSubstr(hostile.message));
  }
}

TEST(ConvertTest, MasksPrioritiesAndRefusalsSurviveTheWire) {
  ExecutedChunk chunk = MakeChunk(false);
  EXPECT_TRUE(FromProto(Transmit(ToProto(chunk)))->masked.empty());
  chunk.masked = {true, false};
  EXPECT_EQ(FromProto(Transmit(ToProto(chunk)))->masked, chunk.masked);
  for (const Priority priority : {Priority::kUnspecified, Priority::kSimulation, Priority::kRobot})
    EXPECT_EQ(*FromProto(ToProto(priority)), priority);
  EXPECT_FALSE(FromProto(static_cast<v1::Priority>(7)).ok());
  v1::Refusal refusal;
  refusal.set_code(8);
  refusal.set_message("the queue is full");
  refusal.set_retry_after_ms(40);
  const absl::Status status = ToStatus(refusal);
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(IsRefusal(status));
  EXPECT_EQ(RetryAfter(status), absl::Milliseconds(40));
  refusal.set_code(0);
  EXPECT_EQ(ToStatus(refusal).code(), absl::StatusCode::kInvalidArgument);
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

TEST(ConvertTest, RefusesHostileObservations) {
  using M = v1::Observation;
  ExpectRefused<M>(
      ToProto(MakeObservation()),
      {{[](M& m) { m.set_instruction(std::string(5000, 'a')); },
        "observation.instruction has 5000 bytes, at most 4096"},
       {[](M& m) { m.mutable_views(0)->set_camera(""); }, "observation.views.camera is empty"},
       {[](M& m) { m.mutable_views(0)->set_camera("a\nb"); },
        "observation.views.camera contains byte 10"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_width(0); },
        "observation.views.image.width is 0"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_width(4294967295u); },
        "width is 4294967295, must be 1 to 4096"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_height(4096); },
        "has 6 bytes of image data, 2 x 4096 RGB needs 24576"},
       {[](M& m) { m.set_proprioception(0, static_cast<float>(kNan)); },
        "observation.proprioception[0] is nan"},
       {[](M& m) {
          for (int i = 0; i < 20; ++i) *m.add_views() = m.views(0);
        },
        "observation.views size is 21, must be 0 to 16"}});
}

TEST(ConvertTest, RefusesHostileSessionSpecs) {
  using M = v1::SessionSpec;
  ExpectRefused<M>(
      ToProto(MakeSession()),
      {{[](M& m) { m.clear_suite(); }, "spec.suite is empty"},
       {[](M& m) { m.set_scenario("../../etc x"); }, "spec.scenario contains byte 32"},
       {[](M& m) { m.set_policy(std::string(300, 'p')); },
        "spec.policy has 300 bytes, at most 256"},
       {[](M& m) { m.set_severity(6); }, "spec.severity is 6, must be 1 to 5"},
       {[](M& m) { m.clear_mode(); }, "spec.mode is 0, must be LOCKSTEP (1) or ASYNC (2)"},
       {[](M& m) { m.set_goal_reference(static_cast<v1::GoalReference>(9)); },
        "spec.goal_reference is 9"},
       {[](M& m) { m.set_method_yaml("{method: ours, learning_rat: 1}"); },
        "unknown key 'learning_rat'"},
       {[](M& m) { m.clear_method_yaml(); }, "spec.method_yaml: names no method"},
       {[](M& m) { m.set_method_yaml("adapt: true"); }, "spec.method_yaml: names no method"},
       {[](M& m) { m.set_method_yaml("method: magic"); }, "unknown method 'magic'; known: base"},
       {[](M& m) { m.set_method_yaml("learning_rate: [1"); }, "spec.method_yaml"},
       {[](M& m) { m.set_control_period_s(0); }, "spec.control_period_s is 0, must be above 0"},
       {[](M& m) { m.set_translation_scale(kNan); }, "spec.translation_scale is nan"}});
}

TEST(ConvertTest, AMethodsNameAloneIsItsWholePreset) {
  v1::SessionSpec message = ToProto(MakeSession());
  message.set_method_yaml("method: ours");
  const absl::StatusOr<SessionSpec> spec = FromProto(message);
  ASSERT_TRUE(spec.ok()) << spec.status();
  EXPECT_EQ(DumpConfig(spec->method), DumpConfig(*MakeMethod("ours")));
  // What a server of an older version stored knew nothing of later options, and had none of them.
  message.set_method_yaml("{method: ours_integral, integral_rate: 0.01}");
  const absl::StatusOr<SessionSpec> stored = FromStored(message);
  ASSERT_TRUE(stored.ok()) << stored.status();
  EXPECT_EQ(stored->method.integral_rate, 0.01);
  EXPECT_FALSE(stored->method.integral_carry);
  EXPECT_TRUE(FromProto(message)->method.integral_carry);
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

TEST(ConvertTest, RefusesHostilePolicySpecsAndPredictions) {
  PolicySpec spec = FakeSpec();
  spec.cameras = {"agentview"};
  using S = v1::PolicySpec;
  ExpectRefused<S>(
      ToProto(spec),
      {{[](S& m) { m.set_execute_steps(5); }, "policy.execute_steps is 5, must be 1 to 4"},
       {[](S& m) { m.set_horizon(0); }, "policy.horizon is 0"},
       {[](S& m) { m.set_image_width(100000); }, "policy.image_width is 100000"},
       {[](S& m) { m.add_action_low(-1); }, "policy.action_low has 1 and action_high 0 values"},
       {[](S& m) {
          for (int i = 0; i < 3; ++i) m.add_action_low(1), m.add_action_high(0);
        },
        "policy.action_low[0] is 1 and action_high[0] 0"},
       {[](S& m) {
          for (int i = 0; i < 3; ++i) m.add_action_low(0), m.add_action_high(std::nanf(""));
        },
        "they must be finite"}});
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

TEST(ConvertTest, ChecksNameWhatThePolicyWants) {
  PolicySpec spec = FakeSpec();
  Observation observation = MakeObservation();
  EXPECT_THAT(std::string(CheckObservation(observation, spec).message()),
              HasSubstr("has the views [agentview], policy 'fake' wants []"));
  spec.cameras = {"agentview"};
  EXPECT_TRUE(CheckObservation(observation, spec).ok());  // 2 x 1 px: the policy's own affair
  observation.views[0].image.width = spec.max_view_side + 1;
  EXPECT_THAT(
      std::string(CheckObservation(observation, spec).message()),
      HasSubstr("view 'agentview' is 1281 x 1 px, at most 1280 a side; policy 'fake' computes "
                "with 224 x 224"));
  observation.views[0].image.width = 2;
  spec.state_dim = 8;
  EXPECT_THAT(std::string(CheckObservation(observation, spec).message()),
              HasSubstr("proprioception has 2 values, policy 'fake' wants 8"));

  ExecutedChunk chunk = MakeChunk(true);
  EXPECT_TRUE(CheckExecutedChunk(chunk, spec).ok());
  chunk.first_step = 3;
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()),
              HasSubstr("covers steps 3 to 4, policy 'fake' predicts 4"));
  chunk.first_step = 0;
  chunk.steps[1].base_command.resize(0);
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()),
              HasSubstr("step 1: base_command has 0 values, must have 3"));
  chunk.steps.clear();
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()), HasSubstr("has no steps"));
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

}  // namespace
}  // namespace robostress
