#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/std_mutex.h"
#include "server/inference/request_queue.h"
#include "server/inference/update_pacer.h"
#include "server/operations/metrics.h"
#include "server/policies/policy.h"

namespace robostress {

struct BatcherOptions {
  int threads = 2;    // batches computed at once, each on one core (a policy may use more)
  int max_batch = 8;  // predictions of one batch, at most; 1: none is batched
  // A batch that is not full waits so long for more, from its first arrival. Zero: it takes what
  // has come while the batch before it was computed.
  absl::Duration window = absl::ZeroDuration();
  RequestQueueOptions queue;
};

// One prediction to compute.
struct PredictionJob {
  std::shared_ptr<const FlowPolicy> policy;
  std::shared_ptr<const Observation> observation;
  torch::Tensor noise;  // [1, K, d]
  // The adapter, asked for when the batch is put together, so that it is the last published one;
  // may be empty or return null.
  std::function<std::shared_ptr<const LoraWeights>()> adapter;
  bool with_base = false;  // the unadapted policy's chunk beside it
  // What the chunk goes on from (FlowPolicy::Inpaint); such a job is sampled alone.
  std::optional<RunningRows> running;
  bool exact = true;  // lockstep: the bits of a batch of one
  uint64_t session = 0;
  Priority priority = Priority::kSimulation;
  absl::Duration deadline = absl::InfiniteDuration();  // from now on
  bool replaceable = false;                            // async (QueuedRequest)
  // Asked every 20 ms while it waits and once before it is computed, any thread, with the batcher's
  // lock held; may be empty.
  std::function<bool()> cancelled;
};

struct SampledPrediction {
  PolicyContext context;  // of the observation
  torch::Tensor raw;      // [K, d] model space
  torch::Tensor base;     // [K, d]; undefined unless asked for and the adapter has learned
  std::shared_ptr<const LoraWeights> adapter;  // that predicted; may be null
  absl::Duration queued, computed;
  int batch_size = 0;  // predictions computed together
};

// Computes the predictions of all sessions, several in one pass where they wait at the same time,
// each with its own adapter. Observations are encoded one by one, so that a prefix has the same
// bits whenever it is encoded again; chunks are sampled together. A job that must be exact shares a
// pass only where the policy proves that its rows have the bits of batches of one
// (FlowPolicy::exact_rows), otherwise it is alone. When a pass fails, its predictions are computed
// one by one, so that one cannot take others down.
class Batcher {
 public:
  struct Counters {
    uint64_t predictions = 0, batches = 0;
    uint64_t overloaded = 0, late = 0, replaced = 0, cancelled = 0;  // refused
    int waiting = 0;                                                 // now
  };

  // `pacer` and `metrics` may be null; they must outlive this.
  explicit Batcher(const BatcherOptions& options, UpdatePacer* pacer = nullptr,
                   Metrics* metrics = nullptr);
  ~Batcher() { Stop(); }

  // Any thread; waits for the answer. RESOURCE_EXHAUSTED with RetryAfter: overload;
  // DEADLINE_EXCEEDED: the deadline cannot be kept; ABORTED: a newer observation of the session
  // came; CANCELLED.
  absl::StatusOr<SampledPrediction> Predict(const PredictionJob& job);
  // What waits of a session is answered CANCELLED.
  void Cancel(uint64_t session);
  // Ends intake, answers what waits with CANCELLED, completes what runs, joins.
  void Stop();

  Counters counters() const;
  const BatcherOptions& options() const { return options_; }

 private:
  struct Pending;
  // What Prometheus sees of it; all null without metrics.
  struct Shown {
    explicit Shown(Metrics* metrics);
    std::shared_ptr<Histogram> batch_size;
    std::shared_ptr<Gauge> waiting;
    std::shared_ptr<Counter> predictions, overloaded, late, replaced, cancelled;
  };
  using Batch = std::vector<std::shared_ptr<Pending>>;

  void Run(int index);
  // Waits for work; empty: stopped.
  Batch TakeBatch();
  void Compute(const Batch& batch);
  void Answer(const RequestQueue::Refused& refused) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Finish(Pending& pending, absl::Status status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Duration RetryAfterNow() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const BatcherOptions options_;
  UpdatePacer* const pacer_;
  const Shown shown_;
  mutable StdMutex mu_;
  std::condition_variable work_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  RequestQueue queue_ ABSL_GUARDED_BY(mu_);
  int idle_ ABSL_GUARDED_BY(mu_) = 0;                   // threads that wait for work
  double batch_seconds_ ABSL_GUARDED_BY(mu_) = 0;       // of a pass, moving average
  double prediction_seconds_ ABSL_GUARDED_BY(mu_) = 0;  // the same, per prediction
  Counters counters_ ABSL_GUARDED_BY(mu_);

  std::vector<std::thread> threads_;
};

}  // namespace robostress
