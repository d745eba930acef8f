// Microseconds that a correction costs around a chunk of five steps: predict, five commands,
// feedback, beside a policy that computes nothing. `base` is the decorator that corrects nothing.
#include <benchmark/benchmark.h>

#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

constexpr int kHorizon = 10, kExecuted = 5;

class Nothing : public PolicyEndpoint {
 public:
  Nothing() {
    spec_.horizon = kHorizon;
    spec_.execute_steps = kExecuted;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override { return chunk_; }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }

 private:
  PolicySpec spec_;
  PredictedChunk chunk_ = ConstantPrediction(0.4f * Eigen::VectorXf::Unit(7, 0), kHorizon);
};

void Chunk(benchmark::State& state, const char* method) {
  Nothing policy;
  auto compensated = *CompensatedPolicy::Create(&policy, {}, *MakeMethod(method));
  (void)compensated->StartEpisode({});
  ToyArm arm(0.1);
  uint64_t sequence = 0;
  for ([[maybe_unused]] auto _ : state) {
    const PredictedChunk predicted = *compensated->Predict({}, 0);
    ExecutedChunk executed;
    executed.sequence = ++sequence;
    executed.prediction_id = predicted.prediction_id;
    executed.final_state = arm.state();
    for (int row = 0; row < kExecuted; ++row) {
      ExecutedStep step;
      step.sent_command = *compensated->NextCommand(predicted, executed);
      step.before = arm.state();
      step.policy_command = predicted.policy_actions.row(row);
      arm.Step(step.sent_command);
      executed.steps.push_back(std::move(step));
      executed.final_state = arm.state();
    }
    (void)compensated->SendFeedback(std::move(executed));
  }
}
BENCHMARK_CAPTURE(Chunk, base, "base")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(Chunk, every_chunk, "ours_following")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(Chunk, every_step, "ours_following_step")->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
