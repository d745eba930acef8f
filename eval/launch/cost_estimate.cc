#include "eval/launch/cost_estimate.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/records/episode_row.h"
#include "common/suites.h"

namespace robostress {
namespace {

// From the most to the least specific.
std::vector<std::string> Keys(const UnitConfig& config) {
  const std::string policy =
      absl::StrCat(PolicyLabel(config.policy), config.method->adapts() ? "\tadapts" : "\t");
  const std::string suite = absl::StrCat(config.suite, "\t", policy);
  return {absl::StrCat(config.scenario, "\t", suite), suite, policy};
}

}  // namespace

CostModel CostModel::FromRun(const RunDirectory& run, const std::vector<PlannedUnit>& units,
                             int sample) {
  CostModel model;
  std::vector<const PlannedUnit*> done;
  const std::unordered_set<std::string> started = run.StartedIds();
  for (const PlannedUnit& unit : units) {
    if (started.count(unit.id) > 0 && run.Done(unit.id)) done.push_back(&unit);
  }
  const size_t stride = std::max<size_t>(1, done.size() / std::max(1, sample));
  for (size_t i = 0; i < done.size(); i += stride) {
    const std::string text = ReadFile(run.Unit(done[i]->id) + "/timing.jsonl").value_or("");
    double wall_s = 0;
    int episodes = 0;
    for (absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
      const std::optional<TimingRow> row = ParseTiming(std::string(line));
      if (!row || !row->wall_s) continue;
      wall_s += *row->wall_s;
      ++episodes;
    }
    model.Add(done[i]->config, episodes, wall_s);
  }
  return model;
}

void CostModel::Add(const UnitConfig& config, int episodes, double wall_s) {
  if (episodes == 0) return;
  recorded_episodes_ += episodes;
  for (const std::string& key : Keys(config)) {
    sums_[key].wall_s += wall_s;
    sums_[key].episodes += episodes;
  }
}

double CostModel::EpisodeSeconds(const UnitConfig& config) const {
  for (const std::string& key : Keys(config)) {
    const auto sum = sums_.find(key);
    if (sum != sums_.end()) return sum->second.wall_s / sum->second.episodes;
  }
  const int horizon = HorizonOf(config);
  const SuiteInfo* suite = FindSuite(config.suite);
  const bool libero = suite != nullptr && suite->needs_libero;
  if (RunsInWorker(config.policy)) return horizon * (libero ? kLiberoExpertStep_s : kExpertStep_s);
  double step_s = kServedStep_s;
  if (libero) {
    step_s =
        config.sim.pictures == SimOptions::kOriginalPictures ? kLiberoStep_s : kLiberoPlainStep_s;
  }
  return horizon * step_s * (config.method->adapts() ? kUpdateFactor : 1);
}

double CostModel::Seconds(const WorkItem& item) const {
  return item.count * EpisodeSeconds(item.unit->config);
}

}  // namespace robostress
