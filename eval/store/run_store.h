#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/records/episode_row.h"
#include "common/records/server_row.h"
#include "common/unit_config.h"
#include "nlohmann/json.hpp"

namespace robostress {

// Wall time of a unit's episodes, summed [s]; kept out of every table that is compared.
struct TimingSums {
  int episodes = 0;
  double wall_s = 0, predict_s = 0, step_s = 0, observe_s = 0, feedback_s = 0;
};

// One finished unit of a run directory.
struct UnitResult {
  std::string id;
  // As it was played, but for the policy, which is its label, and a scenario file, which is the
  // run's copy where it has one.
  UnitConfig config;
  std::vector<EpisodeRow> episodes;  // in the order they were run
  std::vector<std::string> videos;   // paths, sorted
  nlohmann::json provenance;       // provenance.json: policy, model_hash, version; null when absent
  std::vector<ServerRow> servers;  // who answered, where somebody else serves the policy
  TimingSums timing;
  std::vector<std::string> machines;  // kinds of processor at work, sorted (processor_kind.h)
};

// A run directory as far as it is finished.
struct RunData {
  std::string dir;
  std::vector<UnitResult> units;        // canonical order, whatever the order of flags and dispatch
  std::vector<std::string> unfinished;  // ids without DONE, begun or only planned, sorted
  std::map<std::string, int> machines;  // units by kind of processor; several: results may differ
  nlohmann::json environment;           // environment.json, null when absent
  double sweep_wall_s = 0;              // over all calls, from launches.jsonl
};

// Reads every finished unit; NotFound when `dir` is no run directory or has none. DataLoss, with
// everything that is wrong listed: finished units whose files are damaged or contradict their
// configuration or checksum, units of one policy with different weights, grids that cannot be read.
absl::StatusOr<RunData> LoadRun(const std::string& dir);
// Canonical order: suite, scenario, severity, policy, method, seed.
void SortUnits(std::vector<UnitResult>& units);
// The episode table: a header, then one row per episode in canonical order. Byte-equal for equal
// results, however many workers produced them; no timing in it.
std::string EpisodeTableCsv(const RunData& run);
// "" when all units ran on one kind of processor; else what a table must say.
std::string MixedMachinesNote(const RunData& run);
// Whether equal keys of an episode give the policy equal sampling noise.
bool PairsNoise(const UnitConfig& config);
bool PairsNoise(const UnitResult& unit);  // what its server said of itself stands above
// "" where every policy's sampling noise is a function of the episode; else what a table must say.
std::string UnpairedNoiseNote(const RunData& run);
// "" where at most a quarter of a policy's own commands lay outside the robot's range; else what a
// table must say.
std::string ClippedCommandsNote(const RunData& run);
// "" where every answer is there at once; else what a table must say.
std::string LateAnswersNote(const RunData& run);
// Timings apart: one row per unit, summed over its timing.jsonl.
std::string UnitTimingCsv(const RunData& run);

}  // namespace robostress
