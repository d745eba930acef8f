#include "robot_client/teach/episode_tap.h"

#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress {

void EpisodeTap::Open() {
  end_ = End::kGoing;
  cause_ = StateCause::kNone;
  ticks_ = missing_ = last_due_ns_ = 0;
  open_.store(true, std::memory_order_release);
}

void EpisodeTap::Stop(End end) {
  end_.store(end, std::memory_order_release);
  Close();
}

void EpisodeTap::Take(const TickRecord& record) {
  joining_.store((record.flags & kTickJoining) != 0, std::memory_order_release);
  if (!open_.load(std::memory_order_acquire)) return;
  const double age = static_cast<double>(record.start_ns - record.stamp_ns) * 1e-9;
  if (options_.by_hand) {
    if (record.sequence == 0 || !(age <= options_.stale_s)) return Stop(End::kStale);
    if ((record.flags & kTickTaught) == 0) return Stop(End::kLetGo);
  } else if (record.state != ClientState::kMove || (record.flags & kTickLive) == 0) {
    cause_.store(record.cause, std::memory_order_release);
    return Stop(record.state == ClientState::kEnabled ? End::kLetGo : End::kHeld);
  }
  const int64_t last = last_due_ns_.exchange(record.due_ns);
  if (last != 0) {
    const double gap = static_cast<double>(record.due_ns - last) * 1e-9;
    if (gap > options_.longest_gap_s) return Stop(End::kGap);
    missing_ += std::lround(gap / options_.period_s) - 1;
  }
  DemonstrationTick tick;
  tick.stamp_ns = record.start_ns;
  tick.state = record.position;
  tick.action = options_.by_hand ? record.position : record.requested;
  if (!writer_->Add(tick)) return Stop(End::kLost);
  ++ticks_;
}

std::string EpisodeTap::Spoiled() const {
  switch (end()) {
    case End::kGoing:
    case End::kLetGo:
      return "";
    case End::kHeld:
      return absl::StrCat("the arm was held (", CauseName(cause_.load()), ")");
    case End::kStale:
      return "the arm was not heard any more";
    case End::kGap:
      return absl::StrCat("the control thread stood still for more than ", options_.longest_gap_s,
                          " s; close other programs");
    case End::kLost:
      return "pictures are not encoded as fast as they come; use smaller ones or fewer cameras";
  }
  return "";
}

}  // namespace robostress
