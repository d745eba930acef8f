#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calibration/search/calibration_report.h"
#include "calibration/search/signatures.h"
#include "calibration/search/traced_model.h"

namespace robostress::calibration {

struct TraceOptions {
  int surrogates = 999;
  uint64_t seed = 0;
  int beam = 3;
  int max_effects = 3;
  int finalists = 8;                 // candidates that are refitted in a round
  std::vector<std::string> exclude;  // types that are no candidates
  // Whether to leave a model that nothing improves on for another that does better.
  bool detours = true;
  std::vector<std::string> joints;  // that are traced; empty: all
  // Says what is going on.
  std::function<void(const std::string&)> progress = [](const std::string&) {};
};

// What a forward search over the effect library found for one joint.
struct Trace {
  TracedModel declared, after;               // `after.added`: what matters most comes first
  std::optional<TracedModel> before_detour;  // that nothing improved on
  std::vector<RoundReport> rounds;
  // Of every added effect, those that fit the data as well in its place.
  std::vector<std::vector<std::string>> rivals;
  // Those models; where there are none, what came nearest beside `after`.
  std::vector<TracedModel> alternatives;
  std::vector<std::pair<std::string, double>> not_testable;  // type, surviving share
};

// Forward selection with a beam. A candidate is accepted when its signature explains more of the
// residual than any of the library does by chance (p <= 0.01, null distribution of this round; no
// more is asked where half of the cross-validated error goes), a refit lowers the cross-validated
// error by 2 % and the BIC by 10, most folds gain, and its size agrees over the folds and lies
// within its bounds. Then earlier effects are tested again, and
// every effect against its rivals. Where no single effect is accepted, pairs are tried in the same
// way. `start`: the declared model before it was fitted, `declared`: after.
Trace TraceJoint(const JointProblem& problem, const Hypothesis& start, const Hypothesis& declared,
                 const SignalScales& scales, const std::vector<int>& other_joints, Folds folds,
                 const TraceOptions& options);

}  // namespace robostress::calibration
