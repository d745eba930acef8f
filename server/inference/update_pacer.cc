#include "server/inference/update_pacer.h"

#include <algorithm>
#include <thread>

namespace robostress {
namespace {

using std::chrono::nanoseconds;

// A pause costs a prediction's core two switches of threads: few long ones rather than many short.
constexpr auto kShortestPause = std::chrono::milliseconds(2);

UpdatePacer::Update*& CurrentUpdate() {
  thread_local UpdatePacer::Update* current = nullptr;
  return current;
}

}  // namespace

UpdatePacer::UpdatePacer(const UpdatePacerOptions& options, Metrics* metrics)
    : cores_(options.cores > 0
                 ? options.cores
                 : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()))),
      share_(std::clamp(options.share, 1e-3, 1.0)) {
  if (metrics == nullptr) return;
  paused_seconds_ = metrics->AddCounter("robostress_updates_paused_seconds_total",
                                        "Time that updates gave way to predictions.");
}

void UpdatePacer::PredictionArrived(Priority priority) {
  ++predictions_;
  if (priority == Priority::kRobot) ++robots_;
}

void UpdatePacer::PredictionAnswered(Priority priority) {
  --predictions_;
  if (priority == Priority::kRobot) --robots_;
  Notify();
}

void UpdatePacer::Notify() {
  if (pausing_ == 0) return;
  { const StdLock lock(mu_); }  // who is about to wait has looked at the counts before
  answered_.notify_all();
}

bool UpdatePacer::MustYield(Kind kind) const {
  const int ahead = kind == Kind::kAsync ? predictions_ : robots_;
  return ahead > 0 && (cores_ == 1 || predictions_ + updates_ > cores_);
}

UpdatePacer::Update::Update(UpdatePacer* pacer, Kind kind)
    : pacer_(pacer), kind_(kind), resumed_(std::chrono::steady_clock::now()) {
  CurrentUpdate() = this;
  if (pacer_ == nullptr) return;
  ++pacer_->begun_;
  ++pacer_->updates_;
}

UpdatePacer::Update::~Update() {
  CurrentUpdate() = nullptr;
  if (pacer_ == nullptr) return;
  --pacer_->updates_;
  --pacer_->begun_;
  pacer_->Notify();
}

void UpdatePacer::YieldPoint() {
  Update* const update = CurrentUpdate();
  if (update != nullptr && update->pacer_ != nullptr) update->pacer_->Yield(*update);
}

bool UpdatePacer::MayResume(Kind kind) const {
  const int ahead = kind == Kind::kAsync ? predictions_ : robots_;
  return ahead == 0 || (cores_ > 1 && predictions_ + updates_ < cores_);
}

void UpdatePacer::Yield(Update& update) {
  const MonotonicTime begin = std::chrono::steady_clock::now();
  const auto computed = begin - update.resumed_;
  update.resumed_ = begin;
  if (share_ == 1 || !MustYield(update.kind_)) {
    update.credit_ = {};
    return;
  }
  update.credit_ -= computed;
  if (update.credit_.count() > 0) return;
  const double share = share_ / begun_;
  const auto owed = std::chrono::duration_cast<nanoseconds>(-update.credit_ * (1 / share - 1));
  bool resume = false;
  ++pausing_;
  {
    StdLock lock(mu_);
    --updates_;
    answered_.notify_all();  // another update may have the core
    resume = answered_.wait_for(lock.waiting(), std::max<nanoseconds>(owed, kShortestPause),
                                [&] { return MayResume(update.kind_); });
    ++updates_;  // still locked: of two updates that wait for one core only one gets it
  }
  --pausing_;
  update.resumed_ = std::chrono::steady_clock::now();
  const auto paused = update.resumed_ - begin;
  update.credit_ += std::chrono::duration_cast<nanoseconds>(paused * (share / (1 - share)));
  if (resume) update.credit_ = {};
  paused_ns_ += std::chrono::duration_cast<nanoseconds>(paused).count();
  if (paused_seconds_ != nullptr)
    paused_seconds_->Increment(std::chrono::duration<double>(paused).count());
}

}  // namespace robostress
