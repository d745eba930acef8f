#include "sim_worker/worker/episode_row.h"

#include "absl/strings/str_format.h"
#include "adapter/episode_metrics.h"
#include "common/joint_errors/scenario_file.h"

namespace robostress {
namespace {

EpisodeMetrics MetricsOf(const std::vector<ExecutedChunk>& chunks, const ResidualOptions& options) {
  EpisodeMetrics metrics(options);
  for (const ExecutedChunk& chunk : chunks) metrics.Add(chunk);
  return metrics;
}

}  // namespace

EpisodeIdentity IdentityOf(const UnitConfig& resolved, const PlannedEpisode& planned) {
  return {.suite = resolved.suite,
          .scenario = ScenarioLabel(resolved.scenario),
          .policy = resolved.policy,
          .method = resolved.method.method,
          .severity = resolved.severity,
          .seed = resolved.seed,
          .task = planned.task,
          .episode = planned.episode,
          .initial_state = planned.initial_state};
}

EpisodeRow MakeEpisodeRow(const UnitConfig& resolved, const PlannedEpisode& planned,
                          const EpisodeRecord& record, const SessionStats& stats,
                          const std::optional<std::vector<ExecutedChunk>>& in_clean) {
  const ResidualOptions options = ResidualOptionsOf(resolved.method);
  const EpisodeMetrics metrics = MetricsOf(record.chunks, options);
  EpisodeRow row;
  row.task = planned.task;
  row.episode = planned.episode;
  row.initial_state = planned.initial_state;
  row.success = record.success;
  row.steps = record.steps;
  row.chunks = static_cast<int>(record.chunks.size());
  row.updates = static_cast<int>(stats.updates_applied);
  row.adapter_distance = stats.adapter_distance;
  row.residual = metrics.residual();
  row.eta_sq = metrics.eta_sq();
  row.a_sq = metrics.a_sq();
  row.residual_tracking = metrics.residual_tracking();
  row.tracking_eta_sq = metrics.tracking_eta_sq();
  if (metrics.steps() > 0 && metrics.intent()) {
    row.intent = metrics.intent();
    row.intent_tracking = metrics.intent_tracking();
    row.intent_eta_sq = metrics.intent_eta_sq();
    row.intent_tracking_eta_sq = metrics.intent_tracking_eta_sq();
    row.intent_a_sq = metrics.intent_a_sq();
  }
  row.mean_abs_action = metrics.mean_abs_action();
  row.clipped_share = metrics.clipped_share();
  if (in_clean) {
    const EpisodeMetrics lag = MetricsOf(*in_clean, options);
    row.lag_residual = lag.residual();
    row.lag_eta_sq = lag.eta_sq();
  }
  return row;
}

TimingRow MakeTimingRow(const PlannedEpisode& planned, const EpisodeRecord& record, double wall_s) {
  return {planned.task,  planned.episode,  wall_s,           record.predict_s,
          record.step_s, record.observe_s, record.feedback_s};
}

std::string ProgressLine(size_t index, size_t total, const EpisodeRow& row, double wall_s) {
  return absl::StrFormat(
      "episode %d/%d  task %d state %d  %s  %d steps  %d updates  residual %.3f  %.2f s", index + 1,
      total, row.task, row.initial_state, row.success ? "success" : "failure", row.steps,
      row.updates, row.residual.value_or(0), wall_s);
}

}  // namespace robostress
