#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/records/episode_row.h"
#include "common/rollout/session_spec.h"
#include "common/unit_config.h"

namespace robostress {

// One episode of a unit, in the order of execution.
struct PlannedEpisode {
  int task = 0;
  int episode = 0;        // within the task
  int initial_state = 0;  // first_initial_state + episode, and what the tasks before took where
                          // the suite's states go on (common/suites.h)
  bool film = false;
};

// Reads a unit and applies "a.b=value" overrides. A method section that names a preset
// (method.method) starts from that preset and changes only the keys that it gives. `source` names
// the text in errors.
absl::StatusOr<UnitConfig> ReadUnit(const std::string& source, const std::string& yaml,
                                    const std::vector<std::string>& overrides = {});

// Checks every name and range against what exists and writes out what was left to default (the
// tasks), so that equal units have equal texts. The error names key, value and what is allowed.
absl::StatusOr<UnitConfig> ResolveUnit(const UnitConfig& unit);

// Late answers that the unit's robot and policy can have, within 0 to 10000 ms; INVALID_ARGUMENT.
absl::Status CheckLatency(const UnitConfig& unit);

// The episodes of a resolved unit: task by task, because a change of task is a boundary.
std::vector<PlannedEpisode> PlanEpisodes(const UnitConfig& resolved);
// "40-59": the episodes of that range of PlanEpisodes, both ends included; empty: all. Only where
// MayBeDivided.
absl::StatusOr<std::vector<PlannedEpisode>> PlanRange(const UnitConfig& resolved,
                                                      const std::string& range);

// Robot and method carry nothing from one episode to the next: each gives the row that it gives in
// the whole unit, whoever runs the others.
bool MayBeDivided(const UnitConfig& unit);
// What identifies the episode's row.
EpisodeIdentity IdentityOf(const UnitConfig& resolved, const PlannedEpisode& planned);
// Policies that need no server: expert and replay.
bool RunsInWorker(const std::string& policy);

}  // namespace robostress
