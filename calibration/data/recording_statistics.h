#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/recordings/row_stream.h"

namespace robostress::calibration {

inline constexpr double kGapRows = 5;  // a step of more is a gap, where calibrate splits a log

// The steps of a clock [ns], counted in bins of 2.2 %, so that a long recording takes no more
// memory than a short one.
class StepCounts {
 public:
  // The next tick. Begin anew with `first`: no step leads to it.
  void Add(int64_t tick_ns, bool first);
  int64_t ticks() const { return ticks_; }
  int64_t backwards() const { return backwards_; }
  int64_t duplicates() const { return duplicates_; }
  int64_t steps() const { return steps_; }  // forward
  // The step that a share of all is not above, the mean of its bin [s]; 0: none.
  double Quantile(double share) const;
  // The mean of the steps that are within a half of the median [s], where they are most; else of
  // those that are no gaps. 0: none. Jitter does not change it.
  double Typical() const;
  // Steps longer than `limit_s`.
  int64_t LongerThan(double limit_s) const;
  double longest_s() const { return static_cast<double>(longest_) * 1e-9; }
  // When the longest began, after the first tick [s].
  double longest_at_s() const { return static_cast<double>(longest_at_) * 1e-9; }
  double total_s() const { return total_s_; }  // of all forward steps

 private:
  struct Bin {
    int64_t count = 0;
    double sum = 0;
  };
  double MeanBetween(double least_s, double most_s, int64_t* count) const;

  std::vector<Bin> bins_;
  int64_t ticks_ = 0, backwards_ = 0, duplicates_ = 0, steps_ = 0;
  int64_t first_ = 0, last_ = 0, longest_ = 0, longest_at_ = 0;
  double total_s_ = 0;
};

// Every so many-th of many values, at most 1024, evenly over all of them.
class ValueSample {
 public:
  void Add(double value);
  bool empty() const { return values_.empty(); }
  double Quantile(double share) const;  // 0: none

 private:
  std::vector<double> values_;
  int64_t every_ = 1, left_ = 0;
};

// The rows of a channel that hold the same positions: where an arm and a gripper speak on one
// topic, each has its own.
struct PositionSet {
  int64_t rows = 0, stamped = 0, episode = -1;  // episode: the last that had such a row
  StepCounts log, stamp;
};

struct ChannelStatistics {
  RecordedChannel description;
  int64_t rows = 0, stamped = 0;
  StepCounts log, stamp;
  std::map<std::vector<size_t>, PositionSet> position_sets;  // by signals
  // Of commands: by channel of positions, how far this one's stamps are ahead of that one's, each
  // against the recorder's times [s].
  std::map<size_t, ValueSample> ahead;
};

struct SignalStatistics {
  RecordedSignal description;
  int64_t count = 0, not_finite = 0, reversals = 0;
  double low = 0, high = 0, fastest = 0;  // fastest: [1/s] largest step over its time
  bool whole = true;                      // whole numbers only
  // Of a velocity: sums over pairs of rows of v d and d d, where d is the position's derivative.
  double along = 0, square = 0;
  // Of a command: sum of squared differences from the positions that stood then, by signal.
  std::map<size_t, std::pair<double, int64_t>> off;

  double span() const { return count > not_finite ? high - low : 0; }
};

// The first pass over a recording: what its channels and signals are like, in constant memory.
class RecordingStatistics : public RecordingVisitor {
 public:
  void OnChannel(size_t channel, const RecordedChannel& description) override;
  void OnSignal(size_t signal, const RecordedSignal& description) override;
  void OnEpisode(const std::string& name) override;
  absl::Status OnRow(const JointRow& row) override;
  void OnNote(const std::string& note) override;

  const std::vector<ChannelStatistics>& channels() const { return channels_; }
  const std::vector<SignalStatistics>& signals() const { return signals_; }
  const std::vector<std::string>& notes() const { return notes_; }
  int64_t episodes() const { return episodes_; }
  int64_t notes_left_out() const { return notes_left_out_; }
  // A signal of a channel; -1: there is none.
  int Find(size_t channel, const std::string& joint, JointQuantity quantity) const;

 private:
  struct Last {
    int64_t at_ns = 0;
    double value = 0, turn = 0;  // turn: the farthest since the last reversal
    int direction = 0;
    int64_t episode = -1;
  };
  void TakeValue(const SignalValue& value, int64_t at_ns);
  void TakeReversal(SignalStatistics* signal, Last* last, double value);
  void CompareVelocity(const JointRow& row, const std::map<std::string, double>& derivative);
  void CompareCommand(size_t signal, double value);
  void TakePositionSet(const JointRow& row, std::vector<size_t> set);
  void CompareClocks(const JointRow& row);

  std::vector<ChannelStatistics> channels_;
  std::vector<SignalStatistics> signals_;
  std::vector<Last> last_;
  std::vector<int64_t> last_episode_;       // of channels
  std::map<size_t, int64_t> ahead_of_log_;  // stamp minus log [ns] of positions
  size_t sets_ = 0, compared_ = 0;
  std::map<std::string, std::vector<size_t>> positions_;  // signals by joint
  std::vector<size_t> all_positions_;
  std::vector<std::string> notes_;
  int64_t episodes_ = 0, notes_left_out_ = 0;
};

}  // namespace robostress::calibration
