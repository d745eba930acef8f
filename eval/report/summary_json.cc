#include <cmath>

#include "eval/report/report.h"
#include "eval/store/played_alike.h"
#include "eval/store/served_policies.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

json NumberOrNull(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? json(*value) : json(nullptr);
}
json IntervalJson(const Interval& interval) {
  return {NumberOrNull(interval.low), NumberOrNull(interval.high)};
}

json ComparisonJson(const std::optional<Comparison>& c) {
  if (!c) return nullptr;
  return {{"difference", NumberOrNull(c->difference.estimate)},
          {"interval", IntervalJson(c->difference.interval)},
          {"clusters", c->difference.clusters},
          {"clustered_by", ClusterNoun(c->clustering)},
          {"pairs", c->pairs},
          {"plus", c->plus},
          {"minus", c->minus},
          {"p_value", c->p_value},
          {"p_enumerated", c->p_exact},
          {"p_holm", NumberOrNull(c->p_holm)},
          {"mcnemar_p", c->mcnemar_p},
          {"design_effect", c->design_effect}};
}

json BeforeAfterJson(const std::optional<BeforeAfter>& b) {
  if (!b) return nullptr;
  return {{"pairs", b->pairs},
          {"before", b->before},
          {"after", b->after},
          {"change", NumberOrNull(b->change.estimate)},
          {"interval", IntervalJson(b->change.interval)}};
}

json SeedsJson(const SeedSpread& spread) {
  return {{"seeds", spread.seeds},
          {"means", spread.means},
          {"mean", NumberOrNull(spread.mean)},
          {"standard_deviation", NumberOrNull(spread.deviation)}};
}

// Beside versus_base, which stands first.
void AddContrasts(const Contrasts& contrasts, json& cell) {
  cell["versus_base"] = ComparisonJson(contrasts.versus_base);
  for (const auto& [control, comparison] : contrasts.versus_control)
    cell["versus_" + control] = ComparisonJson(comparison);
  if (contrasts.residual) cell["residual_before_after"] = BeforeAfterJson(contrasts.residual);
  if (contrasts.intent) cell["intent_before_after"] = BeforeAfterJson(contrasts.intent);
}

json MeasuresJson(const Measures& m) {
  return {{"residual_mean", NumberOrNull(m.residual_mean)},
          {"residual_pooled", NumberOrNull(m.residual_pooled)},
          {"residual_tracking_mean", NumberOrNull(m.tracking_mean)},
          {"intent_mean", NumberOrNull(m.intent_mean)},
          {"intent_pooled", NumberOrNull(m.intent_pooled)},
          {"mean_abs_action", NumberOrNull(m.mean_abs_action)},
          {"clipped_share", NumberOrNull(m.clipped_share)},
          {"adapter_distance", NumberOrNull(m.adapter_distance)}};
}

json TableJson(const SuccessTable& table) {
  json rows = json::array();
  for (const ScenarioRow& row : table.rows) {
    json cells = json::object();
    for (const auto& [method, cell] : row.cells) {
      cells[method] = {{"n", cell.n},
                       {"successes", cell.successes},
                       {"rate", cell.rate()},
                       {"wilson", IntervalJson(cell.wilson)},
                       {"units", cell.units},
                       {"adapts", cell.adapts},
                       {"updates", cell.updates},
                       {"seeds", SeedsJson(cell.seeds)},
                       {"measures", MeasuresJson(cell.measures)}};
      AddContrasts(cell.contrasts, cells[method]);
    }
    rows.push_back({{"scenario", row.scenario}, {"cells", cells}});
  }
  json averages = json::object();
  for (const auto& [method, average] : table.averages) {
    averages[method] = {{"success", NumberOrNull(average.success.estimate)},
                        {"interval", IntervalJson(average.success.interval)},
                        {"clusters", average.success.clusters},
                        {"clustered_by", ClusterNoun(average.clustering)},
                        {"adapts", average.adapts},
                        {"updates", average.updates},
                        {"n", average.n},
                        {"lacks", average.missing},
                        {"seeds", SeedsJson(average.seeds)},
                        {"measures", MeasuresJson(average.measures)}};
    AddContrasts(average.contrasts, averages[method]);
  }
  return {
      {"policy", table.policy}, {"severity", table.severity},         {"suite", table.suite},
      {"suites", table.title},  {"noise_paired", table.noise_paired}, {"methods", table.methods},
      {"scenarios", rows},      {"average_without_clean", averages}};
}

json ServersJson(const RunData& run) {
  json servers = json::array();
  for (const ServedPolicy& policy : ServedPolicies(run)) {
    servers.push_back({{"policy", policy.label},
                       {"dialect", policy.dialect},
                       {"noise_paired", policy.noise_paired},
                       {"urls", policy.urls},
                       {"metadata_sha256", policy.metadata_sha256},
                       {"reconnections", policy.reconnections},
                       {"units_with_changed_metadata", policy.changed}});
  }
  return servers;
}

}  // namespace

std::string ReportJson(const RunData& run, const Summary& summary) {
  json tables = json::array();
  for (const SuccessTable& table : summary.tables) tables.push_back(TableJson(table));
  const json report = {{"episodes", summary.episodes},
                       {"bootstrap_replicates", summary.replicates},
                       {"tables", tables},
                       {"unfinished_units", run.unfinished},
                       {"unlike_units", UnlikeUnits(run)},
                       {"processors", run.machines},
                       {"servers", ServersJson(run)},
                       {"environment", run.environment},
                       {"sweep_wall_s", run.sweep_wall_s}};
  return report.dump(1) + "\n";
}

}  // namespace robostress
