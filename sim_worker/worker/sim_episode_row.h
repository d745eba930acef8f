#pragma once

#include <optional>
#include <vector>

#include "common/records/episode_row.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/rollout.h"
#include "common/unit_config.h"

namespace robostress {

// Outcome and residual sums of an episode (adapter/episode_metrics.h) with the method's own
// options. Which episode it was, the runner knows. Intent is absent when the unadapted policy's
// commands are not known.
//
// `in_clean` is the episode's commands as sent, played again without joint errors from the same
// initial state. The residual that they leave there is the controller's lag:
//   lag_residual = sqrt(lag_eta_sq / a_sq),   lag_eta_sq = sum ||dx_clean - a||^2
// over the same steps and the same a as `residual`. Without `in_clean` the row has neither field.
EpisodeRow MakeEpisodeRow(const UnitConfig& resolved, const EpisodeRecord& record,
                          const SessionStats& stats,
                          const std::optional<std::vector<ExecutedChunk>>& in_clean = std::nullopt);

TimingRow MakeTimingRow(const EpisodeRecord& record, double wall_s);

}  // namespace robostress
