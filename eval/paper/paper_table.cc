#include "eval/paper/paper_table.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/embedded_policies.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/paper/piper_tables.h"

namespace robostress {
namespace {

constexpr PolicyRole kBase = PolicyRole::kBase;

// The paper's learning rate (sec:setting); the presets hold the one chosen for nano.
constexpr char kPaperLearningRate[] = "method.learning_rate=1e-6";

bool Adapts(const std::string& method) {
  const absl::StatusOr<MethodOptions> options = MakeMethod(method);
  return options.ok() && options->adapts();
}

std::vector<std::string> Deployment() {
  return {"heavy_payload",     "thermal_drift_stribeck", "thermal_drift_backlash",
          "aged_transmission", "aged_joint_uniform",     "aged_joint_shoulder",
          "aged_joint_elbow"};
}

std::vector<std::string> WithClean() {
  std::vector<std::string> scenarios = Deployment();
  scenarios.insert(scenarios.begin(), "clean");
  return scenarios;
}

// Base and ours at each level, base at even indices.
PaperTable SeverityTable() {
  PaperTable table;
  table.name = "severity";
  table.scenarios = Deployment();
  table.with_average = true;
  for (int level = 1; level <= 5; ++level) {
    const int first = static_cast<int>(table.columns.size());
    table.columns.push_back({absl::StrCat("Base L", level), kBase, "base", level});
    table.columns.push_back({absl::StrCat("Ours L", level), kBase, "ours", level});
    table.contrasts.push_back({first + 1, first});
  }
  return table;
}

PaperTable External(const std::string& name, const std::string& program) {
  PaperTable table;
  table.name = name;
  table.program = program;
  return table;
}

std::vector<PaperTable> MakeTables() {
  const PaperColumn base{"Base", kBase, "base"}, ours{"Ours", kBase, "ours"},
      gain{"Gain control", kBase, "gain", 5, true}, null{"Null control", kBase, "null", 5, true},
      integral{"Integral action", kBase, "ours_integral", 5, true},
      following{"Model following", kBase, "ours_following", 5, true};
  return {
      {"main",
       WithClean(),
       false,
       true,
       {base,
        {"DR", PolicyRole::kRandomised, "base"},
        {"RobustVLA", PolicyRole::kRobust, "base"},
        ours,
        gain,
        null,
        {"Cloning control", PolicyRole::kCloning, "base", 5, true},
        integral,
        following},
       {{3, 0},
        {3, 4},
        {3, 5},
        {1, 0},
        {2, 0},
        {1, 6},
        {2, 6},
        {7, 0},
        {7, 4},
        {7, 5},
        {7, 3},
        {8, 0},
        {8, 4},
        {8, 5},
        {8, 3}}},
      {"noise",
       {"isolated_stribeck", "isolated_backlash", "isolated_compliance", "isolated_gravity"},
       false,
       true,
       {base, ours, gain, integral, following},
       {{1, 0}, {1, 2}, {3, 0}, {3, 2}, {4, 0}, {4, 2}}},
      {"ablation",
       Deployment(),
       true,
       false,
       {base, {"Direct", kBase, "direct"}, {"w/o residual", kBase, "no_residual"}, ours, gain},
       {{3, 0}, {3, 2}, {1, 0}, {2, 0}, {3, 4}}},
      {"anchor",
       Deployment(),
       false,
       true,
       {{"w/o anchor", kBase, "no_anchor"}, {"w/ anchor", kBase, "ours"}},
       {{1, 0}}},
      ObserverTable(PiperArms({"new"})[0], 1),
      SeverityTable(),
      {"residual",
       WithClean(),
       false,
       false,
       {{"Residual", kBase, "base"}},
       {},
       PaperMeasure::kResidual},
      External("payload", "fidelity"),
      RealArmTable(PiperArms({"new", "used_one_year"}), {1, 2, 3, 4}),
      UnseenTable(PiperArms({"new"})[0]),
  };
}

template <class T>
void AddOnce(std::vector<T>& values, const T& value) {
  if (std::find(values.begin(), values.end(), value) == values.end()) values.push_back(value);
}

// LIBERO's suite of the same idea; the name itself when there is none.
std::string LiberosSuite(const std::string& embedded) {
  const SuiteInfo* ours = FindSuite(embedded);
  for (const SuiteInfo& suite : AllSuites()) {
    if (ours != nullptr && suite.needs_libero && suite.title == "LIBERO-" + ours->title)
      return suite.name;
  }
  return embedded;
}

}  // namespace

const std::string& PaperProtocol::PolicyOf(PolicyRole role) const {
  switch (role) {
    case PolicyRole::kCloning:
      return cloning;
    case PolicyRole::kRandomised:
      return randomised;
    case PolicyRole::kRobust:
      return robust;
    case PolicyRole::kBase:
      break;
  }
  return base;
}

const std::vector<PaperTable>& PaperTables() {
  static const auto& tables = *new std::vector<PaperTable>(MakeTables());
  return tables;
}

absl::StatusOr<PaperTable> FindPaperTable(const std::string& name) {
  RS_ASSIGN_OR_RETURN(const std::vector<PaperTable> found, FindPaperTables({name}));
  return found.front();
}

absl::StatusOr<std::vector<PaperTable>> FindPaperTables(const std::vector<std::string>& names) {
  std::map<std::string, const PaperTable*> known;
  for (const PaperTable& table : PaperTables()) known[table.name] = &table;
  std::vector<PaperTable> found;
  std::vector<std::string> unknown;
  std::set<std::string> asked;
  for (const std::string& name : names) {
    if (!asked.insert(name).second) continue;
    if (const auto table = known.find(name); table != known.end()) {
      found.push_back(*table->second);
    } else {
      unknown.push_back(absl::StrCat("'", name, "'"));
    }
  }
  if (unknown.empty()) return found;
  std::vector<std::string> all;
  for (const PaperTable& table : PaperTables()) all.push_back(table.name);
  return absl::InvalidArgumentError(absl::StrCat("unknown table ", absl::StrJoin(unknown, ", "),
                                                 "; known: ", absl::StrJoin(all, ", ")));
}

PaperProtocol QuickProtocol() {
  PaperProtocol protocol;
  protocol.grid = QuickGrid();
  return protocol;
}

PaperProtocol FullProtocol() {
  PaperProtocol protocol;
  protocol.grid = FullGrid();
  protocol.grid.seeds = {0, 1, 2};
  return protocol;
}

PaperProtocol OnLibero(PaperProtocol protocol, const std::string& checkpoint) {
  for (std::string& suite : protocol.grid.suites) suite = LiberosSuite(suite);
  protocol.papers_rate = PolicyLabel(checkpoint) != kLiberoPolicy;
  protocol.base = checkpoint;
  protocol.cloning.clear();
  protocol.randomised.clear();
  protocol.robust.clear();
  return protocol;
}

absl::StatusOr<std::vector<SweepGrid>> PaperGrids(const PaperTable& table,
                                                  const PaperProtocol& protocol, PolicyHome home) {
  // Methods of each policy at each level in each of the columns' scenarios; equal ones share a
  // grid.
  struct Block {
    std::string policy;
    int severity;
    std::vector<std::string> scenarios, methods;
  };
  std::map<std::tuple<std::string, int, std::string>, std::vector<std::string>> methods;
  for (const PaperColumn& column : table.columns) {
    const std::string& policy = protocol.PolicyOf(column.role);
    if (!policy.empty())
      AddOnce(methods[{policy, column.severity, column.scenario}], column.method);
  }
  std::vector<Block> blocks;
  for (const auto& [key, names] : methods) {
    const auto& [policy, severity, scenario] = key;
    if (!blocks.empty() && blocks.back().policy == policy && blocks.back().severity == severity &&
        blocks.back().methods == names) {
      AddOnce(blocks.back().scenarios, scenario);
    } else {
      blocks.push_back({policy, severity, {scenario}, names});
    }
  }
  std::vector<SweepGrid> grids;
  for (const Block& block : blocks) {
    const std::vector<std::string>& scenarios =
        table.suites.empty() ? table.scenarios : block.scenarios;
    const auto same = std::find_if(grids.begin(), grids.end(), [&](const SweepGrid& grid) {
      return grid.methods == block.methods && grid.scenarios == scenarios;
    });
    if (same != grids.end()) {
      AddOnce(same->policies, block.policy);
      AddOnce(same->severities, block.severity);
      continue;
    }
    SweepGrid grid = protocol.grid;
    grid.scenarios = scenarios;
    grid.policies = {block.policy};
    grid.severities = {block.severity};
    grid.methods = block.methods;
    if (!table.suites.empty()) {
      grid.suites = table.suites;
      const SuiteInfo* suite = FindSuite(table.suites.front());
      if (suite != nullptr && suite->states_go_on) grid.episodes /= suite->num_tasks;
    }
    grids.push_back(grid);
  }
  for (SweepGrid& grid : grids) {
    if (protocol.papers_rate && absl::c_any_of(grid.methods, Adapts))  // the user's come after it
      grid.overrides.insert(grid.overrides.begin(), kPaperLearningRate);
    RS_ASSIGN_OR_RETURN(grid, ResolveGrid(std::move(grid), home));
  }
  return grids;
}

absl::StatusOr<std::vector<PlannedUnit>> PaperUnits(const std::vector<SweepGrid>& grids) {
  std::vector<PlannedUnit> all;
  std::set<std::string> ids;
  for (const SweepGrid& grid : grids) {
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
    for (const PlannedUnit& unit : units) {
      if (ids.insert(unit.id).second) all.push_back(unit);
    }
  }
  return all;
}

}  // namespace robostress
