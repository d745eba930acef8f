#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "eval/plan/plan.h"
#include "eval/store/run_directory.h"

namespace robostress {

// What one worker process runs: a unit, or a part of one.
//
// Episodes of a method that adapts are sequential, because the adapter is carried from one to the
// next. A method that carries nothing may be run in parts, ranges of its episodes in the order of
// execution; each part is written to parts/ID/FIRST-LAST/ and, once all are there, they are
// joined to units/ID/, which is then the same as of the undivided unit, byte by byte (timings
// apart).
struct WorkItem {
  const PlannedUnit* unit = nullptr;
  int first = 0, count = 0;  // episodes
  int part_episodes = 0;     // 0: undivided

  bool IsPart() const { return part_episodes > 0; }
  std::string Range() const;  // "40-59"
  std::string Name() const;   // "ID", or "ID.40-59": unique, a file name
  std::string Folder(const RunDirectory& run) const;
  bool Done(const RunDirectory& run) const;
};

// True when the unit's episodes do not depend on each other.
bool MaySplit(const PlannedUnit& unit);
// What is to be run for `units`, the longest first. A unit that may be split is run in parts of
// `part_episodes` (0: undivided), unless it has been begun, which decides.
std::vector<WorkItem> PendingItems(const RunDirectory& run, const std::vector<PlannedUnit>& units,
                                   int part_episodes);
// Publishes what a worker of the item reads: the unit's configuration, and how it is divided.
absl::Status PublishItem(const RunDirectory& run, const WorkItem& item);
// Joins the unit's parts when all are done; nothing when some are missing or there are none.
// DataLoss or FailedPrecondition when they do not fit together.
absl::Status JoinParts(const RunDirectory& run, const PlannedUnit& unit);

}  // namespace robostress
