#include "sim_worker/worker/sim_episode_row.h"

#include "adapter/episode_metrics.h"
#include "adapter/method_options.h"
#include "common/robot_description.h"
#include "common/rollout/motion_smoothness.h"

namespace robostress {
namespace {

EpisodeMetrics MetricsOf(const std::vector<ExecutedChunk>& chunks, const ResidualOptions& options) {
  EpisodeMetrics metrics(options);
  for (const ExecutedChunk& chunk : chunks) metrics.Add(chunk);
  return metrics;
}

}  // namespace

EpisodeRow MakeEpisodeRow(const UnitConfig& resolved, const EpisodeRecord& record,
                          const SessionStats& stats,
                          const std::optional<std::vector<ExecutedChunk>>& in_clean) {
  const ResidualOptions options = ResidualOptionsOf(*resolved.method);
  const EpisodeMetrics metrics = MetricsOf(record.chunks, options);
  EpisodeRow row;
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
  if (resolved.latency.used()) {
    const MotionSmoothness smoothness = SmoothnessOf(record.chunks, kPanda.control_period_s);
    row.jerk = smoothness.jerk;
    row.jump = smoothness.jump;
  }
  if (in_clean) {
    const EpisodeMetrics lag = MetricsOf(*in_clean, options);
    row.lag_residual = lag.residual();
    row.lag_eta_sq = lag.eta_sq();
  }
  return row;
}

TimingRow MakeTimingRow(const EpisodeRecord& record, double wall_s) {
  TimingRow row;
  row.wall_s = wall_s;
  row.predict_s = record.predict_s;
  row.step_s = record.step_s;
  row.observe_s = record.observe_s;
  row.feedback_s = record.feedback_s;
  return row;
}

}  // namespace robostress
