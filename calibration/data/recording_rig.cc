#include "calibration/data/recording_rig.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <filesystem>
#include <limits>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/data/piece_writer.h"
#include "common/atomic_file.h"
#include "common/recordings/recording.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kFillIn[] = "FILL_IN";
constexpr int64_t kWait = 500'000'000;  // [ns] that rows wait for commands recorded behind them
constexpr size_t kMostWaiting = 1 << 16;
constexpr int kHeldOutEvery = 3;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Puts beside every row of positions the commands that held at its time. Messages of two topics
// come in the order in which they were recorded, which is not that of their stamps.
class RowMerger : public RecordingVisitor {
 public:
  RowMerger(const RecordingPlan& plan, PieceWriter* writer) : plan_(plan), writer_(writer) {
    for (size_t j = 0; j < plan.joints.size(); ++j) {
      const PlannedJoint& joint = plan.joints[j];
      for (const auto& [signal, place] :
           {std::pair(joint.q, &PlannedRow::q), std::pair(joint.dq, &PlannedRow::dq),
            std::pair(joint.tau, &PlannedRow::tau), std::pair(joint.command, &PlannedRow::command)})
        if (signal >= 0) places_[static_cast<size_t>(signal)].push_back({j, place});
    }
    held_.assign(plan.joints.size(), kNone);
  }

  void OnChannel(size_t, const RecordedChannel&) override {}
  void OnSignal(size_t, const RecordedSignal&) override {}
  void OnNote(const std::string&) override {}
  void OnEpisode(const std::string&) override {
    if (status_.ok()) status_ = Finish();
  }

  absl::Status OnRow(const JointRow& row) override {
    RS_RETURN_IF_ERROR(status_);
    Waiting waiting;
    waiting.row.at_ns = plan_.by_stamp ? row.stamp_ns : row.log_ns;
    // A command without a stamp is known by the recorder's time only, and so compared with that.
    waiting.by_log = !row.stamped || !plan_.by_stamp;
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
    if (positions == plan_.joints.size()) {
      rows_.push_back(std::move(waiting));
    } else if (positions == 0 && commands > 0) {
      commands_.push_back(std::move(waiting));
    }
    newest_ns_ = std::max(newest_ns_, row.log_ns);
    return Emit(newest_ns_ - kWait);
  }

  absl::Status Finish() {
    RS_RETURN_IF_ERROR(Emit(std::numeric_limits<int64_t>::max()));
    commands_.clear();
    newest_ns_ = std::numeric_limits<int64_t>::min() + kWait;
    held_.assign(plan_.joints.size(), kNone);
    return writer_->End();
  }
  int64_t bad_rows() const { return bad_rows_; }

 private:
  struct Waiting {
    PlannedRow row;
    bool by_log = false;
    int64_t log_ns = 0, stamp_ns = 0;
  };

  absl::Status Emit(int64_t until_log_ns) {
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
    while (commands_.size() > kMostWaiting) commands_.pop_front();
    return absl::OkStatus();
  }
  // The commands up to the row's time become those that hold.
  void Hold(const Waiting& row) {
    while (!commands_.empty()) {
      const Waiting& command = commands_.front();
      const bool before =
          command.by_log ? command.log_ns <= row.log_ns : command.stamp_ns <= row.stamp_ns;
      if (!before) return;
      for (size_t j = 0; j < held_.size(); ++j)
        if (!std::isnan(command.row.command[j])) held_[j] = command.row.command[j];
      commands_.pop_front();
    }
  }
  absl::Status Write(PlannedRow row) {
    bool good = true;
    for (size_t j = 0; j < plan_.joints.size(); ++j) {
      const PlannedJoint& joint = plan_.joints[j];
      if (!joint.command_in_row) row.command[j] = held_[j];
      good = good && std::isfinite(row.q[j]) && (joint.dq < 0 || std::isfinite(row.dq[j])) &&
             (joint.tau < 0 || std::isfinite(row.tau[j])) &&
             (joint.command < 0 || std::isfinite(row.command[j]));
    }
    if (good) return writer_->Add(row);
    ++bad_rows_;
    return absl::OkStatus();
  }

  static constexpr size_t kNear = 8;  // rows among which the earliest is looked for
  const RecordingPlan& plan_;
  PieceWriter* const writer_;
  std::map<size_t, std::vector<std::pair<size_t, std::vector<double> PlannedRow::*>>> places_;
  std::deque<Waiting> rows_, commands_;
  std::vector<double> held_;
  int64_t newest_ns_ = std::numeric_limits<int64_t>::min() + kWait;
  int64_t bad_rows_ = 0;
  absl::Status status_;
};

const char* RoleOfPiece(size_t index) {
  return index % kHeldOutEvery == kHeldOutEvery - 1 ? "held_out" : "fit";
}

// A rig without what the recording does not say.
std::string FirstRig(const std::string& recording, const RecordingPlan& plan,
                     const std::string& out, const std::vector<std::string>& logs,
                     std::vector<std::string>* to_fill_in) {
  const bool servo = plan.input == JointInput::kPositionTarget;
  const auto absolute = [](const std::string& path) {
    return std::filesystem::absolute(path).lexically_normal();
  };
  const std::string model =
      plan.model.empty()
          ? absl::StrCat(kFillIn, "  # MJCF or URDF file in which the joints have the names below")
          : absolute(plan.model).lexically_relative(absolute(out)).string();
  std::string text =
      absl::StrCat("# From ", std::filesystem::path(recording).filename().string(),
                   ", by `robostress log inspect`. Replace every ", kFillIn,
                   ": the recording does not say it.\nname: recorded\nmodel: ", model, "\n",
                   absl::StrFormat("rate_hz: %.6g\njoints:\n", plan.rate_hz));
  if (plan.model.empty()) to_fill_in->push_back("model");
  for (const PlannedJoint& joint : plan.joints) {
    absl::StrAppend(
        &text, "  - name: ", joint.name, "\n    input: ",
        servo ? "position_target" : "torque  # tau is the recording's effort: is it Nm?", "\n");
    if (servo) {
      absl::StrAppend(&text, "    servo: {kp: ", kFillIn, ", kd: ", kFillIn,
                      "}  # [Nm/rad], [Nm s/rad]\n");
      to_fill_in->push_back(absl::StrCat(joint.name, ".servo.kp"));
      to_fill_in->push_back(absl::StrCat(joint.name, ".servo.kd"));
    }
    absl::StrAppend(&text, "    fit: [armature, damping, frictionloss]\n");
  }
  text += "logs:\n";
  for (size_t i = 0; i < logs.size(); ++i)
    absl::StrAppend(&text, "  - {file: ", logs[i], ", role: ", RoleOfPiece(i), "}\n");
  return text + "metric: {window_s: 0.5, unit: rad}\n";
}

absl::StatusOr<std::string> FilledRig(Rig rig, const RecordingPlan& plan, const std::string& out,
                                      const std::vector<std::string>& logs) {
  rig.file = (std::filesystem::path(out) / "rig.yaml").string();
  rig.rate_hz = plan.rate_hz;
  std::vector<RigJoint> joints;
  for (const PlannedJoint& planned : plan.joints) {
    const auto found =
        std::find_if(rig.joints.begin(), rig.joints.end(),
                     [&](const RigJoint& joint) { return joint.name == planned.name; });
    if (found == rig.joints.end()) {
      std::vector<std::string> known;
      for (const RigJoint& joint : rig.joints) known.push_back(joint.name);
      return absl::InvalidArgumentError(absl::StrCat("--rig: has no joint '", planned.name,
                                                     "', it has ", absl::StrJoin(known, ", "),
                                                     "; say --joints with those of both"));
    }
    joints.push_back(*found);
    joints.back().input = plan.input;
    joints.back().enable.clear();
  }
  rig.joints = std::move(joints);
  rig.logs.clear();
  for (size_t i = 0; i < logs.size(); ++i) {
    RigLog log;
    log.file = (std::filesystem::path(out) / logs[i]).string();
    log.role = i % kHeldOutEvery == kHeldOutEvery - 1 ? LogRole::kHeldOut : LogRole::kFit;
    rig.logs.push_back(std::move(log));
  }
  return WriteRig(rig);
}

}  // namespace

absl::StatusOr<RecordingRigSummary> WriteRecordingRig(const std::string& recording,
                                                      const RecordingPlan& plan,
                                                      const std::optional<Rig>& declared,
                                                      const std::string& out) {
  // Before the recording is read once more.
  if (declared) RS_RETURN_IF_ERROR(FilledRig(*declared, plan, out, {}).status());
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  std::error_code error;
  if (!std::filesystem::is_empty(out, error))
    return absl::InvalidArgumentError(absl::StrCat(
        "--out ", out, ": holds files already, perhaps a rig that you filled in; name a new one"));
  PieceWriter writer(plan, out);
  RowMerger merger(plan, &writer);
  RS_RETURN_IF_ERROR(ReadRecording(recording, {plan.made_up_rate_hz}, &merger));
  RS_RETURN_IF_ERROR(merger.Finish());
  RecordingRigSummary summary;
  summary.logs = static_cast<int>(writer.files().size());
  summary.seconds = writer.seconds();
  summary.seconds_left_out = writer.seconds_left_out();
  summary.late_rows = writer.late_rows();
  summary.bad_rows = merger.bad_rows();
  if (summary.logs == 0)
    return absl::FailedPreconditionError(absl::StrFormat(
        "%s: no piece of 50 rows is left in which every joint moves (%.1f s in pieces without, "
        "%d rows with a number missing); say --joints with those that move together",
        recording, summary.seconds_left_out, summary.bad_rows));
  std::string text = FirstRig(recording, plan, out, writer.files(), &summary.to_fill_in);
  if (declared) {
    summary.to_fill_in.clear();
    RS_ASSIGN_OR_RETURN(text, FilledRig(*declared, plan, out, writer.files()));
  }
  summary.rig_file = (std::filesystem::path(out) / "rig.yaml").string();
  RS_RETURN_IF_ERROR(WriteFileAtomically(summary.rig_file, text));
  return summary;
}

}  // namespace robostress::calibration
