#pragma once

#include <string>

namespace robostress {

struct RealtimeOptions {
  int priority = 50;        // SCHED_FIFO of the control thread; 0: an ordinary thread
  int cpu = -1;             // the control thread stays on it; -1: anywhere
  bool lock_memory = true;  // no page of the program is swapped out or faulted in late

  template <class V>
  void Visit(V& v) {
    v.Field("priority", priority, "SCHED_FIFO priority of the control thread, 0: none");
    v.Field("cpu", cpu, "processor of the control thread, -1: any");
    v.Field("lock_memory", lock_memory, "keep the program in memory");
  }
};

// Gives the calling thread what the options ask for. What the system refuses is said in the
// returned line, with what grants it; the client runs without, and its record shows the timing it
// had.
std::string MakeRealtime(const RealtimeOptions& options);

}  // namespace robostress
