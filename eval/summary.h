#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/statistics.h"
#include "eval/run_store.h"

namespace robostress {

// A method against base on the same episodes: equal suite, scenario, severity, policy, seed, task,
// episode.
struct Comparison {
  BootstrapResult difference;  // of success rates, method - base
  int pairs = 0;
  int plus = 0, minus = 0;  // pairs only the method won, pairs only base won
};

// What execution and adaptation did; absent where no episode has the measure.
struct Measures {
  std::optional<double> residual_mean;  // mean over rollouts of ||eta|| / ||a||: the paper's table
  std::optional<double> residual_pooled;  // sqrt(sum ||eta||^2 / sum ||a||^2)
  std::optional<double> tracking_mean;    // as residual_mean, residual_scale tracking
  std::optional<double> intent_mean;      // mean of ||dx - a_base|| / ||a_base||
  std::optional<double> intent_pooled;
  std::optional<double> mean_abs_action, clipped_share;
  std::optional<double> adapter_distance;  // ||phi - phi_0|| at the end, mean over units
};

// One method in one scenario.
struct Cell {
  int n = 0, successes = 0;
  Interval wilson;
  int units = 0;
  bool adapts = false;  // by its configuration
  int updates = 0;      // applied, summed over units
  Measures measures;
  std::optional<Comparison> versus_base;

  double rate() const { return n == 0 ? 0 : static_cast<double>(successes) / n; }
};

struct ScenarioRow {
  std::string scenario, title;
  std::map<std::string, Cell> cells;  // by method
};

// Mean over the scenarios of a table, Clean excluded.
struct AverageCell {
  BootstrapResult success;
  std::optional<Comparison> versus_base;
  bool adapts = false;
  int updates = 0;
  Measures measures;  // means over scenarios
};

// Success of one policy at one severity, over one suite or over all.
struct SuccessTable {
  std::string policy;
  int severity = 5;
  std::string suite;                 // empty: all suites of the run
  std::string title;                 // "Goal", "Spatial, Object" ...
  std::vector<std::string> methods;  // base first
  std::vector<ScenarioRow> rows;
  std::map<std::string, AverageCell> averages;  // empty with Clean alone
};

// Means over units at the i-th episode of a unit, Clean excluded.
struct AdaptationCurve {
  std::string method;
  // [episodes of a unit]; NaN where nothing was measured
  std::vector<double> success, residual, mean_abs_action, clipped_share, adapter_distance;
  int units = 0;
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
};

Summary Summarise(const RunData& run, int bootstrap_replicates);

// "Heavy Payload" for heavy_payload; the name itself when unknown.
std::string ScenarioTitle(const std::string& scenario);
// "Base", "Ours", "Ours, target intent", "Gain control" ...
std::string MethodTitle(const std::string& method);
// Colour of a method, equal in every plot; other names get a neutral one.
std::string MethodColor(const std::string& method);
// A fraction in percentage points without a negative zero.
double PercentagePoints(double fraction);
// "12", "not adapted" (an adapting method without an update), or "-" (a method that does not
// adapt).
std::string UpdatesText(bool adapts, int updates);

}  // namespace robostress
