#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/statistics.h"
#include "eval/plan/titles.h"
#include "eval/statistics/comparison.h"
#include "eval/statistics/measures.h"
#include "eval/statistics/unpaired_rates.h"
#include "eval/store/run_store.h"

namespace robostress {

// A method beside base and beside the controls, on the same episodes.
struct Contrasts {
  std::optional<Comparison> versus_base;
  // In tables over all suites, of adapting methods: against "gain" (every command scaled by one
  // constant) and "null" (other sampling noise), where the run has them.
  std::map<std::string, Comparison> versus_control;
  // There too, against base: after the first update beside unadapted.
  std::optional<BeforeAfter> residual, intent;
};

// One method in one scenario.
struct Cell {
  int n = 0, successes = 0;
  ClusteredRate clustered;  // the same, with what episodes of one initial state share
  // Wilson's; of a policy whose sampling noise is not paired RateInterval(clustered), because its
  // repeats are no independent episodes.
  Interval wilson;
  SeedSpread seeds;
  int units = 0;
  bool adapts = false;       // by its configuration
  bool compensates = false;  // what was executed decides later commands
  int updates = 0;           // applied, summed over units
  Measures measures;
  Contrasts contrasts;

  double rate() const { return n == 0 ? 0 : static_cast<double>(successes) / n; }
};

struct ScenarioRow {
  std::string scenario, title;  // the scenario's label
  bool has_levels = true;
  std::map<std::string, Cell> cells;  // by method
};

// Mean over the scenarios of a table, Clean excluded: over all of them, because means over other
// scenarios do not stand beside each other.
struct AverageCell {
  std::vector<std::string> missing;  // titles of those that the method lacks; then n is 0
  int n = 0;
  BootstrapResult success;
  Clustering clustering = Clustering::kInitialState;  // of its interval
  SeedSpread seeds;
  bool adapts = false, compensates = false;
  int updates = 0;
  Measures measures;  // means over scenarios
  Contrasts contrasts;
};

// Success of one policy at one severity, over one suite or over all. p_holm of a comparison with
// base or with a control is corrected over all comparisons of that kind in the table's scenarios;
// of the averages over the averages' own.
struct SuccessTable {
  std::string policy;
  int severity = 5;
  std::string suite;                 // empty: all suites of the run
  std::string title;                 // "Goal", "Spatial, Object" ...
  std::vector<std::string> methods;  // base first
  bool noise_paired = true;          // pairs share their sampling noise, too
  std::vector<ScenarioRow> rows;
  std::map<std::string, AverageCell> averages;  // empty with Clean alone
};

// Means over units at the i-th episode of a unit, Clean excluded.
struct AdaptationCurve {
  std::string method;
  // [episodes of a unit]; NaN where nothing was measured
  std::vector<double> success, residual, mean_abs_action, clipped_share, adapter_distance;
  int units = 0;
  std::vector<int> episodes;  // [episodes of a unit]: units that have one, n of each point
};

struct CurveSet {
  std::string policy;
  int severity = 5;
  int episodes_per_task = 0;
  std::vector<AdaptationCurve> curves;
};

struct Summary {
  std::vector<SuccessTable>
      tables;  // per policy and severity: all suites first, then each suite if there are several
  std::vector<CurveSet> curves;
  int episodes = 0;
  int replicates = 0;
  bool noise_paired = true;   // pairs share their sampling noise, too
  bool papers_tasks = false;  // every suite is one of LIBERO's four
};

Summary Summarise(const RunData& run, int bootstrap_replicates);

}  // namespace robostress
