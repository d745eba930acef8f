#include "calibration/data/row_merger.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int64_t kWait = 500'000'000;  // [ns] that rows wait for commands recorded behind them
constexpr int64_t kClockSet = 1'000'000'000;  // [ns]
constexpr size_t kMostWaiting = 1 << 16;
constexpr size_t kNear = 8;  // rows among which the earliest is looked for
constexpr int64_t kEver = std::numeric_limits<int64_t>::max();
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

}  // namespace

RowMerger::RowMerger(const RecordingPlan& plan, PieceWriter* writer)
    : plan_(plan), writer_(writer), gap_ns_(static_cast<int64_t>(kGapRows * plan.dt * 1e9)) {
  for (size_t j = 0; j < plan.joints.size(); ++j) {
    const PlannedJoint& joint = plan.joints[j];
    for (const auto& [signal, place] :
         {std::pair(joint.q, &PlannedRow::q), std::pair(joint.dq, &PlannedRow::dq),
          std::pair(joint.tau, &PlannedRow::tau), std::pair(joint.command, &PlannedRow::command)})
      if (signal >= 0) places_[static_cast<size_t>(signal)].push_back({j, place});
  }
  held_.assign(plan.joints.size(), kNone);
}

void RowMerger::OnEpisode(const std::string&) {
  if (status_.ok()) status_ = Finish();
}

absl::Status RowMerger::Finish() {
  if (doubted_) ++wrong_stamps_;
  RS_RETURN_IF_ERROR(Settle(kEver, true));
  doubted_.reset();
  last_at_.reset();
  last_log_.reset();
  ahead_of_log_.reset();
  newest_ns_.reset();
  return writer_->End();
}

bool RowMerger::IsOfAnotherClock(const JointRow& row) const {
  if (!row.stamped || !plan_.by_stamp || !ahead_of_log_ || plan_.by_recorder.count(row.channel) > 0)
    return true;
  return std::abs(row.stamp_ns - row.log_ns - *ahead_of_log_) > kClockSet;
}

absl::Status RowMerger::OnRow(const JointRow& row) {
  RS_RETURN_IF_ERROR(status_);
  Waiting waiting;
  waiting.row.at_ns = plan_.by_stamp ? row.stamp_ns : row.log_ns;
  waiting.log_ns = row.log_ns;
  waiting.stamp_ns = row.stamp_ns;
  size_t positions = 0, commands = 0;
  for (auto place : {&PlannedRow::q, &PlannedRow::dq, &PlannedRow::tau, &PlannedRow::command})
    (waiting.row.*place).assign(plan_.joints.size(), kNone);
  for (const SignalValue& value : row.values) {
    const auto found = places_.find(value.signal);
    if (found == places_.end()) continue;
    for (const auto& [joint, place] : found->second) {
      (waiting.row.*place)[joint] = value.value;
      positions += place == &PlannedRow::q;
      commands += place == &PlannedRow::command;
    }
  }
  if (newest_ns_ && row.log_ns < *newest_ns_ - kClockSet) {  // the recorder's clock was set back
    RS_RETURN_IF_ERROR(Settle(kEver, false));
    newest_ns_.reset();
  }
  newest_ns_ = std::max(newest_ns_.value_or(row.log_ns), row.log_ns);
  if (positions == plan_.joints.size()) {
    if (plan_.by_stamp && !row.stamped)
      ++bad_rows_;
    else
      RS_RETURN_IF_ERROR(TakePositions(std::move(waiting)));
  } else if (positions == 0 && commands > 0) {
    waiting.by_log = IsOfAnotherClock(row);
    commands_.push_back(std::move(waiting));
  }
  return Emit(*newest_ns_ - kWait);
}

absl::Status RowMerger::TakePositions(Waiting row) {
  const auto near = [&](int64_t at_ns) { return std::abs(row.row.at_ns - at_ns) <= gap_ns_; };
  if (!last_at_ || near(*last_at_)) {
    wrong_stamps_ += doubted_.has_value();
    doubted_.reset();
    return Accept(std::move(row));
  }
  if (!doubted_ || !near(doubted_->row.at_ns)) {
    wrong_stamps_ += doubted_.has_value();
    doubted_ = std::move(row);
    return absl::OkStatus();
  }
  Waiting first = std::move(*doubted_);
  doubted_.reset();
  const int64_t step = first.row.at_ns - *last_at_;
  if (step < 0 || std::abs(step - (first.log_ns - *last_log_)) > kClockSet)
    RS_RETURN_IF_ERROR(Settle(first.log_ns, step < 0));
  RS_RETURN_IF_ERROR(Accept(std::move(first)));
  return Accept(std::move(row));
}

absl::Status RowMerger::Accept(Waiting row) {
  last_at_ = row.row.at_ns;
  last_log_ = row.log_ns;
  ahead_of_log_ = row.stamp_ns - row.log_ns;
  rows_.push_back(std::move(row));
  return absl::OkStatus();
}

absl::Status RowMerger::Settle(int64_t until_log_ns, bool back) {
  RS_RETURN_IF_ERROR(Emit(kEver));
  while (!commands_.empty() && commands_.front().log_ns <= until_log_ns) TakeFirstCommand();
  if (back) held_.assign(plan_.joints.size(), kNone);
  return absl::OkStatus();
}

absl::Status RowMerger::Emit(int64_t until_log_ns) {
  while (!rows_.empty() && (rows_.front().log_ns <= until_log_ns || rows_.size() > kMostWaiting ||
                            commands_.size() > kMostWaiting)) {
    const auto next = std::min_element(
        rows_.begin(),
        rows_.begin() + static_cast<std::ptrdiff_t>(std::min<size_t>(rows_.size(), kNear)),
        [](const Waiting& a, const Waiting& b) { return a.row.at_ns < b.row.at_ns; });
    Waiting row = std::move(*next);
    rows_.erase(next);
    Hold(row);
    RS_RETURN_IF_ERROR(Write(std::move(row.row)));
  }
  while (commands_.size() > kMostWaiting) TakeFirstCommand();
  return absl::OkStatus();
}

void RowMerger::Hold(const Waiting& row) {
  while (!commands_.empty()) {
    const Waiting& command = commands_.front();
    if (command.by_log ? command.log_ns > row.log_ns : command.stamp_ns > row.stamp_ns) return;
    TakeFirstCommand();
  }
}

void RowMerger::TakeFirstCommand() {
  const std::vector<double>& command = commands_.front().row.command;
  for (size_t j = 0; j < held_.size(); ++j)
    if (!std::isnan(command[j])) held_[j] = command[j];
  commands_.pop_front();
}

absl::Status RowMerger::Write(PlannedRow row) {
  bool good = true, commanded = true;
  for (size_t j = 0; j < plan_.joints.size(); ++j) {
    const PlannedJoint& joint = plan_.joints[j];
    if (!joint.command_in_row) row.command[j] = held_[j];
    good = good && std::isfinite(row.q[j]) && (joint.dq < 0 || std::isfinite(row.dq[j])) &&
           (joint.tau < 0 || std::isfinite(row.tau[j]));
    commanded = commanded && (joint.command < 0 || std::isfinite(row.command[j]));
  }
  if (good && commanded) return writer_->Add(row);
  ++(good ? rows_without_command_ : bad_rows_);
  return absl::OkStatus();
}

}  // namespace robostress::calibration
