#include "server/update_pacer.h"

#include <algorithm>
#include <thread>

namespace robostress {
namespace {

using std::chrono::nanoseconds;

UpdatePacer::Update*& CurrentUpdate() {
  thread_local UpdatePacer::Update* current = nullptr;
  return current;
}

}  // namespace

UpdatePacer::UpdatePacer(const UpdatePacerOptions& options)
    : cores_(options.cores > 0
                 ? options.cores
                 : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()))),
      share_(std::clamp(options.share, 1e-3, 1.0)) {}

void UpdatePacer::PredictionArrived(Priority priority) {
  ++predictions_;
  if (priority == Priority::kRobot) ++robots_;
}

void UpdatePacer::PredictionAnswered(Priority priority) {
  --predictions_;
  if (priority == Priority::kRobot) --robots_;
  if (pausing_ == 0) return;
  { const std::lock_guard lock(mu_); }  // who is about to wait has looked at the counts before
  answered_.notify_all();
}

bool UpdatePacer::MustYield(Kind kind) const {
  const int ahead = kind == Kind::kAsync ? predictions_ : robots_;
  return ahead > 0 && (cores_ == 1 || predictions_ + updates_ > cores_);
}

UpdatePacer::Update::Update(UpdatePacer* pacer, Kind kind)
    : pacer_(pacer), kind_(kind), resumed_(std::chrono::steady_clock::now()) {
  CurrentUpdate() = this;
  if (pacer_ != nullptr) ++pacer_->updates_;
}

UpdatePacer::Update::~Update() {
  CurrentUpdate() = nullptr;
  if (pacer_ != nullptr) --pacer_->updates_;
}

void UpdatePacer::YieldPoint() {
  Update* const update = CurrentUpdate();
  if (update != nullptr && update->pacer_ != nullptr) update->pacer_->Yield(*update);
}

void UpdatePacer::Yield(Update& update) {
  const MonotonicTime begin = std::chrono::steady_clock::now();
  const auto computed = begin - update.resumed_;
  update.resumed_ = begin;
  if (share_ == 1 || !MustYield(update.kind_)) return;
  const auto owed = std::chrono::duration_cast<nanoseconds>(computed * (1 / share_ - 1));
  ++pausing_;
  --updates_;
  {
    std::unique_lock lock(mu_);
    answered_.wait_for(lock, owed, [&] {
      const int ahead = update.kind_ == Kind::kAsync ? predictions_ : robots_;
      return ahead == 0 || (cores_ > 1 && predictions_ + updates_ + 1 <= cores_);
    });
  }
  ++updates_;
  --pausing_;
  update.resumed_ = std::chrono::steady_clock::now();
  paused_ns_ += std::chrono::duration_cast<nanoseconds>(update.resumed_ - begin).count();
}

}  // namespace robostress
