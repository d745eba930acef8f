#pragma once

#include <cstdint>
#include <utility>

#include "absl/status/status.h"
#include "calibration/data/recording_plan.h"

namespace robostress::calibration {

// Of a sum of squares and a count.
double RootMean(const std::pair<double, int64_t>& sum);

// The command with the joint's name: of the position's own rows, else of its namespace, else the
// nearest, of those that are most. Or one without a name that stays near the joint, and clearly
// nearer than to the next. A command with the name that is far from the joint is none, because it
// may be a step of the position: unless it is named (options.commands) or the reference of the same
// controller's state.
void FindCommand(const RecordingStatistics& statistics, const RecordingOptions& options,
                 PlannedJoint* joint, RecordingPlan* plan);
// INVALID_ARGUMENT where options.commands is no channel of commands.
absl::Status CheckCommands(const RecordingStatistics& statistics, const RecordingOptions& options);
// Whether the commands of a channel are of another clock than the positions, and a word of it.
void CompareClocks(const RecordingStatistics& statistics, const RecordingOptions& options,
                   size_t channel, RecordingPlan* plan);

}  // namespace robostress::calibration
