#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "server/operations/metrics.h"

namespace robostress {

// Where the time of one prediction went: spans named by stage (decode, await_feedback, queue,
// encode, sample, reply ...), by the monotonic clock, which no change of the time of day moves.
// Spans may come from several threads, e.g. a batcher's.
class PredictionTrace {
 public:
  using Clock = std::chrono::steady_clock;
  struct Span {
    const char* stage;  // a literal
    Clock::time_point begin, end;
  };

  PredictionTrace(std::string session, int task, int episode, int chunk)
      : session_(std::move(session)), task_(task), episode_(episode), chunk_(chunk) {}
  void Add(const char* stage, Clock::time_point begin, Clock::time_point end)
      ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<Span> spans() const ABSL_LOCKS_EXCLUDED(mu_);
  const std::string& session() const { return session_; }
  // "task 0 episode 3 chunk 12"
  std::string step() const;

  // The trace of the prediction that this thread computes; null outside of one. It saves every
  // function between a handler and the policy a parameter that it only passes on.
  static const std::shared_ptr<PredictionTrace>& Current();

 private:
  friend class TraceScope;
  const std::string session_;
  const int task_, episode_, chunk_;
  mutable absl::Mutex mu_;
  std::vector<Span> spans_ ABSL_GUARDED_BY(mu_);
};

// Makes a trace this thread's current one.
class TraceScope {
 public:
  explicit TraceScope(std::shared_ptr<PredictionTrace> trace);
  ~TraceScope();
  TraceScope(const TraceScope&) = delete;
  TraceScope& operator=(const TraceScope&) = delete;

 private:
  std::shared_ptr<PredictionTrace> before_;
};

// Adds a span from here to the end of the block to the current trace; nothing without one.
//   { const StageTimer timer("encode"); context = policy.Encode(observation); }
class StageTimer {
 public:
  explicit StageTimer(const char* stage)
      : stage_(stage), trace_(PredictionTrace::Current()), begin_(PredictionTrace::Clock::now()) {}
  ~StageTimer() {
    if (trace_ != nullptr) trace_->Add(stage_, begin_, PredictionTrace::Clock::now());
  }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  const char* stage_;
  const std::shared_ptr<PredictionTrace> trace_;
  const PredictionTrace::Clock::time_point begin_;
};

// The last predictions' traces, and robostress_stage_seconds{stage} of all. Any thread.
class TraceLog {
 public:
  // Beyond `kept` the oldest are dropped.
  explicit TraceLog(Metrics* metrics, size_t kept = 256) : metrics_(metrics), kept_(kept) {}
  void Finish(std::shared_ptr<const PredictionTrace> trace) ABSL_LOCKS_EXCLUDED(mu_);
  // Trace event JSON, as Perfetto and chrome://tracing open it: one process per session.
  std::string Json() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  Metrics* const metrics_;
  const size_t kept_;
  mutable absl::Mutex mu_;
  std::deque<std::shared_ptr<const PredictionTrace>> traces_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
