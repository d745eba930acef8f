#pragma once

#include <array>
#include <cstdint>

#include "common/rollout/chunk_schedule.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// A predicted chunk as the control thread takes it: fixed size.
struct ArmChunk {
  static constexpr int kMaxRows = 64;
  uint64_t request = 0;        // PredictionRequest::id that it answers
  bool failed = false;         // there is no prediction; nothing below holds
  bool invalid = false;        // ... because what came is no chunk of this arm
  uint64_t prediction_id = 0;  // the server's
  int32_t episode = 0;
  int32_t chunk = 0;        // index within the episode
  uint64_t played = 0;      // rows played before its observation
  int64_t observed_ns = 0;  // of its observation, the client's clock
  int32_t rows = 0;
  std::array<ArmVector, kMaxRows> requested;  // to be sent: joints [rad], gripper [m]
  std::array<ArmVector, kMaxRows> policy;     // before the server's own gain or direct correction
};

struct PlayerOptions {
  int execute_steps = 10;  // n_exec: rows per prediction
  int late_steps = 10;     // rows more that are played while the next chunk is late
  int fade_steps = 4;      // ticks over which a late chunk's offset fades out; 0: an exact switch
  double max_jump = 0.5;   // [rad], most between a chunk's first row and what was played before it
  double max_age_s = 1.0;  // [s], of a chunk's observation when it arrives
  // Rows that are played until an answer is there: the policy is asked to go on from them
  // (real-time chunking). 0: it is not.
  int rtc_rows = 0;

  template <class V>
  void Visit(V& v) {
    v.Field("execute_steps", execute_steps, "n_exec, rows executed per prediction");
    v.Field("late_steps", late_steps, "rows more that are played while the next chunk is late");
    v.Field("fade_steps", fade_steps, "ticks over which a late chunk's offset fades out");
    v.Field("max_jump", max_jump, "most a chunk may differ from what was played before it [rad]");
    v.Field("max_age_s", max_age_s, "most age of a chunk's observation when it arrives [s]");
    v.Late("rtc_rows", rtc_rows, 0,
           "rows that are played until an answer is there, from which the policy is asked to go "
           "on; 0: it is not");
  }
};

enum class ChunkVerdict : uint8_t {
  kTaken,
  kWrongShape,
  kNotFinite,
  kOutdated,  // of another episode, or not newer than the one that plays
  kTooOld,    // its observation is older than max_age_s
  kUsedUp,    // it came after its last playable row was due
  kJump,      // its first row is too far from where the arm is sent
};
const char* VerdictName(ChunkVerdict verdict);

// Decides which row of which chunk is the target of a tick, by ChunkSchedule. Entered late, the
// difference between what would have been played and a chunk's row is taken over and fades out
// linearly; joints only, the gripper switches at once. Where the queue is empty the caller
// decelerates.
//
// Allocates nothing. One thread.
class ChunkPlayer {
 public:
  ChunkPlayer(const PlayerOptions& options, int joints)
      : options_(options),
        joints_(joints),
        schedule_({options.execute_steps, options.late_steps, options.fade_steps}) {}

  // Forgets every chunk; `played` goes on, so that answers to earlier requests stay recognisable.
  void StartEpisode(int episode);
  void Clear() { schedule_.Clear(); }  // forgets the chunk that plays

  // `held`: where the arm is sent now.
  ChunkVerdict Offer(const ArmChunk& chunk, int64_t now_ns, const ArmVector& held);

  struct Step {
    ArmVector policy, requested, blended;
    uint64_t prediction_id = 0;
    int chunk = -1;
    int row = -1;
    bool entered = false, fading = false, overrun = false;
  };
  // The row of this tick; false: the queue is empty.
  bool Next(Step& step);

  uint64_t played() const { return schedule_.played(); }  // rows so far
  bool empty() const { return schedule_.empty(); }
  // The chunk that plays (its index; -1: none) and its next row.
  int chunk() const { return empty() ? -1 : chunk_.chunk; }
  int row() const { return schedule_.row(); }

 private:
  ArmVector Continuation(const ArmVector& held) const;  // what Next would have played

  const PlayerOptions options_;
  const int joints_;
  ChunkSchedule schedule_;
  ArmChunk chunk_;
  int episode_ = -1;
  ArmVector offset_{};  // at the start of the fade
};

}  // namespace robostress
