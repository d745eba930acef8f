#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>

#include "absl/time/time.h"
#include "common/std_mutex.h"
#include "server/inference/request_queue.h"
#include "server/operations/metrics.h"

namespace robostress {

struct UpdatePacerOptions {
  // Cores that predictions and updates share. Updates yield while more of both are under way than
  // there are cores; 1: whenever a prediction is under way. 0: what the machine has.
  int cores = 0;
  // Of one core's time, what all updates together may compute while they would have to yield: in
  // (0, 1]; 1: they never yield. It bounds how long a busy server can hold an update up.
  double share = 0.1;
};

// Lets updates give way to predictions in the middle of their work. An update thread asks between
// any two of its operators (YieldPoint) whether predictions need the cores; if so it pauses until
// they are answered, or until the pause is as long as its share demands. Pausing changes no bits.
// Updates of lockstep sessions, whose own predictions wait for them, yield to real arms only.
class UpdatePacer {
 public:
  enum class Kind { kAsync, kLockstep };  // of the session that learns

  // `metrics` may be null; it must outlive this.
  explicit UpdatePacer(const UpdatePacerOptions& options, Metrics* metrics = nullptr);
  double share() const { return share_; }
  int cores() const { return cores_; }

  // Any thread. From arrival to answer, waiting included.
  void PredictionArrived(Priority priority);
  void PredictionAnswered(Priority priority);

  // An update that runs on this thread from construction to destruction. One per thread at a time.
  class Update {
   public:
    Update(UpdatePacer* pacer, Kind kind);
    ~Update();
    Update(const Update&) = delete;
    Update& operator=(const Update&) = delete;

   private:
    friend class UpdatePacer;
    UpdatePacer* const pacer_;
    const Kind kind_;
    MonotonicTime resumed_;               // since when it computes
    std::chrono::nanoseconds credit_{0};  // what it may compute before it pauses again
  };
  // Pauses if the update on this thread has to; nothing outside of an update. A thread must not
  // hold a lock here that a prediction could wait for.
  static void YieldPoint();

  absl::Duration paused() const { return absl::Nanoseconds(paused_ns_.load()); }  // all updates

 private:
  bool MustYield(Kind kind) const;
  bool MayResume(Kind kind) const;  // of one that pauses
  void Notify();
  void Yield(Update& update);

  const int cores_;
  const double share_;
  std::atomic<int> predictions_{0}, robots_{0};
  std::atomic<int> begun_{0};    // updates between construction and destruction
  std::atomic<int> updates_{0};  // of these, that compute now
  std::atomic<int64_t> paused_ns_{0};
  std::shared_ptr<Counter> paused_seconds_;  // null without metrics
  // Guards no member, the counts are atomic: a count does not change between a look at it and a
  // wait. Not analysed: there is nothing to name.
  StdMutex mu_;
  std::condition_variable answered_;
  std::atomic<int> pausing_{0};
};

}  // namespace robostress
