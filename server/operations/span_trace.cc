#include "server/operations/span_trace.h"

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

std::shared_ptr<PredictionTrace>& CurrentTrace() {
  thread_local std::shared_ptr<PredictionTrace> current;
  return current;
}

}  // namespace

void PredictionTrace::Add(const char* stage, Clock::time_point begin, Clock::time_point end) {
  absl::MutexLock lock(&mu_);
  spans_.push_back({stage, begin, end});
}

std::vector<PredictionTrace::Span> PredictionTrace::spans() const {
  absl::MutexLock lock(&mu_);
  return spans_;
}

std::string PredictionTrace::step() const {
  return absl::StrCat("task ", task_, " episode ", episode_, " chunk ", chunk_);
}

const std::shared_ptr<PredictionTrace>& PredictionTrace::Current() { return CurrentTrace(); }

TraceScope::TraceScope(std::shared_ptr<PredictionTrace> trace)
    : before_(std::exchange(CurrentTrace(), std::move(trace))) {}
TraceScope::~TraceScope() { CurrentTrace() = std::move(before_); }

void TraceLog::Finish(std::shared_ptr<const PredictionTrace> trace) {
  for (const PredictionTrace::Span& span : trace->spans()) {
    metrics_
        ->AddHistogram("robostress_stage_seconds", "Time of one stage of a prediction.",
                       LatencyBounds(), {{"stage", span.stage}})
        ->Observe(std::chrono::duration<double>(span.end - span.begin).count());
  }
  absl::MutexLock lock(&mu_);
  traces_.push_back(std::move(trace));
  if (traces_.size() > kept_) traces_.pop_front();
}

std::string TraceLog::Json() const {
  std::deque<std::shared_ptr<const PredictionTrace>> traces;
  {
    absl::MutexLock lock(&mu_);
    traces = traces_;
  }
  const auto microseconds = [](PredictionTrace::Clock::duration d) {
    return std::chrono::duration<double, std::micro>(d).count();
  };
  std::map<std::string, int> processes;  // Perfetto wants a number per session
  nlohmann::ordered_json events = nlohmann::ordered_json::array();
  for (const auto& trace : traces) {
    const auto [process, is_new] =
        processes.emplace(trace->session(), static_cast<int>(processes.size()) + 1);
    if (is_new) {
      events.push_back({{"ph", "M"},
                        {"name", "process_name"},
                        {"pid", process->second},
                        {"tid", 0},
                        {"args", {{"name", trace->session()}}}});
    }
    for (const PredictionTrace::Span& span : trace->spans()) {
      events.push_back({{"ph", "X"},
                        {"name", span.stage},
                        {"cat", "prediction"},
                        {"pid", process->second},
                        {"tid", 0},
                        {"ts", microseconds(span.begin.time_since_epoch())},
                        {"dur", microseconds(span.end - span.begin)},
                        {"args", {{"step", trace->step()}}}});
    }
  }
  const nlohmann::ordered_json document = {{"displayTimeUnit", "ms"}, {"traceEvents", events}};
  return document.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace robostress
