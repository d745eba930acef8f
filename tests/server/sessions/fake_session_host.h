#pragma once

#include <map>
#include <memory>
#include <new>
#include <optional>
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
  absl::StatusOr<Opened> Open(const Caller&, const SessionSpec& session, const SessionScheduling&,
                              const GuardOptions*) override {
    absl::MutexLock lock(&mu);
    const std::string id = absl::StrCat("session-", ++opened);
    sessions[id] = session;
    return Opened{id, "secret", spec, false, session.control_period_s, {}};
  }
  absl::StatusOr<Opened> Resume(const Caller&, const std::string& id,
                                const std::string& token) override {
    absl::MutexLock lock(&mu);
    if (sessions.count(id) == 0) return absl::NotFoundError("no such session");
    if (token != "secret") return absl::PermissionDeniedError("not its token");
    Opened resumed{id, "", spec, false, sessions.at(id).control_period_s, {}};
    resumed.at.feedback_sequence = taken.size();
    if (!episodes.empty()) resumed.at.episode = episodes.back();
    resumed.at.next_chunk = chunks.empty() ? 0 : chunks.back() + 1;
    return resumed;
  }
  absl::Status Close(const Caller&, const std::string& id) override {
    absl::MutexLock lock(&mu);
    return sessions.erase(id) == 1 ? absl::OkStatus() : absl::NotFoundError("no such session");
  }
  void Attach(const std::string&) override {}
  void Detach(const std::string&) override {}
  absl::StatusOr<std::unique_ptr<SessionUse>> Use(const Caller&, const std::string&) override {
    absl::MutexLock lock(&mu);
    ++uses;
    return std::make_unique<FakeUse>(this);
  }

  class FakeUse : public SessionUse {
   public:
    explicit FakeUse(FakeSessionHost* host) : host_(*host) {}
    absl::Status StartEpisode(const EpisodeKey& key, uint64_t) override {
      absl::MutexLock lock(&host_.mu);
      host_.episodes.push_back(key);
      return absl::OkStatus();
    }
    absl::StatusOr<PredictedChunk> Predict(std::shared_ptr<const Observation> observation,
                                           const ChunkKey& key, uint64_t, PredictOptions how,
                                           std::chrono::steady_clock::time_point) override {
      absl::MutexLock lock(&host_.mu);
      if (host_.out_of_memory) throw std::bad_alloc();
      host_.observations.push_back(*observation);
      host_.chunks.push_back(key.chunk);
      host_.running.push_back(std::move(how.running));
      PredictedChunk prediction;
      prediction.prediction_id = host_.observations.size();
      prediction.actions = Eigen::MatrixXf(host_.spec.horizon, host_.spec.action_dim);
      for (int i = 0; i < host_.spec.horizon; ++i)
        prediction.actions.row(i).setConstant(static_cast<float>(prediction.prediction_id) +
                                              0.01f * static_cast<float>(i));
      prediction.policy_actions = prediction.actions;
      prediction.adapter_version = 3;
      host_.predictions.push_back({key, prediction});
      return prediction;
    }
    absl::StatusOr<Recalled> Recall(uint64_t id) override {
      absl::MutexLock lock(&host_.mu);
      if (id == 0) id = host_.predictions.size();
      if (id == 0 || id > host_.predictions.size())
        return absl::FailedPreconditionError(absl::StrCat("prediction ", id, " is not held"));
      return host_.predictions[id - 1];
    }
    std::optional<FeedbackResult> Repeated(uint64_t sequence) override {
      absl::MutexLock lock(&host_.mu);
      if (sequence > host_.taken.size()) return std::nullopt;
      return FeedbackResult{
          .sequence = host_.taken.size(), .updates_applied = 2, .duplicate = true};
    }
    absl::StatusOr<FeedbackResult> Feedback(const ExecutedChunk& chunk) override {
      absl::MutexLock lock(&host_.mu);
      const bool duplicate = chunk.sequence <= host_.taken.size();
      if (!duplicate) host_.taken.push_back(chunk);
      return FeedbackResult{
          .sequence = host_.taken.size(), .updates_applied = 2, .duplicate = duplicate};
    }

   private:
    FakeSessionHost& host_;
  };

  PolicySpec spec;
  absl::Mutex mu;
  int opened = 0, uses = 0;
  bool out_of_memory = false;
  std::map<std::string, SessionSpec> sessions;
  std::vector<EpisodeKey> episodes;
  std::vector<Observation> observations;
  std::vector<int> chunks;
  std::vector<std::optional<RunningRows>> running;
  std::vector<SessionUse::Recalled> predictions;
  std::vector<ExecutedChunk> taken;
};

}  // namespace robostress
