#pragma once

#include <cstdint>

namespace robostress {

// Which row of which chunk falls due, by counts alone: the rule of robot_client's control loop and
// of the simulator's late answers.
//
// Row i of a chunk is due i rows after its observation, where only steps count that played a row:
// while the arm holds, no row falls due. A chunk is entered at the row that is due when it arrives.
// Entered late (row > 0) what was there before it fades out linearly over fade_steps. Rows from
// execute_steps + late_steps on are never played: the queue is empty.
//
// Allocates nothing. One thread.
class ChunkSchedule {
 public:
  struct Options {
    int execute_steps = 10;  // n_exec: rows per prediction
    int late_steps = 10;     // rows more that are played while the next chunk is late
    int fade_steps = 4;      // 0: an exact switch
  };
  enum class Entry : uint8_t {
    kPossible,
    kOutdated,  // not newer than the one that plays, or observed after rows that were never played
    kUsedUp,    // it came after its last playable row was due
  };

  explicit ChunkSchedule(const Options& options) : options_(options) {}

  // Forgets every chunk; `played` goes on, so that answers to earlier requests stay recognisable.
  void StartEpisode();
  void Clear() { row_ = end_ = fade_left_ = 0; }  // forgets the chunk that plays

  // Whether chunk `index` of `rows` rows, observed when `observed_played` rows had been played, can
  // be entered now; then `row` is where.
  Entry Find(int index, uint64_t observed_played, int rows, int& row) const;
  // Enters it there.
  void Enter(int index, int rows, int row);

  bool empty() const { return row_ >= end_; }
  int left() const { return end_ - row_; }     // rows that can still be played
  uint64_t played() const { return played_; }  // rows so far

  // Of the step that Advance will end; the chunk is not empty.
  int row() const { return row_; }
  bool entered() const { return row_ == entry_row_; }
  bool fading() const { return fade_left_ > 0; }
  bool overrun() const { return row_ >= entry_row_ + options_.execute_steps; }
  // Of the offset at the entry that is still added, 0 to below 1.
  double offset_share() const {
    return static_cast<double>(fade_left_) / (options_.fade_steps + 1);
  }
  void Advance();

 private:
  const Options options_;
  int row_ = 0, end_ = 0;  // next row, one beyond the last
  int entry_row_ = 0;
  int fade_left_ = 0;    // steps
  int last_chunk_ = -1;  // index of the newest chunk taken
  uint64_t played_ = 0;
};

}  // namespace robostress
