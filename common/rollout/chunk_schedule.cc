#include "common/rollout/chunk_schedule.h"

#include <algorithm>

namespace robostress {

void ChunkSchedule::StartEpisode() {
  Clear();
  last_chunk_ = -1;
}

ChunkSchedule::Entry ChunkSchedule::Find(int index, uint64_t observed_played, int rows,
                                         int& row) const {
  if (index <= last_chunk_ || observed_played > played_) return Entry::kOutdated;
  const int end = std::min(rows, options_.execute_steps + options_.late_steps);
  const uint64_t due = played_ - observed_played;
  if (due >= static_cast<uint64_t>(std::max(0, end))) return Entry::kUsedUp;
  row = static_cast<int>(due);
  return Entry::kPossible;
}

void ChunkSchedule::Enter(int index, int rows, int row) {
  last_chunk_ = index;
  row_ = entry_row_ = row;
  end_ = std::min(rows, options_.execute_steps + options_.late_steps);
  fade_left_ = row > 0 ? options_.fade_steps : 0;
}

void ChunkSchedule::Advance() {
  if (fade_left_ > 0) --fade_left_;
  ++row_;
  ++played_;
}

}  // namespace robostress
