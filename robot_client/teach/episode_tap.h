#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "robot_client/control/tick_record.h"
#include "robot_client/demonstration/demonstration_writer.h"

namespace robostress {

// Which of the control loop's ticks belong to a demonstration: those in which a person guides the
// arm, in teaching mode or by live targets. Take is the control thread's and never waits; the rest
// is the console's.
class EpisodeTap {
 public:
  struct Options {
    bool by_hand = false;  // of an arm in teaching mode, else of live targets
    double period_s = 1.0 / 30;
    double stale_s = 0.05;       // an older sample spoils the episode
    double longest_gap_s = 0.2;  // between two ticks
  };

  EpisodeTap(const Options& options, DemonstrationWriter* writer)
      : options_(options), writer_(writer) {}

  // The ticks from the next one on are the episode's, after DemonstrationWriter::Begin.
  void Open();
  // No tick is any more.
  void Close() { open_.store(false, std::memory_order_release); }
  void Take(const TickRecord& record);

  // Why the ticks have ended: kGoing; kLetGo where the person ended it, with teaching mode or a
  // hold; else what makes the episode worthless.
  enum class End : uint8_t { kGoing, kLetGo, kHeld, kStale, kGap, kLost };
  End end() const { return end_.load(std::memory_order_acquire); }
  // For people, empty unless the episode is worthless.
  std::string Spoiled() const;
  // The command is still on its way to the leader (kTickJoining), open or not.
  bool joining() const { return joining_.load(std::memory_order_acquire); }
  int64_t ticks() const { return ticks_.load(std::memory_order_acquire); }
  int64_t missing() const { return missing_.load(std::memory_order_acquire); }  // left out between

 private:
  void Stop(End end);

  const Options options_;
  DemonstrationWriter* const writer_;
  std::atomic<bool> open_{false}, joining_{true};
  std::atomic<End> end_{End::kGoing};
  std::atomic<StateCause> cause_{StateCause::kNone};
  std::atomic<int64_t> ticks_{0}, missing_{0};
  std::atomic<int64_t> last_due_ns_{0};
};

}  // namespace robostress
