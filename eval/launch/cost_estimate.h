#pragma once

#include <map>
#include <string>
#include <vector>

#include "eval/plan/plan.h"
#include "eval/store/run_directory.h"
#include "eval/store/work_list.h"

namespace robostress {

// How long an episode takes [s of one worker, its share of the server's time included], from what
// was recorded (timing.jsonl of finished units) and, where nothing comparable was, from stated
// defaults: policies in the worker kExpertStep_s, served ones kServedStep_s per control step of the
// suite's horizon, times kUpdateFactor where a method adapts. They are orders of magnitude of one
// core and `nano`; LIBERO's are docs/results/libero-pictures.md's and libero-experts.md's, mean of
// four suites.
class CostModel {
 public:
  static constexpr double kExpertStep_s = 0.0012;
  static constexpr double kServedStep_s = 0.006;
  static constexpr double kLiberoStep_s = 0.030, kLiberoPlainStep_s = 0.008,
                          kLiberoExpertStep_s = 0.003;
  static constexpr double kUpdateFactor = 1.4;

  // Reads the finished units of `run`, at most `sample` of them, evenly spread.
  static CostModel FromRun(const RunDirectory& run, const std::vector<PlannedUnit>& units,
                           int sample = 200);
  // Adds what one unit took: `wall_s` over `episodes`.
  void Add(const UnitConfig& config, int episodes, double wall_s);
  // Mean of units with equal suite, scenario, policy and adaptation; else of those with equal
  // suite, policy and adaptation; else policy and adaptation; else the default.
  double EpisodeSeconds(const UnitConfig& config) const;
  double Seconds(const WorkItem& item) const;
  int recorded_episodes() const { return recorded_episodes_; }

 private:
  struct Sum {
    double wall_s = 0;
    int episodes = 0;
  };
  std::map<std::string, Sum> sums_;
  int recorded_episodes_ = 0;
};

}  // namespace robostress
