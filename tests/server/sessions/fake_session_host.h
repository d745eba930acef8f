#pragma once

#include <map>
#include <new>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "server/sessions/session_host.h"

namespace robostress {

// Sessions that answer at once: row i of every chunk is i, plus the number of the prediction.
class FakeSessionHost : public SessionHost {
 public:
  FakeSessionHost() {
    spec.name = "fake";
    spec.cameras = {"agentview", "wrist"};
    spec.image_width = spec.image_height = 4;
    spec.state_dim = 8;
    spec.action_dim = 7;
    spec.horizon = 10;
    spec.execute_steps = 5;
    spec.adaptable = true;
  }

  std::vector<PolicySpec> policies() const override { return {spec}; }
  absl::StatusOr<Opened> OpenSession(const Caller&, const SessionSpec& session) override {
    absl::MutexLock lock(&mu);
    const std::string id = absl::StrCat("session-", ++opened);
    sessions[id] = session;
    return Opened{id, "secret", spec, false};
  }
  absl::StatusOr<Resumed> ResumeSession(const Caller&, const std::string& id,
                                        const std::string& token) override {
    absl::MutexLock lock(&mu);
    if (sessions.count(id) == 0) return absl::NotFoundError("no such session");
    if (token != "secret") return absl::PermissionDeniedError("not its token");
    Resumed resumed{spec, false, taken.size()};
    if (!episodes.empty()) resumed.episode = episodes.back();
    resumed.next_chunk = chunks.empty() ? 0 : chunks.back() + 1;
    resumed.control_period_s = sessions.at(id).control_period_s;
    return resumed;
  }
  absl::Status CloseSession(const Caller&, const std::string& id) override {
    absl::MutexLock lock(&mu);
    return sessions.erase(id) == 1 ? absl::OkStatus() : absl::NotFoundError("no such session");
  }
  void Attach(const std::string&) override {}
  void Detach(const std::string&) override {}
  absl::Status StartEpisode(const Caller&, const std::string&, const EpisodeKey& key,
                            uint64_t) override {
    absl::MutexLock lock(&mu);
    episodes.push_back(key);
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Caller&, const std::string&,
                                         const Observation& observation, const EpisodeKey& key,
                                         int chunk, uint64_t) override {
    absl::MutexLock lock(&mu);
    if (out_of_memory) throw std::bad_alloc();
    observations.push_back(observation);
    chunks.push_back(chunk);
    PredictedChunk prediction;
    prediction.prediction_id = observations.size();
    prediction.actions = Eigen::MatrixXf(spec.horizon, spec.action_dim);
    for (int i = 0; i < spec.horizon; ++i)
      prediction.actions.row(i).setConstant(static_cast<float>(prediction.prediction_id) +
                                            0.01f * static_cast<float>(i));
    prediction.policy_actions = prediction.actions;
    prediction.adapter_version = 3;
    predictions.push_back({key, chunk, prediction});
    return prediction;
  }
  absl::StatusOr<Recalled> Recall(const Caller&, const std::string&, uint64_t id) override {
    absl::MutexLock lock(&mu);
    if (id == 0) id = predictions.size();
    if (id == 0 || id > predictions.size())
      return absl::FailedPreconditionError(absl::StrCat("prediction ", id, " is not held"));
    return predictions[id - 1];
  }
  absl::StatusOr<std::optional<Acknowledged>> Repeated(const Caller&, const std::string&,
                                                       uint64_t sequence) override {
    absl::MutexLock lock(&mu);
    if (sequence > taken.size()) return std::nullopt;
    return Acknowledged{taken.size(), 2, false, true};
  }
  absl::StatusOr<Acknowledged> Feedback(const Caller&, const std::string&,
                                        const ExecutedChunk& chunk) override {
    absl::MutexLock lock(&mu);
    const bool duplicate = chunk.sequence <= taken.size();
    if (!duplicate) taken.push_back(chunk);
    return Acknowledged{taken.size(), 2, false, duplicate};
  }

  PolicySpec spec;
  absl::Mutex mu;
  int opened = 0;
  bool out_of_memory = false;
  std::map<std::string, SessionSpec> sessions;
  std::vector<EpisodeKey> episodes;
  std::vector<Observation> observations;
  std::vector<int> chunks;
  std::vector<Recalled> predictions;
  std::vector<ExecutedChunk> taken;
};

}  // namespace robostress
