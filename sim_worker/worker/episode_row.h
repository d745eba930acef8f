#pragma once

#include <optional>
#include <string>
#include <vector>

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
//
// `in_clean` is the episode's commands as sent, played again without joint errors from the same
// initial state. The residual that they leave there is the controller's lag:
//   lag_residual = sqrt(lag_eta_sq / a_sq),   lag_eta_sq = sum ||dx_clean - a||^2
// over the same steps and the same a as `residual`. Without `in_clean` the row has neither field.
std::string EpisodeLine(const UnitConfig& resolved, const PlannedEpisode& planned,
                        const EpisodeRecord& record, const SessionStats& stats,
                        const std::optional<std::vector<ExecutedChunk>>& in_clean = std::nullopt);

// One line of timing.jsonl [s].
std::string TimingLine(const PlannedEpisode& planned, const EpisodeRecord& record, double wall_s);

// What a person watches: "episode 3/20  task 1.2  success  87 steps  2 updates  residual 0.31  1.9
// s".
std::string ProgressLine(size_t index, size_t total, const PlannedEpisode& planned,
                         const EpisodeRecord& record, const SessionStats& stats, double wall_s);

}  // namespace robostress
