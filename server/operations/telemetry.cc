#include "server/operations/telemetry.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

template <class T>
void Push(std::deque<T>& history, T value) {
  history.push_back(std::move(value));
  if (history.size() > Telemetry::kHistory) history.pop_front();
}

void PushDrift(std::deque<Telemetry::DriftPoint>& drift, const Telemetry::DriftPoint& point) {
  if (drift.empty() || drift.back().version != point.version) Push(drift, point);
}

}  // namespace

std::string ResidualAxis(const SessionSpec& spec, int index) {
  static constexpr const char* kAxes[] = {"x", "y", "z", "roll", "pitch", "yaw"};
  if (ActsInJointSpace(spec) || index >= 6) return absl::StrCat("joint_", index + 1);
  return kAxes[index];
}

Telemetry::Telemetry(Metrics* metrics)
    : metrics_(metrics),
      predict_seconds_(metrics->AddHistogram("robostress_predict_seconds",
                                             "From a decoded observation to its actions.",
                                             LatencyBounds())),
      predictions_(
          metrics->AddCounter("robostress_predictions_answered_total", "Predictions answered.")),
      chunks_(metrics->AddCounter("robostress_feedback_chunks_total", "Executed chunks taken.")) {}

Telemetry::Record& Telemetry::Used(const std::string& session) {
  const auto found = records_.find(session);
  if (found == records_.end()) {
    size_t unlisted = 0;
    auto oldest = records_.end();
    for (auto at = records_.begin(); at != records_.end(); ++at) {
      if (at->second.listed) continue;
      ++unlisted;
      if (oldest == records_.end() || at->second.used < oldest->second.used) oldest = at;
    }
    if (unlisted >= kUnlisted) records_.erase(oldest);
  }
  Record& record = records_[session];
  record.used = Clock::now();
  return record;
}

void Telemetry::Adapted(const std::string& session, const DriftPoint& point) {
  absl::MutexLock lock(&mu_);
  PushDrift(Used(session).drift, point);
}

void Telemetry::Forget(const std::string& session, const SessionFigures* last) {
  {
    absl::MutexLock lock(&mu_);
    if (last != nullptr) CountOutcomes(records_[session], *last);
    records_.erase(session);
  }
  metrics_->Remove("session", session);
}

void Telemetry::Predicted(const std::string& session,
                          const std::shared_ptr<const Observation>& observation, double seconds) {
  predict_seconds_->Observe(seconds);
  predictions_->Increment();
  const Clock::time_point now = Clock::now();
  bool wants_images = false;
  {
    absl::MutexLock lock(&mu_);
    Record& record = Used(session);
    Push(record.latencies_s, seconds);
    wants_images = !observation->views.empty() &&
                   (record.image_count == 0 || now - record.image_time >= kImagePeriod);
  }
  if (!wants_images) return;
  std::map<std::string, std::shared_ptr<const Image>> images;
  for (const CameraView& view : observation->views)
    images[view.camera] = std::shared_ptr<const Image>(observation, &view.image);
  absl::MutexLock lock(&mu_);
  Record& record = Used(session);
  record.images = std::move(images);
  record.image_time = now;
  ++record.image_count;
}

void Telemetry::Reported(const std::string& session, const SessionSpec& spec, uint64_t sequence,
                         const Eigen::MatrixXd& residual) {
  chunks_->Increment();
  if (residual.rows() == 0 || residual.cols() < 2) return;
  ResidualPoint point;
  point.sequence = sequence;
  point.mean_abs =
      residual.leftCols(residual.cols() - 1).cwiseAbs().colwise().mean().transpose();  // no gripper
  for (int i = 0; i < point.mean_abs.size(); ++i) {
    metrics_
        ->AddHistogram("robostress_residual",
                       "Mean |achieved - commanded| of an executed chunk, normalised (joint space: "
                       "rad).",
                       ResidualBounds(), {{"axis", ResidualAxis(spec, i)}})
        ->Observe(point.mean_abs[i]);
  }
  absl::MutexLock lock(&mu_);
  Push(Used(session).residuals, std::move(point));
}

void Telemetry::CountOutcomes(const Record& record, const SessionFigures& now) {
  struct Outcome {
    const char* name;
    uint64_t SessionFigures::*count;
  };
  static constexpr Outcome kOutcomes[] = {{"applied", &SessionFigures::updates_applied},
                                          {"refused", &SessionFigures::updates_refused},
                                          {"guarded", &SessionFigures::updates_guarded}};
  const auto count = [&](uint64_t SessionFigures::*field, const std::string& name,
                         const std::string& help, const MetricLabels& labels) {
    // A session that a rollback put back has fewer than before: what it applied stays counted.
    const uint64_t before = record.figures.*field;
    const auto counter = metrics_->AddCounter(name, help, labels);
    if (now.*field > before) counter->Increment(static_cast<double>(now.*field - before));
  };
  for (const Outcome& outcome : kOutcomes) {
    count(
        outcome.count, "robostress_updates_total",
        "Updates by outcome: applied; refused, not finite; guarded, worse than what was published.",
        {{"outcome", outcome.name}});
  }
  count(&SessionFigures::duplicates, "robostress_feedback_duplicates_total",
        "Chunks that were in already.", {});
  count(&SessionFigures::rollbacks, "robostress_rollbacks_total", "Adapters rolled back.", {});
  count(&SessionFigures::snapshots_failed, "robostress_snapshots_failed_total",
        "Snapshots of sessions that could not be written; their journals go on.", {});
  count(&SessionFigures::predictions_unkept, "robostress_predictions_unkept_total",
        "Predictions that could not be written to the journal, e.g. because the disk was full.",
        {});
  count(&SessionFigures::steps_impossible, "robostress_steps_impossible_total",
        "Control steps that count as not measured, since no robot can show what was reported.", {});
}

void Telemetry::Refresh(const std::vector<SessionFigures>& sessions) {
  double open = 0, stored = 0, failed = 0, journal_bytes = 0;
  std::vector<std::string> gone;
  {
    absl::MutexLock lock(&mu_);
    for (auto& [id, record] : records_) record.listed = false;
    for (const SessionFigures& now : sessions) {
      ++(!now.error.empty() ? failed : now.open ? open : stored);
      journal_bytes += static_cast<double>(now.journal_bytes);
      Record& record = records_[now.id];
      CountOutcomes(record, now);
      const MetricLabels labels = {{"session", now.id}};
      metrics_->AddGauge("robostress_adapter_distance", "||phi - phi_0||_2.", labels)
          ->Set(now.adapter_distance);
      metrics_->AddGauge("robostress_adapter_version", "Updates applied.", labels)
          ->Set(static_cast<double>(now.updates_applied));
      metrics_->AddGauge("robostress_update_loss", "Of the last update.", labels)
          ->Set(now.last_loss);
      metrics_->AddGauge("robostress_buffered_chunks", "In the feedback buffer.", labels)
          ->Set(now.buffered_chunks);
      if (!record.residuals.empty()) {
        const Eigen::VectorXd& last = record.residuals.back().mean_abs;
        for (int i = 0; i < last.size(); ++i) {
          metrics_
              ->AddGauge("robostress_session_residual", "Of the last executed chunk.",
                         {{"session", now.id}, {"axis", ResidualAxis(now.spec, i)}})
              ->Set(last[i]);
        }
      }
      PushDrift(record.drift, {now.updates_applied, now.adapter_distance, now.last_loss});
      record.figures = now;
      record.listed = true;
    }
    std::erase_if(records_, [&gone](const auto& entry) {
      if (!entry.second.listed) gone.push_back(entry.first);
      return !entry.second.listed;
    });
  }
  for (const std::string& id : gone) metrics_->Remove("session", id);
  for (const auto& [state, count] :
       {std::pair("open", open), {"stored", stored}, {"failed", failed}}) {
    metrics_
        ->AddGauge("robostress_sessions",
                   "Sessions: open, in memory; stored, on disk alone; failed, set aside until "
                   "somebody looks.",
                   {{"state", state}})
        ->Set(count);
  }
  metrics_
      ->AddGauge("robostress_journal_bytes",
                 "Journals of open sessions, all together, since their last snapshots.")
      ->Set(journal_bytes);
}

std::vector<Telemetry::View> Telemetry::Views() const {
  std::vector<View> views;
  absl::MutexLock lock(&mu_);
  for (const auto& [id, record] : records_) {
    if (!record.listed) continue;
    View view;
    view.figures = record.figures;
    view.residuals.assign(record.residuals.begin(), record.residuals.end());
    view.drift.assign(record.drift.begin(), record.drift.end());
    view.latencies_s.assign(record.latencies_s.begin(), record.latencies_s.end());
    for (const auto& [camera, image] : record.images) view.cameras.push_back(camera);
    view.image_count = record.image_count;
    views.push_back(std::move(view));
  }
  return views;
}

std::shared_ptr<const Image> Telemetry::LastImage(const std::string& session,
                                                  const std::string& camera) const {
  absl::MutexLock lock(&mu_);
  const auto record = records_.find(session);
  if (record == records_.end()) return nullptr;
  const auto image = record->second.images.find(camera);
  return image == record->second.images.end() ? nullptr : image->second;
}

}  // namespace robostress
