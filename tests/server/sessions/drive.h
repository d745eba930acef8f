#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "adapter/adaptation_state.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "server/sessions/session.h"
#include "tests/adapter/fake_policy.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {

// learning_rate=0.01: large enough to show in float32 after one step.
inline constexpr char kRate[] = "learning_rate=0.01";

// A session on a fake policy with everything that it needs.
struct Rig {
  explicit Rig(int threads = 2) : adaptation(threads), inference(BatcherOptions{threads}) {}

  std::shared_ptr<Session> Open(const SessionSpec& spec,
                                absl::Duration timeout = absl::Seconds(20)) {
    auto session = Session::Create(spec, {policy, &adaptation, &inference, timeout}, ++last_owner);
    EXPECT_TRUE(session.ok()) << session.status();
    return *session;
  }

  std::shared_ptr<FakePolicy> policy = std::make_shared<FakePolicy>();
  AdaptationLoop adaptation;
  Batcher inference;
  uint64_t last_owner = 0;
};

inline SessionSpec Spec(const std::string& method, const std::vector<std::string>& overrides = {}) {
  SessionSpec spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = "fake";
  spec.control_space = ControlSpace::kEndEffector;
  spec.seed = 3;
  spec.method = *MakeMethod(method, overrides);
  return spec;
}

// A client with a toy arm: predicts, executes five steps, reports. The observation follows the arm,
// so that what a session did earlier shows in everything later.
class Client {
 public:
  explicit Client(std::shared_ptr<Session> session, double gain = 0.6)
      : session_(std::move(session)), arm_(gain) {}

  void StartEpisode(int task, int episode) {
    task_ = task;
    episode_ = episode;
    chunk_ = 0;
    const absl::Status status = session_->StartEpisode({task, episode}, sequence_);
    ASSERT_TRUE(status.ok()) << status;
  }

  PredictedChunk Predict() {
    Observation observation = FakePolicy::MakeObservation(chunk_);
    observation.proprioception = arm_.state().tool.p_base_tool.cast<float>();
    auto prediction =
        session_->Predict(Shared(observation), {{task_, episode_}, chunk_++}, sequence_);
    EXPECT_TRUE(prediction.ok()) << prediction.status();
    return *prediction;
  }

  ExecutedChunk Execute(const PredictedChunk& prediction, int steps = 5) {
    ExecutedChunk executed = arm_.Execute(prediction, steps);
    executed.sequence = ++sequence_;
    executed.task = task_;
    executed.episode = episode_;
    executed.chunk = chunk_ - 1;
    return executed;
  }

  void Send(const ExecutedChunk& executed) {
    const auto result = session_->Feedback(executed);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->sequence, executed.sequence);
  }

  // One chunk there and back.
  PredictedChunk RunChunk(int steps = 5) {
    const PredictedChunk prediction = Predict();
    Send(Execute(prediction, steps));
    return prediction;
  }

  void RunChunks(int chunks) {
    for (int i = 0; i < chunks; ++i) RunChunk();
  }

  uint64_t updates() { return session_->Counters()->stats.updates_applied; }
  Session& session() { return *session_; }
  void set_session(std::shared_ptr<Session> session) { session_ = std::move(session); }
  void set_sequence(uint64_t sequence) { sequence_ = sequence; }
  uint64_t sequence() const { return sequence_; }

 private:
  std::shared_ptr<Session> session_;
  ToyArm arm_;
  int task_ = 0, episode_ = 0, chunk_ = 0;
  uint64_t sequence_ = 0;
};

inline std::string ExportOf(Session& session) {
  auto state = session.Export();
  EXPECT_TRUE(state.ok()) << state.status();
  return state->safetensors;
}

inline AdaptationState StateOf(Rig& rig, Session& session) {
  auto state = ParseAdaptationState("export", ExportOf(session), *rig.policy, "fake-hash");
  EXPECT_TRUE(state.ok()) << state.status();
  return *state;
}

}  // namespace robostress
