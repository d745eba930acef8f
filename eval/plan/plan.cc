#include "eval/plan/plan.h"

#include <algorithm>
#include <filesystem>
#include <map>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/libero/protocols.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/robots.h"
#include "eval/plan/grid_overrides.h"

namespace robostress {
namespace {

bool SameFactors(const std::vector<SeverityFactors>& a, const std::vector<SeverityFactors>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const SeverityFactors& x, const SeverityFactors& y) {
                      return x.friction == y.friction && x.gravity == y.gravity &&
                             x.backlash == y.backlash && x.compliance == y.compliance;
                    });
}

}  // namespace

int PlannedUnit::EpisodeCount() const {
  return static_cast<int>(config.tasks.size()) * config.episodes;
}

bool SameAtEveryLevel(const std::string& scenario) {
  if (!ArmTitle(scenario).empty()) return true;
  const absl::StatusOr<Scenario> mild = MakeScenario(scenario, 1), full = MakeScenario(scenario, 5);
  return mild.ok() && full.ok() && SameFactors(mild->end, full->end) &&
         SameFactors(mild->start, full->start);
}

std::string PolicyLabel(const std::string& policy) {
  std::filesystem::path path(policy);
  if (!path.has_filename()) path = path.parent_path();  // a folder with its slash
  return path.extension() == ".safetensors" ? path.stem().string() : path.filename().string();
}

SweepGrid QuickGrid() {
  SweepGrid grid;
  grid.suites = {"tabletop_object"};
  grid.tasks = {0, 1};
  grid.episodes = 10;
  grid.videos = 1;
  grid.methods = {"base", "ours", "ours_following"};
  return grid;
}

SweepGrid FullGrid() {
  SweepGrid grid;
  grid.suites = {"tabletop_spatial", "tabletop_object", "tabletop_goal", "tabletop_long"};
  return grid;
}

absl::StatusOr<std::vector<int>> ParseTasks(const std::string& text) {
  std::vector<int> tasks;
  if (text.empty() || text == "all") return tasks;
  const absl::Status error = absl::InvalidArgumentError(absl::StrCat(
      "tasks '", text,
      "' is neither a number of tasks (2), nor indices (0,3,7), nor a range (2-5), nor all"));
  int count = 0;
  if (absl::SimpleAtoi(text, &count)) {
    if (count < 1) return error;
    for (int task = 0; task < count; ++task) tasks.push_back(task);
    return tasks;
  }
  for (absl::string_view part : absl::StrSplit(text, ',')) {
    const std::vector<std::string> ends = absl::StrSplit(part, '-');
    int first = 0, last = 0;
    if (ends.size() > 2 || !absl::SimpleAtoi(ends.front(), &first) ||
        !absl::SimpleAtoi(ends.back(), &last) || first < 0 || last < first || last > 9999) {
      return error;
    }
    for (int task = first; task <= last; ++task) tasks.push_back(task);
  }
  return tasks;
}

namespace {

std::string IdWith(const std::string& policy, const UnitConfig& config) {
  return absl::StrCat(config.suite, "-", ScenarioLabel(config.scenario), "-L", config.severity, "-",
                      policy, "-", config.method->method, "-s", config.seed);
}

}  // namespace

std::string UnitId(const UnitConfig& config) { return IdWith(PolicyLabel(config.policy), config); }

std::string OlderUnitId(const UnitConfig& config) {
  const std::filesystem::path path(config.policy);
  return path.has_parent_path() ? IdWith(path.stem().string(), config) : UnitId(config);
}

absl::StatusOr<std::vector<PlannedUnit>> ExpandUnits(const SweepGrid& grid) {
  std::vector<PlannedUnit> units;
  std::map<std::string, Deferred<MethodOptions>> methods;
  for (const std::string& name : grid.methods) {
    RS_ASSIGN_OR_RETURN(methods[name], MethodOf(grid, name));
  }
  UnitConfig common;
  common.latency = grid.latency;
  RS_RETURN_IF_ERROR(ApplyOverrides(PartOverrides(grid).others, common));
  // In a process that has read a grid's file alone. What cannot be added is complained of below.
  for (const std::string& folder : grid.libero_tasks) AddTaskFolder(folder).status().IgnoreError();
  for (const std::string& suite_name : grid.suites) {
    UnitConfig config = common;
    config.robot = grid.robot;
    config.suite = suite_name;
    config.tasks = grid.tasks;
    if (config.tasks.empty()) {
      const SuiteInfo* suite = FindSuite(suite_name);
      if (suite == nullptr) {
        return absl::NotFoundError(absl::StrCat(
            "suite '", suite_name, "' is unknown; known: ",
            absl::StrJoin(SuitesOf(grid.robot), ", "), "; task folders that the grid names: ",
            grid.libero_tasks.empty() ? "none" : absl::StrJoin(grid.libero_tasks, ", ")));
      }
      for (int task = 0; task < suite->num_tasks; ++task) config.tasks.push_back(task);
    }
    config.episodes = grid.episodes;
    config.first_initial_state = grid.first_initial_state;
    config.videos = grid.videos;
    config.replay_file = grid.replay_file;
    config.libero_root = grid.libero_root;
    config.robosuite_root = grid.robosuite_root;
    config.libero_fixtures = grid.libero_fixtures;
    config.libero_tasks = TaskFolderOf(suite_name);
    config.remote = grid.remote;
    if (!grid.step_limits.empty()) {
      RS_ASSIGN_OR_RETURN(const LiberoProtocol protocol, FindLiberoProtocol(grid.step_limits));
      config.horizon = protocol.StepLimit(suite_name);
    }
    for (const std::string& scenario : grid.scenarios) {
      config.scenario = scenario;
      const std::vector<int> once = {
          *std::max_element(grid.severities.begin(), grid.severities.end())};
      for (const int severity : SameAtEveryLevel(scenario) ? once : grid.severities) {
        config.severity = severity;
        for (const std::string& policy : grid.policies) {
          config.policy = policy;
          for (const std::string& method : grid.methods) {
            if (RunsInWorker(policy) && method != "base") continue;
            config.method = methods.at(method);
            for (const int64_t seed : grid.seeds) {
              config.seed = seed;
              units.push_back({UnitId(config), config});
            }
          }
        }
      }
    }
  }
  return units;
}

}  // namespace robostress
