#pragma once

#include <string>
#include <vector>

#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "eval/report/result_export.h"
#include "eval/report/result_file.h"
#include "eval/statistics/summary.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {

// A run of a policy behind somebody else's server that takes no seed: Clean and Heavy Payload, base
// and model following, four states, two repeats of each; three reconnections.
inline RunData RemoteRun() {
  RunData run;
  run.environment = {{"mujoco", "3.3.0"}, {"processor", "CPU"}};
  const auto add = [&run](int64_t repeat, const char* scenario, const char* method,
                          const std::vector<int>& outcomes) {
    UnitResult unit = SyntheticUnit(scenario, method, outcomes);
    unit.config.policy = "pi05";
    unit.config.seed = repeat;
    unit.config.remote.dialect.name = "libero";
    unit.id =
        unit.config.suite + "-" + scenario + "-L5-pi05-" + method + "-s" + std::to_string(repeat);
    unit.provenance = {{"policy", "pi05"},
                       {"model_hash", std::string(64, 'a')},
                       {"version", "0.9"},
                       {"metadata", "{}"}};
    ServerRow server;
    server.url =
        repeat == 0 ? "ws://gpu.lab.example:8000/team-7?key=hunter2" : "ws://10.1.2.3:8000/team-7";
    server.metadata_sha256 = Sha256Hex("{}");
    unit.servers.push_back(server);
    run.units.push_back(unit);
  };
  for (const int64_t repeat : {0, 1}) {
    add(repeat, "clean", "base", {1, 1, 1, 0});
    add(repeat, "clean", "ours_following", {1, 1, 1, repeat == 0 ? 0 : 1});
    add(repeat, "heavy_payload", "base", {repeat == 0 ? 1 : 0, 1, 0, 0});
    add(repeat, "heavy_payload", "ours_following", {1, 1, 1, 0});
  }
  // 2 of 8 and 6 of 8 under Heavy Payload.
  run.units[6].episodes[1].success = false;
  run.units[2].servers.push_back(run.units[2].servers[0]);
  run.units[2].servers[1].reconnections = 3;
  SortUnits(run.units);
  return run;
}

inline ResultFile Exported(const RunData& run) {
  const absl::StatusOr<ResultFile> file = ExportResults(run, Summarise(run, 200));
  EXPECT_TRUE(file.ok()) << file.status();
  return file.ok() ? *file : ResultFile();
}

}  // namespace robostress
