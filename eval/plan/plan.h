#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/unit/unit_plan.h"
#include "common/unit_config.h"

namespace robostress {

// What a sweep evaluates: the product of the lists. This struct is RUN_DIR/sweep.yaml and the
// schema of a grid file.
struct SweepGrid {
  std::string robot = "panda";         // of common/unit/robots.h
  std::vector<std::string> suites;     // empty: tabletop_goal, or the robot's own
  std::vector<std::string> scenarios;  // empty: clean and the seven, or the robot's arms
  std::vector<int> severities = {5};
  std::vector<std::string> policies;  // empty: the robot's embedded one, or LIBERO's
  std::vector<std::string> methods = {"base", "ours"};
  std::vector<int64_t> seeds = {0};
  std::vector<int> tasks;  // empty: all
  int episodes = 20;
  int first_initial_state = 0;
  int videos = 0;
  std::vector<std::string> overrides;  // "sim.x=y", "method.x=y", ...
  std::string replay_file, libero_root, robosuite_root;
  std::string libero_fixtures = "centred";
  RemotePolicyOptions remote;  // used: another server holds the policy, whose label stands above
  std::string step_limits;     // of common/libero/protocols.h; empty: the suites' own
  LatencyOptions latency;      // of answers, in simulated time
  std::vector<std::string> libero_tasks;  // folders of BDDL files, a suite each

  template <class V>
  void Visit(V& v) {
    v.Field("robot", robot, "panda, piper");
    v.Field("suites", suites, "see `robostress suites`; empty: tabletop_goal, or the robot's own");
    v.Field("scenarios", scenarios,
            "see `robostress scenarios`, or scenario files; empty: clean and the seven deployment "
            "scenarios, or the robot's arms");
    v.Field("severities", severities, "levels 1 (mild) to 5 (full)");
    v.Field(
        "policies", policies,
        "nano, expert, replay, or a weights file; empty: nano, nano-libero for LIBERO's suites, or "
        "the robot's own");
    v.Field("methods", methods, "base, ours, controls and ablations");
    v.Field("seeds", seeds, "of the policy's sampling noise");
    v.Field("tasks", tasks, "task indices within each suite; empty: all");
    v.Field("episodes", episodes, "consecutive episodes per task");
    v.Field("first_initial_state", first_initial_state, "0-19 reporting, 40-49 dev");
    v.Field("videos", videos, "film the first N episodes of each task");
    v.Field("overrides", overrides,
            "SECTION.KEY=VALUE in order; sections: sim, method, client, remote, latency");
    v.Field("replay_file", replay_file, "actions for policy replay");
    v.Field("libero_root", libero_root, "LIBERO checkout, for suites libero_*");
    v.Field("robosuite_root", robosuite_root, "robosuite checkout, for suites libero_*");
    v.Field("libero_fixtures", libero_fixtures,
            "where fixtures of suites libero_* stand: centred, sampled, numpy[:SEED] or a file");
    v.LateSection("remote", remote, remote.used(), "how a policy of another server is asked");
    v.Late("step_limits", step_limits, std::string(),
           "whose step limits suites libero_* have: openpi, lerobot; empty: the suites' own");
    v.LateSection("latency", latency, latency.used(), "answers that take time");
    v.Late("libero_tasks", libero_tasks, std::vector<std::string>(),
           "folders of LIBERO tasks; each is a suite with the folder's name");
  }
};

// One unit of the sweep: what one worker process runs from start to end.
struct PlannedUnit {
  std::string
      id;  // "tabletop_goal-heavy_payload-L5-nano-ours-s0": folder name, unique in the sweep
  UnitConfig config;
  int EpisodeCount() const;  // tasks x episodes
};

// What `robostress sweep --quick` and `--full` start from; other flags are applied on top.
SweepGrid QuickGrid();
SweepGrid FullGrid();

// "4": the first four tasks; "0,3,7" and "2-5": indices; "all" or "": empty.
absl::StatusOr<std::vector<int>> ParseTasks(const std::string& text);
// Where a policy that does not run in the worker is served: by a server that the sweep starts, or
// by one that runs already.
enum class PolicyHome { kHere, kElsewhere };

// Fills defaults (the robot's suites, scenarios and policy; LIBERO's and robosuite's folders from
// the environment) and checks every name and range. The error lists everything that is wrong, with
// the names that are known. Policies served elsewhere may have any name.
absl::StatusOr<SweepGrid> ResolveGrid(SweepGrid grid, PolicyHome home = PolicyHome::kHere);
// Units in canonical order: suite, scenario, severity, policy, method, seed. A policy that does not
// adapt (expert, replay) gets the method base only; a scenario that is equal at all levels gets one
// level.
absl::StatusOr<std::vector<PlannedUnit>> ExpandUnits(const SweepGrid& resolved);
// The id of the unit with these settings; method.method names the method.
std::string UnitId(const UnitConfig& config);
// The same as versions up to 0.2 had it, which called a checkpoint pi0.5 "pi0".
std::string OlderUnitId(const UnitConfig& config);
// True when every level of the scenario is the same (clean, nominal, dev_mixed; an arm).
bool SameAtEveryLevel(const std::string& scenario);
// The policy's name as it stands in ids and tables: of a path the last part, .safetensors left out.
std::string PolicyLabel(const std::string& policy);

}  // namespace robostress
