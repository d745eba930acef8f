#include "robot_client/control/chunk_player.h"

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kNsPerSecond = 1e9;

bool AllFinite(const ArmVector& v) {
  return std::all_of(v.begin(), v.end(), [](double x) { return std::isfinite(x); });
}

}  // namespace

const char* VerdictName(ChunkVerdict verdict) {
  switch (verdict) {
    case ChunkVerdict::kTaken:
      return "taken";
    case ChunkVerdict::kWrongShape:
      return "wrong_shape";
    case ChunkVerdict::kNotFinite:
      return "not_finite";
    case ChunkVerdict::kOutdated:
      return "outdated";
    case ChunkVerdict::kTooOld:
      return "too_old";
    case ChunkVerdict::kUsedUp:
      return "used_up";
    case ChunkVerdict::kJump:
      return "jump";
  }
  return "";
}

void ChunkPlayer::StartEpisode(int episode) {
  Clear();
  episode_ = episode;
  last_chunk_ = -1;
}

void ChunkPlayer::Clear() { row_ = end_ = fade_left_ = 0; }

ArmVector ChunkPlayer::Continuation(const ArmVector& held) const {
  if (row_ >= end_) return held;
  ArmVector target = chunk_.requested[row_];
  if (fade_left_ > 0) {
    const double share = static_cast<double>(fade_left_) / (options_.fade_steps + 1);
    for (int j = 0; j < kArmJoints; ++j) target[j] += share * offset_[j];
  }
  return target;
}

ChunkVerdict ChunkPlayer::Offer(const ArmChunk& chunk, int64_t now_ns, const ArmVector& held) {
  if (chunk.rows < 1 || chunk.rows > ArmChunk::kMaxRows) return ChunkVerdict::kWrongShape;
  for (int i = 0; i < chunk.rows; ++i) {
    if (!AllFinite(chunk.requested[i]) || !AllFinite(chunk.policy[i]))
      return ChunkVerdict::kNotFinite;
  }
  if (chunk.episode != episode_ || chunk.chunk <= last_chunk_ || chunk.played > played_)
    return ChunkVerdict::kOutdated;
  if (static_cast<double>(now_ns - chunk.observed_ns) > options_.max_age_s * kNsPerSecond)
    return ChunkVerdict::kTooOld;
  const int end = std::min(chunk.rows, options_.execute_steps + options_.late_steps);
  const uint64_t due = played_ - chunk.played;
  if (due >= static_cast<uint64_t>(end)) return ChunkVerdict::kUsedUp;
  const int row = static_cast<int>(due);

  ArmVector offset = Continuation(held);
  for (int j = 0; j < kArmJoints; ++j) {
    offset[j] -= chunk.requested[row][j];
    if (std::abs(offset[j]) > options_.max_jump) return ChunkVerdict::kJump;
  }
  offset_ = offset;
  chunk_ = chunk;
  last_chunk_ = chunk.chunk;
  row_ = entry_row_ = row;
  end_ = end;
  fade_left_ = row > 0 ? options_.fade_steps : 0;
  return ChunkVerdict::kTaken;
}

bool ChunkPlayer::Next(Step& step) {
  if (row_ >= end_) return false;
  step.blended = Continuation({});
  step.policy = chunk_.policy[row_];
  step.requested = chunk_.requested[row_];
  step.prediction_id = chunk_.prediction_id;
  step.chunk = chunk_.chunk;
  step.row = row_;
  step.entered = row_ == entry_row_;
  step.fading = fade_left_ > 0;
  step.overrun = row_ >= entry_row_ + options_.execute_steps;
  if (fade_left_ > 0) --fade_left_;
  ++row_;
  ++played_;
  return true;
}

}  // namespace robostress
