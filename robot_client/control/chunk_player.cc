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
  schedule_.StartEpisode();
  episode_ = episode;
}

ArmVector ChunkPlayer::Continuation(const ArmVector& held) const {
  if (schedule_.empty()) return held;
  ArmVector target = chunk_.requested[schedule_.row()];
  if (schedule_.fading()) {
    const double share = schedule_.offset_share();
    for (int j = 0; j < joints_; ++j) target[j] += share * offset_[j];
  }
  return target;
}

ChunkVerdict ChunkPlayer::Offer(const ArmChunk& chunk, int64_t now_ns, const ArmVector& held) {
  if (chunk.rows < 1 || chunk.rows > ArmChunk::kMaxRows) return ChunkVerdict::kWrongShape;
  for (int i = 0; i < chunk.rows; ++i) {
    if (!AllFinite(chunk.requested[i]) || !AllFinite(chunk.policy[i]))
      return ChunkVerdict::kNotFinite;
  }
  int row = 0;
  const ChunkSchedule::Entry entry = schedule_.Find(chunk.chunk, chunk.played, chunk.rows, row);
  if (chunk.episode != episode_ || entry == ChunkSchedule::Entry::kOutdated)
    return ChunkVerdict::kOutdated;
  if (static_cast<double>(now_ns - chunk.observed_ns) > options_.max_age_s * kNsPerSecond)
    return ChunkVerdict::kTooOld;
  if (entry == ChunkSchedule::Entry::kUsedUp) return ChunkVerdict::kUsedUp;

  ArmVector offset = Continuation(held);
  for (int j = 0; j < joints_; ++j) {
    offset[j] -= chunk.requested[row][j];
    if (std::abs(offset[j]) > options_.max_jump) return ChunkVerdict::kJump;
  }
  offset_ = offset;
  chunk_ = chunk;
  schedule_.Enter(chunk.chunk, chunk.rows, row);
  return ChunkVerdict::kTaken;
}

bool ChunkPlayer::Next(Step& step) {
  if (schedule_.empty()) return false;
  const int row = schedule_.row();
  step.blended = Continuation({});
  step.policy = chunk_.policy[row];
  step.requested = chunk_.requested[row];
  step.prediction_id = chunk_.prediction_id;
  step.chunk = chunk_.chunk;
  step.row = row;
  step.entered = schedule_.entered();
  step.fading = schedule_.fading();
  step.overrun = schedule_.overrun();
  schedule_.Advance();
  return true;
}

}  // namespace robostress
