#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "absl/algorithm/container.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/embedded_policies.h"
#include "common/joint_errors/scenario_file.h"
#include "common/libero/bddl.h"
#include "common/libero/fixtures.h"
#include "common/libero/home.h"
#include "common/libero/init_states.h"
#include "common/libero/protocols.h"
#include "common/libero/task_folder.h"
#include "common/rollout/field_checks.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/robots.h"
#include "common/wire/remote_policy.h"
#include "eval/plan/grid_overrides.h"
#include "eval/plan/plan.h"
#include "eval/plan/titles.h"

namespace robostress {
namespace {

// Collects complaints, so that a person corrects all of a command at once.
class Complaints {
 public:
  void Add(std::string text) { texts_.push_back(std::move(text)); }

  // Checks names against a known list.
  void CheckNames(const std::string& what, const std::vector<std::string>& names,
                  const std::vector<std::string>& known) {
    std::vector<std::string> unknown;
    for (const std::string& name : names) {
      if (std::find(known.begin(), known.end(), name) == known.end())
        unknown.push_back(absl::StrCat("'", name, "'"));
    }
    if (!unknown.empty()) {
      Add(absl::StrCat("unknown ", what, " ", absl::StrJoin(unknown, ", "),
                       "; known: ", absl::StrJoin(known, ", ")));
    }
    if (names.empty())
      Add(absl::StrCat("no ", what, " given; known: ", absl::StrJoin(known, ", ")));
  }

  template <class T>
  void CheckUnique(const std::string& what, const std::vector<T>& values) {
    std::set<T> seen;
    for (const T& value : values) {
      if (!seen.insert(value).second)
        Add(absl::StrCat(what, " ", value, " is given twice; remove one"));
    }
  }

  absl::Status ToStatus() const {
    if (texts_.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("the sweep cannot be planned:\n  - ", absl::StrJoin(texts_, "\n  - ")));
  }

 private:
  std::vector<std::string> texts_;
};

// The robot's arms; or clean and the seven, in the order of the tables.
std::vector<std::string> DefaultScenarios(const RobotInfo& robot) {
  if (!robot.arms.empty()) return ScenariosOf(robot);
  std::vector<std::string> names;
  for (const std::string& name : ScenarioNames()) {
    const absl::StatusOr<Scenario> scenario = MakeScenario(name, 5);
    if (name == "clean" || (scenario.ok() && scenario->deployment)) names.push_back(name);
  }
  return names;
}

// Names in the order of `known`, so that the order of flags changes nothing.
std::vector<std::string> InOrderOf(const std::vector<std::string>& known,
                                   const std::vector<std::string>& names) {
  std::vector<std::string> ordered;
  for (const std::string& name : known) {
    if (std::find(names.begin(), names.end(), name) != names.end()) ordered.push_back(name);
  }
  return ordered;
}

// Of which embedded policies move the robot.
bool Moves(const RobotInfo& robot, const std::string& policy) {
  return std::find(robot.policies.begin(), robot.policies.end(), policy) != robot.policies.end();
}

std::string PoliciesByName(const RobotInfo& robot) {
  std::vector<std::string> names = robot.policies;
  if (robot.name == "panda") names.insert(names.end(), {"expert", "replay"});
  return absl::StrJoin(names, ", ");
}

void CheckPolicies(const SweepGrid& grid, const RobotInfo& robot, PolicyHome home,
                   Complaints& complaints) {
  const bool has_base =
      std::find(grid.methods.begin(), grid.methods.end(), "base") != grid.methods.end();
  const std::string known = PoliciesByName(robot);
  for (const std::string& policy : grid.policies) {
    if (RunsInWorker(policy) && robot.name == "panda") {
      if (!has_base) {
        complaints.Add(
            absl::StrCat("policy ", policy,
                         " does not adapt and runs with method base only; add it to --methods"));
      }
      if (policy == "replay" && grid.replay_file.empty()) {
        complaints.Add("policy replay needs --replay-file FILE (safetensors with actions [T, 7])");
      }
    } else if (policy == kPiperPolicy && !Moves(robot, policy)) {
      complaints.Add(absl::StrCat("policy '", policy,
                                  "' moves a Piper's joints, the suites' arm is a Panda; known: ",
                                  known, "; give --robot piper"));
    } else if (IsSuitePolicy(policy) && !Moves(robot, policy)) {
      complaints.Add(absl::StrCat("policy '", policy, "' moves a Panda's hand, the robot is a ",
                                  robot.name, "; known: ", known));
    } else if (home == PolicyHome::kHere && !Moves(robot, policy) && policy != "nano:random" &&
               access(policy.c_str(), R_OK) != 0) {
      complaints.Add(absl::StrCat("unknown policy '", policy, "'; known: ", known,
                                  ", or the path of a readable weights file; "
                                  "a policy that another server holds needs --server HOST:PORT"));
    }
  }
}

// A policy that somebody else serves.
void CheckRemote(const SweepGrid& grid, const RobotInfo& robot, PolicyHome home,
                 Complaints& complaints) {
  if (!grid.remote.used()) return;
  if (home == PolicyHome::kHere)
    complaints.Add("the grid asks another server's policy; give its address: --policy-url URL");
  if (robot.name != "panda")
    complaints.Add(absl::StrCat("another server's policy moves the simulated panda, the robot is ",
                                robot.name));
  if (grid.policies.size() != 1) {
    complaints.Add(absl::StrCat("policies are ", absl::StrJoin(grid.policies, ", "),
                                "; another server's policy has one name: --policies NAME"));
  }
  constexpr int kPandaCommand = 7;
  if (grid.remote.action_dim != kPandaCommand) {
    complaints.Add(absl::StrCat("remote.action_dim is ", grid.remote.action_dim,
                                ", and a Panda's command has 7 numbers: translation, rotation, "
                                "gripper; have the server send 7"));
  }
  for (const std::string& policy : grid.policies)
    if (RunsInWorker(policy))
      complaints.Add(absl::StrCat(
          "policy ", policy, " runs in the worker; choose another name for what the server holds"));
  for (const std::string& name : grid.methods) {
    const absl::StatusOr<MethodOptions> method = MakeMethod(name);
    if (method.ok() && method->adapts()) {
      complaints.Add(
          absl::StrCat("method ", name,
                       " adapts weights, which are the other server's; methods that correct "
                       "commands alone: base, gain, direct, ours_following"));
    }
  }
  if (const absl::Status status = CheckRemotePolicy(grid.remote); !status.ok())
    complaints.Add(std::string(status.message()));
}

void CheckScenarios(const SweepGrid& grid, const RobotInfo& robot, Complaints& complaints) {
  std::vector<std::string> built_in, labels;
  std::map<std::string, std::string> titled;  // what a table's row is called, and by whom
  for (const std::string& scenario : grid.scenarios) {
    labels.push_back(ScenarioLabel(scenario));
    const std::string title = ScenarioTitle(scenario);
    if (const auto [other, added] = titled.emplace(title, scenario);
        !added && ScenarioLabel(other->second) != labels.back()) {
      complaints.Add(absl::StrCat("scenarios ", other->second, " and ", scenario,
                                  " have one title, '", title,
                                  "': no table could tell them apart; give a file another"));
    }
    if (!IsScenarioFile(scenario)) {
      built_in.push_back(scenario);
    } else if (const auto file = ReadScenarioFile(scenario, robot.description); !file.ok()) {
      complaints.Add(std::string(file.status().message()));
    }
  }
  if (!built_in.empty()) complaints.CheckNames("scenario", built_in, ScenariosOf(robot));
  complaints.CheckUnique("scenario", labels);
}

void CheckStepLimits(const SweepGrid& grid, Complaints& complaints) {
  if (grid.step_limits.empty()) return;
  const absl::StatusOr<LiberoProtocol> protocol = FindLiberoProtocol(grid.step_limits);
  if (!protocol.ok()) {
    complaints.Add(absl::StrCat("step_limits: ", protocol.status().message()));
    return;
  }
  for (const std::string& suite : grid.suites) {
    if (FindSuite(suite) == nullptr || protocol->StepLimit(suite) > 0) continue;
    complaints.Add(absl::StrCat(
        "protocol ", protocol->name, " has no step limit for suite ", suite, "; it has ",
        absl::StrJoin(protocol->step_limits, ", ",
                      [](std::string* text, const auto& limit) { text->append(limit.first); }),
        TaskFolderOf(suite).empty()
            ? ""
            : "; a folder, or a link to it, whose name begins with one of them and _ has its"));
  }
}

bool NeedsLibero(const std::string& suite) {
  const SuiteInfo* info = FindSuite(suite);
  return info != nullptr && info->needs_libero;
}

// That its BDDL file can be read and that it has a stored state for each episode.
absl::Status CheckTask(const SweepGrid& grid, const LiberoTaskFolder& folder,
                       const std::string& task) {
  RS_RETURN_IF_ERROR(libero::ReadBddl(absl::StrCat(folder.path, "/", task, ".bddl")).status());
  const std::string file = InitialStatesOf(folder, task);
  if (file.empty())
    return absl::NotFoundError(
        absl::StrCat(NoInitialStates(folder, task), "; leave it out with --tasks"));
  RS_ASSIGN_OR_RETURN(const libero::InitStates states, libero::ReadInitStates(file));
  return libero::CheckEpisodeRows(states, grid.first_initial_state, grid.episodes);
}

constexpr size_t kMostFaults = 5;  // said of a folder; LIBERO-90's ninety tasks may share one

// That a policy's server will take the folder's name and every task that is played is there, before
// a cluster waits for it.
void CheckTaskFolders(const SweepGrid& grid, Complaints& complaints) {
  for (const std::string& path : grid.libero_tasks) {
    const absl::StatusOr<LiberoTaskFolder> folder = ReadLiberoTaskFolder(path);
    if (!folder.ok()) continue;  // said already
    const absl::Status name = CheckName("its name", folder->suite);
    if (!name.ok() && !absl::c_all_of(grid.policies, RunsInWorker))
      complaints.Add(absl::StrCat("libero_tasks ", path, ": ", name.message(), "; rename it"));
    std::vector<std::string> faults;
    for (int task = 0; task < static_cast<int>(folder->tasks.size()); ++task) {
      if (!grid.tasks.empty() && !absl::c_linear_search(grid.tasks, task)) continue;
      const absl::Status status = CheckTask(grid, *folder, folder->tasks[task]);
      if (!status.ok())
        faults.push_back(absl::StrCat("task ", task, " of ", path, ", ", folder->tasks[task], ": ",
                                      status.message()));
    }
    for (size_t i = 0; i < std::min(faults.size(), kMostFaults); ++i) complaints.Add(faults[i]);
    if (faults.size() > kMostFaults)
      complaints.Add(absl::StrCat("and ", faults.size() - kMostFaults, " more tasks of ", path));
  }
}

void CheckRanges(const SweepGrid& grid, Complaints& complaints) {
  for (const int severity : grid.severities) {
    if (severity < 1 || severity > 5)
      complaints.Add(absl::StrCat("severity ", severity, " is not a level 1 to 5"));
  }
  if (grid.severities.empty()) complaints.Add("no severity given; levels are 1 to 5");
  if (grid.seeds.empty()) complaints.Add("no seed given");
  if (grid.episodes < 1 || grid.episodes > 10000) {
    complaints.Add(absl::StrCat("episodes is ", grid.episodes, ", must be 1 to 10000"));
  }
  if (grid.videos < 0)
    complaints.Add(absl::StrCat("videos is ", grid.videos, ", must be 0 or more"));
  for (const std::string& name : grid.suites) {
    const SuiteInfo* suite = FindSuite(name);
    if (suite == nullptr) continue;
    std::vector<int> unknown;
    for (const int task : grid.tasks)
      if (task < 0 || task >= suite->num_tasks) unknown.push_back(task);
    if (!unknown.empty()) {
      complaints.Add(absl::StrCat(
          "task ", unknown[0], " of ", name,
          unknown.size() > 1 ? absl::StrCat(" (and ", unknown.size() - 1, " more)") : "",
          " does not exist; it has tasks 0 to ", suite->num_tasks - 1));
    }
    if (grid.first_initial_state < 0 || grid.first_initial_state >= suite->num_initial_states) {
      complaints.Add(absl::StrCat(
          "first initial state ", grid.first_initial_state, " of ", name, " does not exist; ",
          TaskFolderOf(name).empty() ? absl::StrCat("it has 0 to ", suite->num_initial_states - 1)
                                     : "they are counted from 0"));
    }
    if (suite->needs_libero && (grid.libero_root.empty() || grid.robosuite_root.empty())) {
      complaints.Add(absl::StrCat(
          name,
          " reads LIBERO's own files: run `robostress libero setup` once, give --libero-root DIR "
          "and --robosuite-root DIR, or set LIBERO_ROOT and ROBOSUITE_ROOT"));
    }
  }
  if (grid.libero_fixtures != SweepGrid().libero_fixtures && !grid.suites.empty() &&
      std::none_of(grid.suites.begin(), grid.suites.end(), NeedsLibero)) {
    complaints.Add(absl::StrCat("libero_fixtures ", grid.libero_fixtures,
                                " is of LIBERO's scenes, and none of the suites has them; leave it "
                                "out"));
  }
  if (const auto fixtures = ParseLiberoFixtures(grid.libero_fixtures); !fixtures.ok())
    complaints.Add(std::string(fixtures.status().message()));
}

absl::Status CheckOverride(const std::string& assignment, UnitConfig& scratch) {
  for (const char* section : {"sim.", "method.", "client.", "remote.", "latency."}) {
    if (absl::StartsWith(assignment, section) && absl::StrContains(assignment, '='))
      return ApplyOverrides({assignment}, scratch);
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "override '", assignment,
      "' must be sim.KEY=VALUE, method.KEY=VALUE, client.KEY=VALUE, remote.KEY=VALUE or "
      "latency.KEY=VALUE"));
}

void CheckOverrides(const SweepGrid& grid, Complaints& complaints) {
  bool readable = true;
  for (const std::string& assignment : grid.overrides) {
    UnitConfig scratch;
    absl::Status status = CheckOverride(assignment, scratch);
    if (absl::StartsWith(assignment, "method.method=")) {
      status = absl::InvalidArgumentError(
          "override of method.method: a unit is named by its method; choose methods instead");
    }
    if (status.ok()) continue;
    readable = false;
    complaints.Add(std::string(status.message()));
  }
  if (!readable) return;
  for (const std::string& name : grid.methods) {
    absl::Status status = MethodOf(grid, name).status();
    if (absl::IsNotFound(status)) return;  // complained of already
    if (!status.ok()) complaints.Add(std::string(status.message()));
  }
}

// What a worker would refuse, of every suite, policy and method: scenarios, levels and seeds change
// nothing of it.
absl::Status CheckUnits(SweepGrid grid) {
  grid.scenarios.resize(1);
  grid.severities.resize(1);
  grid.seeds.resize(1);
  RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
  Complaints complaints;
  std::set<std::string> said;
  for (const PlannedUnit& unit : units) {
    const absl::Status status = ResolveUnit(unit.config).status();
    const std::string complaint =
        absl::StrCat(unit.config.suite, ": ", absl::StripPrefix(status.message(), "unit: "));
    if (!status.ok() && said.insert(complaint).second) complaints.Add(complaint);
  }
  return complaints.ToStatus();
}

// What a grid that names no policy evaluates on its suites.
std::string DefaultPolicy(const SweepGrid& grid, const RobotInfo& robot, Complaints& complaints) {
  if (grid.remote.used()) return "remote";
  if (robot.name != "panda" || std::none_of(grid.suites.begin(), grid.suites.end(), NeedsLibero))
    return robot.policy;
  if (!std::all_of(grid.suites.begin(), grid.suites.end(), IsLiberosOwn)) {
    complaints.Add(absl::StrCat("no policy here has learned all of ",
                                absl::StrJoin(grid.suites, ", "), "; name one: --policies NAME (",
                                robot.policy, " has learned the embedded suites, ", kLiberoPolicy,
                                " LIBERO's own four)"));
  }
  return kLiberoPolicy;
}

}  // namespace

absl::StatusOr<SweepGrid> ResolveGrid(SweepGrid grid, PolicyHome home) {
  const absl::StatusOr<RobotInfo> found = FindRobot(grid.robot);
  if (!found.ok()) return absl::InvalidArgumentError(found.status().message());
  const RobotInfo& robot = *found;
  const bool own_suites = grid.suites.empty();
  Complaints complaints;
  for (const std::string& folder : grid.libero_tasks) {
    const absl::StatusOr<std::string> suite = AddTaskFolder(folder);
    if (!suite.ok())
      complaints.Add(absl::StrCat("libero_tasks: ", suite.status().message()));
    else if (own_suites)
      grid.suites.push_back(*suite);
    else if (!absl::c_linear_search(grid.suites, *suite))
      complaints.Add(absl::StrCat("libero_tasks ", folder, " is suite '", *suite,
                                  "', which is not among the suites given; add it, or give one of "
                                  "the two"));
  }
  if (grid.suites.empty()) grid.suites = robot.suites;
  if (grid.scenarios.empty()) grid.scenarios = DefaultScenarios(robot);
  if (grid.policies.empty()) grid.policies = {DefaultPolicy(grid, robot, complaints)};
  if (std::any_of(grid.suites.begin(), grid.suites.end(), NeedsLibero)) {
    grid.libero_root = LiberoRoot(grid.libero_root, "LIBERO_ROOT");
    grid.robosuite_root = LiberoRoot(grid.robosuite_root, "ROBOSUITE_ROOT");
  }
  if (const absl::Status status = ApplyOverrides(PartOverrides(grid).remote, grid.remote);
      !status.ok())
    complaints.Add(std::string(status.message()));
  const std::vector<std::string> suites = SuitesOf(robot.name);
  complaints.CheckNames("suite", grid.suites, suites);
  for (const std::string& suite : grid.suites) {
    if (FindSuite(suite) == nullptr && absl::StrContains(suite, "libero"))
      complaints.Add(absl::StrCat("suite ", suite,
                                  ": any folder of LIBERO tasks is a suite by --libero-tasks DIR"));
  }
  CheckScenarios(grid, robot, complaints);
  complaints.CheckNames("method", grid.methods, robot.methods);
  CheckPolicies(grid, robot, home, complaints);
  CheckRemote(grid, robot, home, complaints);
  CheckRanges(grid, complaints);
  CheckTaskFolders(grid, complaints);
  CheckStepLimits(grid, complaints);
  complaints.CheckUnique("suite", grid.suites);
  complaints.CheckUnique("method", grid.methods);
  complaints.CheckUnique("severity", grid.severities);
  complaints.CheckUnique("seed", grid.seeds);
  complaints.CheckUnique("task", grid.tasks);
  std::vector<std::string> labels;
  for (const std::string& policy : grid.policies) labels.push_back(PolicyLabel(policy));
  complaints.CheckUnique("policy name", labels);
  CheckOverrides(grid, complaints);
  RS_RETURN_IF_ERROR(complaints.ToStatus());
  grid.suites = InOrderOf(suites, grid.suites);
  std::vector<std::string> scenarios = InOrderOf(ScenariosOf(robot), grid.scenarios);
  for (const std::string& scenario : grid.scenarios) {
    if (IsScenarioFile(scenario))
      scenarios.push_back(std::filesystem::absolute(scenario).lexically_normal().string());
  }
  grid.scenarios = scenarios;
  grid.methods = InOrderOf(robot.methods, grid.methods);
  RS_RETURN_IF_ERROR(CheckUnits(grid));
  return grid;
}

}  // namespace robostress
