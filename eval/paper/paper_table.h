#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/plan/plan.h"

namespace robostress {

// Whose weights a column of the paper's tables needs.
enum class PolicyRole { kBase, kCloning, kRandomised, kRobust };

struct PaperColumn {
  std::string title;  // as in the paper: "Base", "DR", "w/ anchor"
  PolicyRole role = PolicyRole::kBase;
  std::string method;
  int severity = 5;
  bool control = false;         // ours beside the paper's columns
  std::string scenario, group;  // of tables whose rows are suites: the arm, and its title
};

// Two columns whose difference the table shows.
struct PaperContrast {
  int column = 0, reference = 0;
};

enum class PaperMeasure { kSuccess, kResidual };

// A table of the paper: which units it needs and how they are laid out. Rows are scenarios, or
// suites whose columns name their scenario; published numbers are FindPublished(name).
struct PaperTable {
  std::string name;
  std::vector<std::string> scenarios;
  bool only_average = false;  // one row, the average over the scenarios
  bool with_average = false;  // last row, Clean excluded
  std::vector<PaperColumn> columns;
  std::vector<PaperContrast> contrasts;
  PaperMeasure measure = PaperMeasure::kSuccess;
  // The command of another program that measures it: "fidelity", which has no units, or
  // "piper-study", which trains what its units evaluate.
  std::string program;
  std::vector<std::string> suites, row_keys;  // rows, and what the published table calls them
};

// In the order of the paper; every name of PublishedTables().
const std::vector<PaperTable>& PaperTables();
absl::StatusOr<PaperTable> FindPaperTable(const std::string& name);
// In the order asked for, each once. InvalidArgument names every table that there is not, and those
// that there are.
absl::StatusOr<std::vector<PaperTable>> FindPaperTables(const std::vector<std::string>& names);

// How much is run, and with what. Tables of equal protocol share their units in one run directory.
struct PaperProtocol {
  SweepGrid grid;  // robot, suites, tasks, episodes, seeds, overrides, videos, LIBERO's folders
  std::string base = "nano", cloning = "nano-bc", randomised = "nano-dr", robust = "nano-robust";
  bool papers_rate = false;  // methods that adapt learn at the paper's 1e-6, not at nano's rate

  // Empty when there are no such weights: the column is left out and named.
  const std::string& PolicyOf(PolicyRole role) const;
};

// Minutes on two cores: one embedded suite, two tasks, ten episodes, one seed, films.
PaperProtocol QuickProtocol();
// The paper's: four suites, all tasks, 20 episodes, three seeds.
PaperProtocol FullProtocol();
// The same on LIBERO's suites with the weights at `checkpoint`, at the paper's learning rate unless
// they are nano-libero's; columns of other weights are left out until they are given.
PaperProtocol OnLibero(PaperProtocol protocol, const std::string& checkpoint);

// The grids that hold the table's units, resolved; together they name no unit twice. The
// protocol's episodes are a unit's where the states of its tasks go on (common/suites.h).
absl::StatusOr<std::vector<SweepGrid>> PaperGrids(const PaperTable& table,
                                                  const PaperProtocol& protocol, PolicyHome home);
// Their units, each once.
absl::StatusOr<std::vector<PlannedUnit>> PaperUnits(const std::vector<SweepGrid>& grids);

}  // namespace robostress
