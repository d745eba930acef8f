// Impossible measurements, whatever a method makes of them: commands are bounded numbers and the
// next normal chunk works.
#include "adapter/command_bounds.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "absl/strings/str_cat.h"
#include "adapter/command_correction.h"
#include "adapter/plausible_motion.h"
#include "common/so3.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

PolicySpec OneToOne() {
  PolicySpec spec;
  spec.action_dim = 2;
  spec.action_low = {-1, 0};
  spec.action_high = {1, 0.5f};
  return spec;
}

TEST(CommandBounds, LeaveACorrectionOfASpanAndEveryBitWithin) {
  Eigen::MatrixXf own(3, 2), commands(3, 2);
  own << 0.9f, 0.1f, -1.2f, 0.2f, 7, -9;
  commands << 2.999f, 0.999f, -3.5f, -0.6f, 9, -8;
  BoundCommands(OneToOne(), own, commands);
  Eigen::MatrixXf expected(3, 2);
  expected << 2.999f, 0.999f, -3, -0.5f, 7, -8;  // the policy's own may lie outside
  EXPECT_EQ(commands, expected);
}

TEST(CommandBounds, AreFiniteWhereNoRangeIsDeclared) {
  PolicySpec spec;
  spec.action_dim = 2;
  constexpr float kInf = std::numeric_limits<float>::infinity();
  Eigen::MatrixXf own = Eigen::MatrixXf::Constant(2, 2, 0.25f), commands(2, 2);
  commands << kInf, -kInf, std::nanf(""), 999;
  BoundCommands(spec, own, commands);
  Eigen::MatrixXf expected(2, 2);
  expected << kWidestCommand, -kWidestCommand, 0.25f, 999;
  EXPECT_EQ(commands, expected);
}

// ---------------------------------------------------------------------------- impossible measures

struct Field {
  std::string name;
  std::function<void(RobotState&, double)> set;
  bool masks = true;
};

const std::vector<Field>& Fields() {
  static const std::vector<Field> fields = [] {
    std::vector<Field> all;
    for (int i = 0; i < 3; ++i)
      all.push_back({absl::StrCat("p_base_tool ", i),
                     [i](RobotState& s, double v) { s.tool.p_base_tool[i] = v; }});
    for (const int i : {0, 6}) {
      all.push_back({absl::StrCat("q ", i), [i](RobotState& s, double v) { s.q[i] = v; }});
      all.push_back({absl::StrCat("dq ", i), [i](RobotState& s, double v) { s.dq[i] = v; }});
    }
    all.push_back({"gripper", [](RobotState& s, double v) { s.gripper = v; }});
    all.push_back({"stamp", [](RobotState& s, double v) { s.stamp_s = v; }, false});
    all.push_back({"everything", [](RobotState& s, double v) {
                     s.tool.p_base_tool.setConstant(v);
                     s.q.setConstant(v);
                     s.dq.setConstant(-v);
                     s.gripper = v;
                   }});
    return all;
  }();
  return fields;
}

void ExpectBounded(const PredictedChunk& prediction, const std::string& what) {
  ASSERT_TRUE(prediction.actions.allFinite()) << what;
  ASSERT_LE(prediction.actions.cwiseAbs().maxCoeff(), 3) << what;  // -1..1 and a span
}

TEST(ImpossibleMeasurements, LeaveEveryMethodBoundedCommandsAndItsNextChunk) {
  for (const std::string method : {"base", "ours", "ours_intent", "ours_nominal", "direct",
                                   "ours_integral", "ours_following", "gain", "null"}) {
    Rig rig;
    std::vector<std::string> overrides;
    if (method.rfind("ours", 0) == 0 && method != "ours_integral" && method != "ours_following")
      overrides = {kRate, "buffer_chunks=4", "update_interval=4", "batch=2"};
    Client client(rig.Open(Spec(method, overrides)));
    client.StartEpisode(0, 0);
    uint64_t impossible = 0;
    for (const Field& field : Fields()) {
      for (const double value : {1e30, 1e308, -1e308, 11.0, 5e-324, -1e-310}) {
        // q, dq and the gripper may be 11 rad, 11 rad/s and 1e-310 m.
        const std::string what = absl::StrCat(method, " ", field.name, " ", value);
        const PredictedChunk prediction = client.Predict();
        ExpectBounded(prediction, what);
        ExecutedChunk executed = client.Execute(prediction);
        field.set(executed.steps[3].before, value);
        const uint64_t before = client.session().Counters()->steps_impossible;
        client.Send(executed);
        const uint64_t masked = client.session().Counters()->steps_impossible - before;
        if (std::abs(value) > 1e3) {
          EXPECT_EQ(masked, field.masks ? 2u : 0u) << what;  // those before and after the state
        } else if (std::abs(value) < 1e-300 && field.name != "everything") {
          EXPECT_EQ(masked, 0u) << what;
        }
        impossible += masked;
        ExpectBounded(client.RunChunk(), what);  // a normal one
      }
    }
    EXPECT_EQ(client.session().Counters()->steps_impossible, impossible);
    EXPECT_EQ(client.session().Counters()->steps_masked, 0u) << "the client masked none";
    ExpectBounded(client.Predict(), method);
  }
}

TEST(SessionPrediction, ACorrectionOfAJumpThatIsPossibleStopsASpanBeyondTheDeclaredRange) {
  Rig rig;
  Client client(rig.Open(Spec("direct")));
  client.StartEpisode(0, 0);
  ExecutedChunk executed = client.Execute(client.Predict());
  executed.final_state.tool.p_base_tool[0] += 0.95;  // 19 in units of a command, over five steps
  client.Send(executed);
  EXPECT_EQ(client.session().Counters()->steps_impossible, 0u);
  EXPECT_EQ(client.Predict().actions.col(0).minCoeff(), -3.0f);
}

TEST(ImpossibleMeasurements, CountLikeMaskedStepsBitForBit) {
  for (const std::string method : {"ours", "ours_intent", "ours_nominal"}) {
    std::vector<std::string> exports;
    for (const bool by_client : {true, false}) {
      Rig rig;
      Client client(
          rig.Open(Spec(method, {kRate, "buffer_chunks=4", "update_interval=2", "batch=2"})));
      client.StartEpisode(0, 0);
      for (int i = 0; i < 12; ++i) {
        ExecutedChunk executed = client.Execute(client.Predict());
        if (by_client) {
          executed.masked = {false, true, true, false, false};
          executed.steps[2].before.tool.p_base_tool[0] += 0.001 * i;
        } else {
          executed.steps[2].before.tool.p_base_tool[i % 3] = 1e30;
        }
        client.Send(executed);
      }
      EXPECT_GT(client.updates(), 2u);
      exports.push_back(ExportOf(client.session()));
    }
    EXPECT_EQ(exports[0], exports[1]) << method;
  }
}

TEST(ImpossibleMeasurements, AJumpWithinWhatIsReachableMasksItsStepsToo) {
  ToyArm arm(0.6);
  const PredictedChunk prediction = ConstantPrediction(Eigen::VectorXf::Constant(7, 0.3f), 5);
  const auto impossible = [&](const std::function<void(ExecutedChunk&)>& change) {
    ExecutedChunk chunk = arm.Execute(prediction, 5);
    change(chunk);
    return ImpossibleSteps(chunk);
  };
  using Steps = std::vector<bool>;
  EXPECT_TRUE(impossible([](ExecutedChunk&) {}).empty());
  EXPECT_EQ(impossible([](ExecutedChunk& c) { c.final_state.tool.p_base_tool[1] += 1.2; }),
            (Steps{false, false, false, false, true}));
  EXPECT_EQ(impossible([](ExecutedChunk& c) { c.steps[0].before.tool.p_base_tool[2] += 1.2; }),
            (Steps{true, false, false, false, false}));
  EXPECT_EQ(impossible([](ExecutedChunk& c) {
              c.steps[1].before.tool.q_base_tool =
                  ExpSo3({0, 0, 3.0}) * c.steps[1].before.tool.q_base_tool;
            }),
            (Steps{true, true, false, false, false}));
  EXPECT_EQ(impossible([](ExecutedChunk& c) { c.steps[4].before.q[2] += 3.5; }),
            (Steps{false, false, false, true, true}));
  EXPECT_EQ(impossible([](ExecutedChunk& c) { c.steps[2].policy_command[0] = 2000; }),
            (Steps{false, false, true, false, false}));
  EXPECT_EQ(impossible([](ExecutedChunk& c) { c.steps[2].sent_command[5] = -1e38f; }),
            (Steps{false, false, true, false, false}));
}

TEST(ImpossibleMeasurements, LeaveJointCommandsBounded) {
  Rig rig;
  SessionSpec spec = Spec("direct");
  spec.control_space = ControlSpace::kJoint;
  const auto session = rig.Open(spec);
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  uint64_t sequence = 0;
  for (const double value : {1e30, -1e308, 99.0, 0.0}) {
    const auto prediction = session->Predict(Shared(FakePolicy::MakeObservation(0)),
                                             {{0, 0}, static_cast<int>(sequence)}, sequence);
    ASSERT_TRUE(prediction.ok()) << prediction.status();
    ExpectBounded(*prediction, absl::StrCat("after ", sequence));
    ExecutedChunk executed = ToyArm(0.6).Execute(*prediction, 5);
    for (ExecutedStep& step : executed.steps) step.before.q = Eigen::VectorXd::Zero(6);
    for (ExecutedStep& step : executed.steps) step.before.dq = Eigen::VectorXd::Zero(6);
    executed.final_state.q = executed.final_state.dq = Eigen::VectorXd::Zero(6);
    executed.steps[2].before.q[1] = value;
    executed.chunk = static_cast<int>(sequence);
    executed.sequence = ++sequence;
    ASSERT_TRUE(session->Feedback(executed).ok());
  }
  EXPECT_EQ(session->Counters()->steps_impossible, 6u);
}

TEST(ImpossibleMeasurements, AreTheSameInAReplay) {
  // Whatever the journal holds is masked again: no mask is written.
  Rig rig;
  ExecutedChunk chunk =
      ToyArm(0.6).Execute(ConstantPrediction(Eigen::VectorXf::Constant(7, 0.3f), 5), 5);
  chunk.steps[1].before.tool.p_base_tool[0] = 1e30;
  const std::vector<bool> impossible = ImpossibleSteps(chunk);
  EXPECT_EQ(ImpossibleSteps(WithMasked(chunk, impossible)), impossible);
  EXPECT_TRUE(chunk.masked.empty());
}

// ------------------------------------------------------------------------------- what keeps finite

TEST(NominalArmState, StaysWhereItIsWhenTheStepsOfALongControlPeriodDiverge) {
  NominalArmOptions options;
  options.control_period_s = 100;
  NominalArm arm(options);
  for (int i = 0; i < 200; ++i) {
    EXPECT_TRUE(arm.Step(NominalArm::Vector6::Constant(i % 2 ? 1 : -1)).allFinite());
    EXPECT_TRUE(NominalArm::Holds(arm.state()));
  }
}

TEST(CommandCorrectionState, IsKeptWhereAChunkWouldMakeItNoNumber) {
  const SessionSpec spec = Spec("direct");
  const ResidualOptions residual = ResidualOptionsOf(*spec.method);
  CommandCorrection correction(*spec.method, residual, {});
  ExecutedChunk chunk =
      ToyArm(0.6).Execute(ConstantPrediction(Eigen::VectorXf::Constant(7, 0.3f), 5), 5);
  correction.Observe(chunk);
  const Eigen::VectorXd before = correction.Value();
  ASSERT_EQ(before.size(), 7);
  chunk.steps[2].before.tool.p_base_tool[0] = 1e308;
  chunk.steps[3].before.tool.p_base_tool[0] = -1e308;
  correction.Observe(chunk);
  EXPECT_EQ(correction.Value(), before);
}

TEST(SessionPrediction, ACommandThatIsNoneIsRefusedAndNotAnswered) {
  class Absurd : public FakePolicy {
   public:
    Eigen::MatrixXf ToEnvironment(const torch::Tensor& chunk,
                                  const torch::Tensor& state) const override {
      return 1e5f * FakePolicy::ToEnvironment(chunk, state);
    }
  };
  Rig rig;
  rig.policy = std::make_shared<Absurd>();
  const auto session = rig.Open(Spec("base"));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  const auto prediction = session->Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 0}, 0);
  EXPECT_EQ(prediction.status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(prediction.status().message()), HasSubstr("not finite, or above 1000"));
}

}  // namespace
}  // namespace robostress
