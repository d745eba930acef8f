#pragma once

#include <atomic>
#include <deque>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "robot_client/control/spsc_ring.h"
#include "robot_client/control/tick_record.h"

namespace robostress {

// "J2 presses with 9.1 Nm more than its motion needs", for a person; what was measured is in the
// record.
std::string CauseText(const TickRecord& record);
// What a person types next in a state that he did not ask for; empty: nothing is wrong.
const char* NextStep(ClientState state, StateCause cause);

// Tells a person what happens to the arm, in a thread of its own that waits for nothing but the
// terminal: neither a disk, nor a camera, nor a server, nor a command under way delays a line. An
// output that is closed or stuck costs lines, never the run.
class StateReporter {
 public:
  explicit StateReporter(int descriptor) : descriptor_(descriptor) {}

  SpscRing<TickRecord>& ring() { return ring_; }
  // Any thread; does not wait. Of more than kMostLines that are not out yet the newest is lost.
  void Say(std::string line) ABSL_LOCKS_EXCLUDED(mu_);
  void Run(const std::atomic<bool>& stop);
  // What has come so far; Run's thread, or after it.
  void Drain();

 private:
  static constexpr size_t kMostLines = 1000;
  void Note(const TickRecord& record);
  void Write(const std::string& text);

  const int descriptor_;
  SpscRing<TickRecord> ring_{1 << 8};
  int64_t origin_ns_ = 0;
  ClientState state_ = ClientState::kIdle;
  StateCause cause_ = StateCause::kNone;
  bool goes_on_ = false;  // kFaultNotStopped
  absl::Mutex mu_;
  std::deque<std::string> lines_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
