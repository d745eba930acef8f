#include "server/inference/batcher.h"

#include <pthread.h>
#include <torch/types.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/thrown_status.h"
#include "common/rollout/refusal.h"
#include "server/inference/torch_threads.h"
#include "server/inference/without_exceptions.h"
#include "server/operations/span_trace.h"

namespace robostress {
namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr auto kCancelPoll = std::chrono::milliseconds(20);
constexpr char kGivenUp[] = "the client gave the prediction up";
constexpr double kAverageWeight = 0.1;  // of a new value in a moving average

double Seconds(SteadyClock::duration d) { return std::chrono::duration<double>(d).count(); }

void UpdateAverage(double value, double& average) {
  average = average == 0 ? value : average + kAverageWeight * (value - average);
}

MonotonicTime After(MonotonicTime start, absl::Duration d) {
  if (start == MonotonicTime::max() || d >= absl::Hours(24 * 365)) return MonotonicTime::max();
  return start + absl::ToChronoNanoseconds(d);
}

}  // namespace

// Owned by the queue or a thread while it is computed, and by the caller that waits.
struct Batcher::Pending : QueuedRequest {
  const PredictionJob* job = nullptr;
  std::shared_ptr<PredictionTrace> trace;
  MonotonicTime started;
  SampledPrediction result;
  absl::Status status;
  bool done = false;  // guarded by mu_
  std::condition_variable answered;
};

namespace {

// A row of a pass: one chunk to sample.
struct Row {
  size_t prediction;  // of the batch
  bool base;
  const LoraWeights* lora;
};

}  // namespace

Batcher::Shown::Shown(Metrics* metrics) {
  if (metrics == nullptr) return;
  const auto refused = [metrics](const char* reason) {
    return metrics->AddCounter("robostress_predictions_refused_total",
                               "Predictions that were not computed, by reason.",
                               {{"reason", reason}});
  };
  batch_size = metrics->AddHistogram("robostress_batch_size", "Predictions computed in one pass.",
                                     CountBounds());
  waiting = metrics->AddGauge("robostress_predictions_waiting",
                              "Predictions that wait for a place in a batch.");
  predictions = metrics->AddCounter("robostress_predictions_total", "Predictions computed.");
  overloaded = refused("overload");
  late = refused("deadline");
  replaced = refused("replaced");
  cancelled = refused("cancelled");
}

Batcher::Batcher(const BatcherOptions& options, UpdatePacer* pacer, Metrics* metrics)
    : options_(options), pacer_(pacer), shown_(metrics), queue_(options.queue) {
  for (int i = 0; i < options.threads; ++i) threads_.emplace_back([this, i] { Run(i); });
}

void Batcher::Stop() {
  {
    const StdLock lock(mu_);
    stopped_ = true;
    for (const RequestQueue::Request& request : queue_.RemoveSession(0)) {
      Finish(static_cast<Pending&>(*request), absl::CancelledError("the server stops"));
    }
  }
  work_.notify_all();
  for (std::thread& thread : threads_) thread.join();
  threads_.clear();
}

void Batcher::Cancel(uint64_t session) {
  const StdLock lock(mu_);
  for (const RequestQueue::Request& request : queue_.RemoveSession(session)) {
    Finish(static_cast<Pending&>(*request), absl::CancelledError("the session was closed"));
  }
}

Batcher::Counters Batcher::counters() const {
  const StdLock lock(mu_);
  Counters counters = counters_;
  counters.waiting = queue_.size();
  return counters;
}

void Batcher::Finish(Pending& pending, absl::Status status) {
  const auto count = [](uint64_t& own, const std::shared_ptr<Counter>& shown) {
    ++own;
    if (shown != nullptr) shown->Increment();
  };
  if (absl::IsResourceExhausted(status)) count(counters_.overloaded, shown_.overloaded);
  if (absl::IsDeadlineExceeded(status)) count(counters_.late, shown_.late);
  if (absl::IsAborted(status)) count(counters_.replaced, shown_.replaced);
  if (absl::IsCancelled(status)) count(counters_.cancelled, shown_.cancelled);
  if (shown_.waiting != nullptr) shown_.waiting->Set(queue_.size());
  pending.status = std::move(status);
  pending.done = true;
  pending.answered.notify_one();
}

void Batcher::Answer(const RequestQueue::Refused& refused) {
  for (const auto& [request, status] : refused) Finish(static_cast<Pending&>(*request), status);
}

absl::Duration Batcher::RetryAfterNow() const {
  const double seconds = prediction_seconds_ * queue_.size() / std::max(1, options_.threads);
  return std::clamp(absl::Seconds(seconds), absl::Milliseconds(10), absl::Seconds(30));
}

absl::StatusOr<SampledPrediction> Batcher::Predict(const PredictionJob& job) {
  const auto pending = std::make_shared<Pending>();
  pending->job = &job;
  pending->trace = PredictionTrace::Current();
  pending->session = job.session;
  pending->priority = job.priority;
  pending->replaceable = job.replaceable;
  pending->group = job.policy.get();
  pending->alone = job.running || (job.exact && !job.policy->exact_rows());
  pending->arrival = SteadyClock::now();
  pending->deadline = After(pending->arrival, job.deadline);
  if (pacer_ != nullptr) pacer_->PredictionArrived(job.priority);
  {
    StdLock lock(mu_);
    if (stopped_) {
      Finish(*pending, absl::CancelledError("the server stops"));
    } else {
      Answer(queue_.Push(pending, RetryAfterNow()));
      if (shown_.waiting != nullptr) shown_.waiting->Set(queue_.size());
      work_.notify_one();
    }
    while (!pending->done) {
      // Wakes up for the deadline or to ask whether the client is still there.
      const MonotonicTime now = SteadyClock::now(), poll = now + kCancelPoll;
      const bool in_time = now < pending->deadline;  // otherwise it is being computed
      pending->answered.wait_until(lock.waiting(),
                                   in_time ? std::min(poll, pending->deadline) : poll);
      if (pending->done) break;
      if (job.cancelled && job.cancelled() && queue_.Remove(pending.get())) {
        Finish(*pending, absl::CancelledError(kGivenUp));
      } else if (SteadyClock::now() >= pending->deadline && queue_.Remove(pending.get())) {
        Finish(*pending, Refusal(absl::DeadlineExceededError(absl::StrCat(
                             "the observation waited its ", absl::FormatDuration(job.deadline),
                             " for a place in a batch; ", queue_.size(), " others wait"))));
      }
    }
  }
  if (pacer_ != nullptr) pacer_->PredictionAnswered(job.priority);
  if (!pending->status.ok()) return pending->status;
  return std::move(pending->result);
}

Batcher::Batch Batcher::TakeBatch() {
  StdLock lock(mu_);
  Batch batch;
  while (batch.empty()) {
    ++idle_;
    while (!stopped_ && queue_.size() == 0) work_.wait(lock.waiting());
    if (options_.window > absl::ZeroDuration()) {
      const auto enough = [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
        return stopped_ || queue_.size() == 0 || queue_.size() >= options_.max_batch;
      };
      work_.wait_until(lock.waiting(), After(queue_.oldest_arrival(), options_.window), enough);
    }
    const int idle = idle_--;  // this thread included
    if (stopped_) return {};
    // Threads that have nothing to do share what waits: cores before batches.
    const int most = std::clamp((queue_.size() + idle - 1) / idle, 1, options_.max_batch);
    RequestQueue::Refused late;
    for (const RequestQueue::Request& request :
         queue_.PopBatch(SteadyClock::now(), most, absl::Seconds(batch_seconds_), late)) {
      auto pending = std::static_pointer_cast<Pending>(request);
      if (pending->job->cancelled && pending->job->cancelled()) {
        Finish(*pending, absl::CancelledError(kGivenUp));
      } else {
        batch.push_back(std::move(pending));
      }
    }
    Answer(late);
  }
  if (queue_.size() > 0) work_.notify_one();
  return batch;
}

void Batcher::Run(int index) {
  pthread_setname_np(pthread_self(), absl::StrCat("predict-", index).c_str());
  UseOneTorchThread();
  while (true) {
    const Batch batch = TakeBatch();
    if (batch.empty()) return;
    const MonotonicTime begin = SteadyClock::now();
    Compute(batch);
    const MonotonicTime end = SteadyClock::now();
    const StdLock lock(mu_);
    const auto size = static_cast<double>(batch.size());
    UpdateAverage(Seconds(end - begin), batch_seconds_);
    UpdateAverage(Seconds(end - begin) / size, prediction_seconds_);
    ++counters_.batches;
    counters_.predictions += batch.size();
    if (shown_.batch_size != nullptr) {
      shown_.batch_size->Observe(size);
      shown_.predictions->Increment(size);
    }
    for (const auto& pending : batch) {
      pending->result.queued = absl::FromChrono(begin - pending->arrival);
      pending->result.computed = absl::FromChrono(end - begin);
      pending->result.batch_size = static_cast<int>(batch.size());
      Finish(*pending, pending->status);
    }
  }
}

void Batcher::Compute(const Batch& batch) {
  torch::NoGradGuard no_grad;
  const FlowPolicy& policy = *batch[0]->job->policy;
  const MonotonicTime begin = SteadyClock::now();
  std::vector<Row> rows;
  for (size_t i = 0; i < batch.size(); ++i) {
    Pending& pending = *batch[i];
    const PredictionJob& job = *pending.job;
    const MonotonicTime encode_begin = SteadyClock::now();
    absl::StatusOr<PolicyContext> context =
        WithoutExceptions("encoding", [&] { return policy.Encode(*job.observation); });
    if (pending.trace != nullptr) {
      pending.trace->Add("queue", pending.arrival, begin);
      pending.trace->Add("encode", encode_begin, SteadyClock::now());
    }
    if (!context.ok()) {
      pending.status = context.status();
      continue;
    }
    SampledPrediction& result = pending.result;
    result.context = *std::move(context);
    if (job.adapter) result.adapter = job.adapter();
    rows.push_back({i, false, result.adapter.get()});
    if (job.with_base && result.adapter != nullptr && result.adapter->version > 0)
      rows.push_back({i, true, nullptr});
  }
  const auto keep = [&](const Row& row, const torch::Tensor& chunk) {
    SampledPrediction& result = batch[row.prediction]->result;
    (row.base ? result.base : result.raw) = chunk;
  };
  const MonotonicTime sample_begin = SteadyClock::now();
  bool together = rows.size() > 1 && !batch[0]->alone;
  if (together) {
    try {
      std::vector<const PolicyContext*> contexts;
      std::vector<torch::Tensor> noise;
      std::vector<const LoraWeights*> lora;
      for (const Row& row : rows) {
        contexts.push_back(&batch[row.prediction]->result.context);
        noise.push_back(batch[row.prediction]->job->noise);
        lora.push_back(row.lora);
      }
      const torch::Tensor chunks =
          policy.SampleRows(StackContexts(contexts), at::cat(noise, 0), lora);
      for (size_t i = 0; i < rows.size(); ++i)
        keep(rows[i], chunks[static_cast<int64_t>(i)].clone());
    } catch (const std::exception&) {
      together = false;  // below: each alone, which tells whose fault it is
    }
  }
  if (!together) {
    for (const Row& row : rows) {
      Pending& pending = *batch[row.prediction];
      try {
        const PolicyContext& context = pending.result.context;
        const torch::Tensor& noise = pending.job->noise;
        keep(row,
             (pending.job->running ? policy.Inpaint(context, noise, row.lora, *pending.job->running)
                                   : policy.Sample(context, noise, row.lora))
                 .squeeze(0));
      } catch (const std::exception& error) {
        pending.status = ThrownStatus("prediction", error);
      }
    }
  }
  for (const auto& pending : batch) {
    if (pending->trace != nullptr) pending->trace->Add("sample", sample_begin, SteadyClock::now());
  }
}

}  // namespace robostress
