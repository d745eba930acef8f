#pragma once

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/operations/metrics.h"

namespace robostress {

// One session as it stands, as its owner knows it.
struct SessionFigures {
  std::string id;
  SessionSpec spec;
  bool open = true;   // in memory
  double idle_s = 0;  // since its last message [s]
  uint64_t feedback_sequence = 0, predictions = 0, duplicates = 0, rollbacks = 0;
  uint64_t steps_impossible = 0;  // masked by the server
  uint64_t updates_applied = 0, updates_refused = 0, updates_guarded = 0;
  double adapter_distance = 0;  // ||phi - phi_0||_2
  double last_loss = 0;
  int buffered_chunks = 0;
  uint64_t journal_bytes = 0;       // since the last snapshot
  uint64_t snapshots_failed = 0;    // that could not be written
  uint64_t predictions_unkept = 0;  // that the disk had no room for
  std::string error;                // why it computes no further
};

// What a server remembers of its sessions for people and dashboards: residuals over time, drift,
// latencies, last images. Bounded per session. Learns nothing and decides nothing. Any thread.
class Telemetry {
 public:
  static constexpr size_t kHistory = 240;  // points of every curve; then the oldest go
  // Sessions that are remembered though no Refresh has named them: where nobody asks, those used
  // last.
  static constexpr size_t kUnlisted = 64;
  // Of a session's images; the last ones keep their observation alive.
  static constexpr std::chrono::milliseconds kImagePeriod{500};

  // One executed chunk.
  struct ResidualPoint {
    uint64_t sequence = 0;
    Eigen::VectorXd mean_abs;  // [action_dim - 1] mean over the steps of |eta|, normalised; joint
                               // space: rad
  };
  struct DriftPoint {
    uint64_t version = 0;
    double distance = 0, loss = 0;
  };
  // Of one session, for a page.
  struct View {
    SessionFigures figures;
    std::vector<ResidualPoint> residuals;
    std::vector<DriftPoint> drift;
    std::vector<double> latencies_s;  // of predictions, as the server sees them
    std::vector<std::string> cameras;
    uint64_t image_count = 0;  // changes when the images do
  };

  explicit Telemetry(Metrics* metrics);

  // A prediction of a session was answered, `seconds` after it came in.
  void Predicted(const std::string& session, const std::shared_ptr<const Observation>& observation,
                 double seconds) ABSL_LOCKS_EXCLUDED(mu_);
  // An executed chunk was taken; `residual` [steps, action_dim] as the session sees it.
  void Reported(const std::string& session, const SessionSpec& spec, uint64_t sequence,
                const Eigen::MatrixXd& residual) ABSL_LOCKS_EXCLUDED(mu_);
  // Where its adapter stands; the same version again is no new point.
  void Adapted(const std::string& session, const DriftPoint& point) ABSL_LOCKS_EXCLUDED(mu_);
  // It was closed, and stood at `last`: what it did since Refresh is counted. Null: nobody knows.
  void Forget(const std::string& session, const SessionFigures* last = nullptr)
      ABSL_LOCKS_EXCLUDED(mu_);
  // All sessions as they stand: sets gauges, counts outcomes since the last call, and forgets those
  // that are gone.
  void Refresh(const std::vector<SessionFigures>& sessions) ABSL_LOCKS_EXCLUDED(mu_);

  std::vector<View> Views() const ABSL_LOCKS_EXCLUDED(mu_);
  // Null: none.
  std::shared_ptr<const Image> LastImage(const std::string& session,
                                         const std::string& camera) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  using Clock = std::chrono::steady_clock;
  struct Record {
    SessionFigures figures;
    bool listed = false;  // in the last Refresh
    std::deque<ResidualPoint> residuals;
    std::deque<DriftPoint> drift;
    std::deque<double> latencies_s;
    std::map<std::string, std::shared_ptr<const Image>> images;
    uint64_t image_count = 0;
    Clock::time_point image_time{}, used{};
  };

  // Counts what happened between the record's figures and `now`.
  void CountOutcomes(const Record& record, const SessionFigures& now)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Of a session that is used now.
  Record& Used(const std::string& session) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Metrics* const metrics_;
  const std::shared_ptr<Histogram> predict_seconds_;
  const std::shared_ptr<Counter> predictions_, chunks_;

  mutable absl::Mutex mu_;
  std::map<std::string, Record> records_ ABSL_GUARDED_BY(mu_);
};

// "x", "y", "z", "roll", "pitch", "yaw" of an end-effector residual, "joint_1" .. in joint space.
std::string ResidualAxis(const SessionSpec& spec, int index);

}  // namespace robostress
