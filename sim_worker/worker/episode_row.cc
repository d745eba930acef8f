#include "sim_worker/worker/episode_row.h"

#include <optional>

#include "absl/strings/str_format.h"
#include "adapter/episode_metrics.h"
#include "common/joint_errors/scenario_file.h"

namespace robostress {
namespace {

using nlohmann::json;

json OrNull(const std::optional<double>& value) { return value ? json(*value) : json(nullptr); }

EpisodeMetrics MetricsOf(const std::vector<ExecutedChunk>& chunks, const ResidualOptions& options) {
  EpisodeMetrics metrics(options);
  for (const ExecutedChunk& chunk : chunks) metrics.Add(chunk);
  return metrics;
}

}  // namespace

json EpisodeIdentity(const UnitConfig& resolved, const PlannedEpisode& planned) {
  return {{"suite", resolved.suite},
          {"scenario", ScenarioLabel(resolved.scenario)},
          {"severity", resolved.severity},
          {"policy", resolved.policy},
          {"method", resolved.method.method},
          {"seed", resolved.seed},
          {"task", planned.task},
          {"episode", planned.episode},
          {"initial_state", planned.initial_state}};
}

std::string EpisodeLine(const UnitConfig& resolved, const PlannedEpisode& planned,
                        const EpisodeRecord& record, const SessionStats& stats,
                        const std::optional<std::vector<ExecutedChunk>>& in_clean) {
  const ResidualOptions options = ResidualOptionsOf(resolved.method);
  const EpisodeMetrics metrics = MetricsOf(record.chunks, options);
  const bool has_intent = metrics.steps() > 0 && metrics.intent().has_value();
  json row = EpisodeIdentity(resolved, planned);
  row["success"] = record.success;
  row["steps"] = record.steps;
  row["chunks"] = record.chunks.size();
  row["updates"] = stats.updates_applied;
  row["adapter_distance"] = stats.adapter_distance;
  row["residual"] = metrics.residual();
  row["eta_sq"] = metrics.eta_sq();
  row["a_sq"] = metrics.a_sq();
  row["residual_tracking"] = metrics.residual_tracking();
  row["tracking_eta_sq"] = metrics.tracking_eta_sq();
  row["intent"] = has_intent ? OrNull(metrics.intent()) : json(nullptr);
  row["intent_tracking"] = has_intent ? OrNull(metrics.intent_tracking()) : json(nullptr);
  row["intent_eta_sq"] = has_intent ? json(metrics.intent_eta_sq()) : json(nullptr);
  row["intent_tracking_eta_sq"] =
      has_intent ? json(metrics.intent_tracking_eta_sq()) : json(nullptr);
  row["intent_a_sq"] = has_intent ? json(metrics.intent_a_sq()) : json(nullptr);
  row["mean_abs_action"] = metrics.mean_abs_action();
  row["clipped_share"] = metrics.clipped_share();
  if (in_clean) {
    const EpisodeMetrics lag = MetricsOf(*in_clean, options);
    row["lag_residual"] = lag.residual();
    row["lag_eta_sq"] = lag.eta_sq();
  }
  return row.dump();
}

std::string TimingLine(const PlannedEpisode& planned, const EpisodeRecord& record, double wall_s) {
  return json({{"task", planned.task},
               {"episode", planned.episode},
               {"wall_s", wall_s},
               {"predict_s", record.predict_s},
               {"step_s", record.step_s},
               {"observe_s", record.observe_s},
               {"feedback_s", record.feedback_s}})
      .dump();
}

std::string ProgressLine(size_t index, size_t total, const PlannedEpisode& planned,
                         const EpisodeRecord& record, const SessionStats& stats, double wall_s) {
  const EpisodeMetrics metrics = MetricsOf(record.chunks, ResidualOptions{});
  return absl::StrFormat(
      "episode %d/%d  task %d state %d  %s  %d steps  %d updates  residual %.3f  %.2f s", index + 1,
      total, planned.task, planned.initial_state, record.success ? "success" : "failure",
      record.steps, stats.updates_applied, metrics.residual(), wall_s);
}

}  // namespace robostress
