// What the C++ kernels do with drawn inputs, as raw doubles: package_test.py draws the same. Or
// what a sub-step of theirs costs.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/scenarios.h"
#include "common/joint_errors/sub_step.h"
#include "common/random.h"
#include "common/so3.h"

namespace robostress {
namespace {

constexpr int kPandaJoints = 7, kSubSteps = 75, kChunks = 8, kChunkRows = 5;
using Vector7d = Eigen::Matrix<double, kPandaJoints, 1>;

Vector7d Drawn(RandomStream& stream, double scale) {
  return Vector7d::NullaryExpr([&] { return scale * stream.Normal(); });
}

struct DrawnArm {
  explicit DrawnArm(RandomStream& stream)
      : q(Drawn(stream, 1)),
        dq(Drawn(stream, 0.3)),
        gravity(Drawn(stream, 10)),
        payload_gravity(Drawn(stream, 3)),
        payload_inertia(Drawn(stream, 0.2)),
        asked(Drawn(stream, 40)) {}
  std::vector<JointMoment> Describe(const JointChain& chain, int sub_step) const {
    std::vector<JointMoment> moments(kPandaJoints);
    for (int i = 0; i < kPandaJoints; ++i) {
      moments[static_cast<size_t>(i)] = {.t = 0.002 * sub_step,
                                         .h = 0.002,
                                         .q = chain.MotorAngle(i, q[i]),
                                         .dq = dq[i],
                                         .gravity = gravity[i],
                                         .payload_gravity = payload_gravity[i],
                                         .payload_inertia = payload_inertia[i]};
    }
    return moments;
  }
  Vector7d q, dq, gravity, payload_gravity, payload_inertia, asked;
};

struct FreePlant {
  using Inverse = Eigen::Matrix<double, kPandaJoints, kPandaJoints>;
  double rest = 0, h = 0.002;
  Vector7d Limited(const Vector7d& torque) const {
    return torque.cwiseMax(Vector7d::Constant(-60)).cwiseMin(Vector7d::Constant(60));
  }
  Vector7d Net(const Vector7d& torque) const { return torque; }
  Inverse MassMatrix() const { return Inverse::Identity(); }
  Vector7d Velocities() const { return Vector7d::Zero(); }
};

// (applied, change) of a sub-step.
std::pair<Vector7d, Vector7d> SubStep(JointChain& chain, const DrawnArm& arm, int sub_step) {
  chain.BeginSubStep(0.002);
  std::vector<JointMoment> moments = arm.Describe(chain, sub_step);
  const Vector7d none = Vector7d::Zero();
  const Vector7d applied =
      SubStepTorque(chain, absl::MakeSpan(moments), arm.asked, none, FreePlant());
  Vector7d change = Vector7d::Zero();
  for (JointMoment& m : moments) m.q += m.h * m.dq;
  chain.MoveErrors({arm.q.data(), 7}, {applied.data(), 7}, 0.002, {change.data(), 7});
  chain.MoveEffects(moments, {change.data(), 7});
  return {applied, change};
}

JointChain Begin(const std::string& scenario, const DrawnArm& arm) {
  JointChain chain(kPandaJoints);
  chain.SetScenario(*MakeScenario(scenario, 5), 300);
  std::vector<JointMoment> moments = arm.Describe(chain, 0);
  for (size_t i = 0; i < moments.size(); ++i) moments[i].dq = 0;
  chain.Reset(moments);
  return chain;
}

void Write(const double* values, Eigen::Index count) {
  std::fwrite(values, sizeof(double), static_cast<size_t>(count), stdout);
}

void WriteErrors(const std::string& scenario) {
  RandomStream stream(StreamKey("package test").With(scenario));
  JointChain chain = Begin(scenario, DrawnArm(stream));
  for (int sub_step = 0; sub_step < kSubSteps; ++sub_step) {
    if (sub_step % 25 == 0) chain.BeginControlStep(sub_step / 25, sub_step >= 25);
    const auto [applied, change] = SubStep(chain, DrawnArm(stream), sub_step);
    Write(applied.data(), applied.size());
    Write(change.data(), change.size());
  }
}

class DrawnPolicy : public PolicyEndpoint {
 public:
  DrawnPolicy() { spec_.name = "drawn"; }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override { return chunk; }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }
  PredictedChunk chunk;

 private:
  PolicySpec spec_;
};

void WriteCompensation(const std::string& method) {
  RandomStream stream(StreamKey("package test").With(method));
  DrawnPolicy policy;
  SessionSetting setting;
  setting.control_space = ControlSpace::kEndEffector;
  const auto compensated = CompensatedPolicy::Create(&policy, setting, *MakeMethod(method));
  (void)(*compensated)->StartEpisode({});
  for (int chunk = 0; chunk < kChunks; ++chunk) {
    policy.chunk.actions.resize(kChunkRows, 7);
    for (int i = 0; i < kChunkRows; ++i)
      for (int j = 0; j < 7; ++j)
        policy.chunk.actions(i, j) = static_cast<float>(0.5 * stream.Normal());
    policy.chunk.policy_actions = policy.chunk.actions;
    const PredictedChunk sent = *(*compensated)->Predict({}, chunk);
    const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows =
        sent.actions.cast<double>();
    Write(rows.data(), rows.size());
    ExecutedChunk executed;
    executed.sequence = static_cast<uint64_t>(chunk) + 1;
    executed.chunk = chunk;
    for (int i = 0; i <= kChunkRows; ++i) {
      RobotState state;
      for (int axis = 0; axis < 3; ++axis) state.tool.p_base_tool[axis] = 0.02 * stream.Normal();
      if (i == kChunkRows) {
        executed.final_state = state;
        break;
      }
      ExecutedStep step;
      step.before = state;
      step.policy_command = sent.policy_actions.row(i).transpose();
      step.sent_command = sent.actions.row(i).transpose();
      executed.steps.push_back(step);
    }
    (void)(*compensated)->SendFeedback(executed);
  }
}

// The fastest of 200 rounds [ns].
void PrintCost(const std::string& scenario) {
  RandomStream stream(StreamKey("package test").With(scenario));
  const DrawnArm arm(stream);
  JointChain chain = Begin(scenario, arm);
  chain.BeginControlStep(0, false);
  double fastest = 1e9, sum = 0;
  for (int round = 0; round < 200; ++round) {
    const auto begin = std::chrono::steady_clock::now();
    for (int i = 0; i < 1000; ++i) sum += SubStep(chain, arm, i).first[0];
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - begin;
    fastest = std::min(fastest, took.count() / 1000);
  }
  std::printf("%.0f%s\n", fastest, sum == 0 ? " " : "");
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  if (argc > 1) {
    robostress::PrintCost(argv[1]);
    return 0;
  }
  for (const std::string& scenario : robostress::ScenarioNames()) robostress::WriteErrors(scenario);
  for (const char* method : {"base", "gain", "direct", "ours_integral", "ours_following"})
    robostress::WriteCompensation(method);
  return 0;
}
