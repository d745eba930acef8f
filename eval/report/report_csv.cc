#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "eval/report/report.h"
#include "eval/report/text_table.h"

namespace robostress {
namespace {

std::string CsvNumber(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? absl::StrFormat("%.6g", *value) : "";
}

std::vector<std::string> ComparisonCells(const std::optional<Comparison>& c) {
  if (!c) return {"", "", "", "", "", "", ""};
  return {CsvNumber(c->difference.estimate),
          CsvNumber(c->difference.interval.low),
          CsvNumber(c->difference.interval.high),
          absl::StrCat(c->plus),
          absl::StrCat(c->minus),
          absl::StrCat(c->pairs),
          absl::StrCat(c->difference.clusters)};
}

std::vector<std::string> MeasureCells(const Measures& m) {
  return {CsvNumber(m.residual_mean), CsvNumber(m.residual_pooled), CsvNumber(m.tracking_mean),
          CsvNumber(m.intent_mean),   CsvNumber(m.intent_pooled),   CsvNumber(m.mean_abs_action),
          CsvNumber(m.clipped_share), CsvNumber(m.adapter_distance)};
}

// p values, the controls, seeds and before / after, which stand behind the older columns.
std::vector<std::string> ContrastCells(const Contrasts& contrasts, const SeedSpread& seeds) {
  std::vector<std::string> cells = {"", "", ""};
  if (const auto& base = contrasts.versus_base)
    cells = {CsvNumber(base->p_value), CsvNumber(base->p_holm), CsvNumber(base->mcnemar_p)};
  for (const std::string control : {"gain", "null"}) {
    const auto found = contrasts.versus_control.find(control);
    if (found == contrasts.versus_control.end()) {
      cells.insert(cells.end(), {"", "", "", ""});
      continue;
    }
    const Comparison& c = found->second;
    for (const double value :
         {c.difference.estimate, c.difference.interval.low, c.difference.interval.high, c.p_holm})
      cells.push_back(CsvNumber(value));
  }
  for (const auto& change : {contrasts.residual, contrasts.intent}) {
    cells.push_back(change ? CsvNumber(change->before) : "");
    cells.push_back(change ? CsvNumber(change->after) : "");
  }
  cells.push_back(absl::StrCat(seeds.seeds.size()));
  cells.push_back(CsvNumber(seeds.deviation));
  return cells;
}

void AppendCells(std::string& csv, std::vector<std::string> cells, const Contrasts& contrasts,
                 const Measures& measures, const SeedSpread& seeds, bool noise_paired) {
  for (const std::vector<std::string>& more :
       {ComparisonCells(contrasts.versus_base), MeasureCells(measures),
        ContrastCells(contrasts, seeds)})
    cells.insert(cells.end(), more.begin(), more.end());
  cells.push_back(noise_paired ? "1" : "0");
  const auto& base = contrasts.versus_base;
  cells.push_back(base ? ClusterNoun(base->clustering) : "");
  csv += CsvTable({cells});
}

}  // namespace

std::string TableCsv(const Summary& summary) {
  std::string csv =
      "policy,severity,suite,scenario,method,n,successes,rate,low,high,adapts,updates,difference,"
      "difference_low,difference_high,plus,minus,"
      "pairs,clusters,residual_mean,residual_pooled,residual_tracking_mean,intent_mean,intent_"
      "pooled,mean_abs_action,clipped_share,"
      "adapter_distance,p_value,p_holm,mcnemar_p,versus_gain,versus_gain_low,versus_gain_high,"
      "versus_gain_p_holm,versus_null,versus_null_low,versus_null_high,versus_null_p_holm,"
      "residual_before,residual_after,intent_before,intent_after,seeds,seed_deviation,noise_"
      "paired,clustered_by\n";
  for (const SuccessTable& table : summary.tables) {
    const std::string suite = table.suite.empty() ? "all" : table.suite;
    const auto lead = [&](const std::string& scenario, const std::string& method) {
      return std::vector<std::string>{table.policy, absl::StrCat(table.severity), suite, scenario,
                                      method};
    };
    for (const ScenarioRow& row : table.rows) {
      for (const std::string& method : table.methods) {
        const auto found = row.cells.find(method);
        if (found == row.cells.end()) continue;
        const Cell& cell = found->second;
        std::vector<std::string> cells = lead(row.scenario, method);
        for (const std::string& value :
             {absl::StrCat(cell.n), absl::StrCat(cell.successes), CsvNumber(cell.rate()),
              CsvNumber(cell.wilson.low), CsvNumber(cell.wilson.high),
              absl::StrCat(cell.adapts ? 1 : 0), absl::StrCat(cell.updates)}) {
          cells.push_back(value);
        }
        AppendCells(csv, cells, cell.contrasts, cell.measures, cell.seeds, table.noise_paired);
      }
    }
    for (const std::string& method : table.methods) {
      const auto found = table.averages.find(method);
      if (found == table.averages.end()) continue;
      const AverageCell& average = found->second;
      std::vector<std::string> cells = lead("average_without_clean", method);
      for (const std::string& value :
           {std::string(), std::string(), CsvNumber(average.success.estimate),
            CsvNumber(average.success.interval.low), CsvNumber(average.success.interval.high),
            absl::StrCat(average.adapts ? 1 : 0), absl::StrCat(average.updates)}) {
        cells.push_back(value);
      }
      AppendCells(csv, cells, average.contrasts, average.measures, average.seeds,
                  table.noise_paired);
    }
  }
  return csv;
}

}  // namespace robostress
