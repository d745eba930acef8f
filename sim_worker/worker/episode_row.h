#pragma once

#include <string>

#include "common/rollout/policy_endpoint.h"
#include "common/rollout/rollout.h"
#include "common/unit_config.h"
#include "nlohmann/json.hpp"
#include "sim_worker/worker/unit_plan.h"

namespace robostress {

// What identifies a row of episodes.jsonl: everything that is known before the episode runs.
nlohmann::json EpisodeIdentity(const UnitConfig& resolved, const PlannedEpisode& planned);

// One line of episodes.jsonl: identity, outcome and residual sums (adapter/episode_metrics.h),
// sorted keys, numbers as the shortest text that reads back equal. Nothing in it depends on the
// clock. Intent is null when the unadapted policy's commands are not known.
std::string EpisodeLine(const UnitConfig& resolved, const PlannedEpisode& planned,
                        const EpisodeRecord& record, const SessionStats& stats);

// One line of timing.jsonl [s].
std::string TimingLine(const PlannedEpisode& planned, const EpisodeRecord& record, double wall_s);

// What a person watches: "episode 3/20  task 1.2  success  87 steps  2 updates  residual 0.31  1.9
// s".
std::string ProgressLine(size_t index, size_t total, const PlannedEpisode& planned,
                         const EpisodeRecord& record, const SessionStats& stats, double wall_s);

}  // namespace robostress
