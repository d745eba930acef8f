#pragma once

#include "absl/status/statusor.h"
#include "common/rollout/rollout.h"

namespace robostress {

// One episode whose answers take options.late.delay_steps >= 1 control steps, in simulated time:
// what is asked at step k is there at step k + delay_steps, however long it took to compute.
//
//   waiting    execute_steps rows, then ask; the arm holds until the answer is there
//   the others ask every execute_steps played rows, or when no row is left; the arm plays on, and
//              enters the answer at the row that is due (ChunkSchedule); where no row is left it
//              holds, and no row falls due
//
// crossfade: the difference of commands to what would have been played fades out, the gripper
// switches at once. rtc: the request carries what is left of the running chunk, and how many rows
// of it will have been played.
//
// A hold is a command of no displacement with the last gripper command, or before there is one an
// open gripper (-1).
//
// Feedback. A chunk is reported when the arm has left it: the next one is entered, or the episode
// is over. Its rows are those that it commanded, from first_step on. Holds after its last row
// belong to the same report, as rows that the client replaced: masked, their policy and sent
// command are the hold, so that a nominal arm is told of them; as many as the chunk has rows left.
// A row that the fade moved by more than moved_bound is masked, and its policy command is what both
// chunks together asked for. The hold before the first chunk is reported by none.
//
// INVALID_ARGUMENT for a policy of joint targets, in which no displacement is no command; errors of
// robot and policy end the episode.
absl::StatusOr<EpisodeRecord> RunLateEpisode(const EpisodeKey& key, const RolloutOptions& options,
                                             Robot& robot, PolicyEndpoint& policy,
                                             uint64_t& sequence);

}  // namespace robostress
