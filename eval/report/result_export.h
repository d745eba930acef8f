#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/report/result_file.h"
#include "eval/statistics/summary.h"
#include "eval/store/run_store.h"

namespace robostress {

// Several run directories as one run, in memory. FAILED_PRECONDITION lists units that stand in two
// of them and policies with two models.
absl::StatusOr<RunData> JoinRuns(const std::vector<std::string>& dirs);

// A run for other laboratories. `summary` is the run's. FAILED_PRECONDITION names cells whose units
// were not played alike: other options of the simulator or the method, other tasks.
absl::StatusOr<ResultFile> ExportResults(const RunData& run, const Summary& summary);

// "ws://HOST:8000/": without host and query; a path that is not `usual` is "/...", for it may hold
// a key or a name.
std::string SharedUrl(const std::string& url, const std::string& usual);

}  // namespace robostress
