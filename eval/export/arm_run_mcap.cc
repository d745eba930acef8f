#include "eval/export/arm_run_mcap.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/csv_table.h"
#include "common/recordings/cdr_encoder.h"
#include "common/recordings/joint_messages.h"
#include "common/recordings/mcap_writer.h"
#include "common/status_macros.h"
#include "eval/export/mcap_topics.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMostBytes = uint64_t{4} << 30;
constexpr uint64_t kMostPictureBytes = uint64_t{256} << 20;
constexpr int64_t kSecond = 1'000'000'000;  // [ns]
// The axes of the arm, J1 .. and its gripper, as the table's columns q_J1 .. name them.
std::vector<std::string> AxisNames(const CsvTable& table) {
  std::vector<std::string> names;
  for (const std::string& column : table.names()) {
    absl::string_view axis = column;
    if (absl::ConsumePrefix(&axis, "q_")) names.emplace_back(axis);
  }
  return names;
}
// Columns of ticks.csv, and their topics.
constexpr std::pair<const char*, const char*> kGroups[] = {
    {"policy", "policy"},       {"requested", "requested"}, {"blended", "blended"},
    {"corrected", "corrected"}, {"sent", "sent"},           {"q", "measured"},
    {"excess", "torque_excess"}};

// The table, or what there is of one that was cut off; empty: there is neither.
std::string TableFile(const std::string& folder, const std::string& name) {
  const std::string whole = absl::StrCat(folder, "/", name);
  if (fs::exists(whole)) return whole;
  return fs::exists(whole + ".partial") ? whole + ".partial" : "";
}

// A table that need not be there, or hold a row: of a run that was cut off early.
absl::StatusOr<std::optional<CsvTable>> ReadTable(const std::string& folder,
                                                  const std::string& name) {
  const std::string path = TableFile(folder, name);
  if (path.empty()) return std::nullopt;
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostBytes));
  if (std::count(text.begin(), text.end(), '\n') < 2) return std::nullopt;
  RS_ASSIGN_OR_RETURN(CsvTable table, CsvTable::Read(path, kMostBytes));
  return table;
}

// A column for every axis.
struct AxisColumns {
  std::vector<size_t> columns;
  static absl::StatusOr<AxisColumns> Find(const CsvTable& table, const std::string& group,
                                          const std::vector<std::string>& axes) {
    AxisColumns found;
    for (const std::string& axis : axes) {
      RS_ASSIGN_OR_RETURN(const size_t column, table.Column(absl::StrCat(group, "_", axis)));
      found.columns.push_back(column);
    }
    return found;
  }
  bool Empty(const CsvTable& table, size_t row) const {
    return std::all_of(columns.begin(), columns.end(),
                       [&](size_t column) { return table.Text(row, column).empty(); });
  }
  absl::StatusOr<std::vector<double>> At(const CsvTable& table, size_t row) const {
    std::vector<double> values;
    for (const size_t column : columns) {
      RS_ASSIGN_OR_RETURN(const double value, table.Number(row, column));
      values.push_back(value);
    }
    return values;
  }
};

// The columns that /joint_states is made of.
struct StateColumns {
  AxisColumns position, velocity, effort;
  static absl::StatusOr<StateColumns> Find(const CsvTable& table,
                                           const std::vector<std::string>& axes) {
    StateColumns found;
    RS_ASSIGN_OR_RETURN(found.position, AxisColumns::Find(table, "q", axes));
    RS_ASSIGN_OR_RETURN(found.velocity, AxisColumns::Find(table, "dq", axes));
    RS_ASSIGN_OR_RETURN(found.effort, AxisColumns::Find(table, "tau", axes));
    return found;
  }
};

class ArmRun {
 public:
  absl::Status Open(const std::string& folder) {
    folder_ = folder;
    RS_ASSIGN_OR_RETURN(ticks_, CsvTable::Read(TableFile(folder, "ticks.csv"), kMostBytes));
    RS_ASSIGN_OR_RETURN(samples_, ReadTable(folder, "samples.csv"));
    RS_RETURN_IF_ERROR(ReadPictures());
    RS_ASSIGN_OR_RETURN(tick_times_, ticks_->Numbers("t"));
    if (samples_) {
      RS_ASSIGN_OR_RETURN(sample_times_, samples_->Numbers("t"));
    }
    axes_ = AxisNames(*ticks_);
    if (axes_.empty())
      return absl::InvalidArgumentError(absl::StrCat(
          folder, "/ticks.csv: has no columns q_J1 ..; is this a run of robot_client?"));
    double first = tick_times_.front();
    if (!sample_times_.empty()) first = std::min(first, sample_times_.front());
    for (const ShownPicture& picture : pictures_) first = std::min(first, picture.stamp);
    shift_ = 1 - first;
    for (const auto& [group, topic] : kGroups) {
      RS_ASSIGN_OR_RETURN(AxisColumns columns, AxisColumns::Find(*ticks_, group, axes_));
      groups_.push_back(std::move(columns));
    }
    RS_ASSIGN_OR_RETURN(states_, StateColumns::Find(samples_ ? *samples_ : *ticks_, axes_));
    for (const char* name : {"state", "cause", "episode", "chunk", "row", "wake_us", "delay"}) {
      RS_ASSIGN_OR_RETURN(const size_t column, ticks_->Column(name));
      client_.push_back(column);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<ArmRunSummary> Write(McapWriter* file) {
    McapTopics topics(file);
    for (const ShownPicture& picture : pictures_) {
      if (cameras_.count(picture.camera) == 0)
        cameras_[picture.camera] =
            topics.Add(absl::StrCat("/camera/", picture.camera), CompressedImageSchema());
    }
    std::vector<std::string> fields;
    for (const std::string& axis : axes_) fields.push_back(absl::AsciiStrToLower(axis));
    const uint16_t joint_states =
        topics.Add("/joint_states", {"sensor_msgs/msg/JointState", "ros2msg",
                                     KnownDefinitions(JointMessageKind::kJointState)[0]});
    std::vector<uint16_t> joints;
    for (const auto& [group, topic] : kGroups)
      joints.push_back(
          topics.Add(absl::StrCat("/joints/", topic), NumbersSchema("Joints", fields)));
    const uint16_t client = topics.Add(
        "/client", StampedSchema("robostress_msgs/msg/Client",
                                 "string state\nstring cause\nfloat64 episode\nfloat64 chunk\n"
                                 "float64 row\nfloat64 lateness_us\nfloat64 delay_s\n"));
    ArmRunSummary summary;
    size_t sample = 0, picture = 0;
    for (size_t tick = 0; tick < tick_times_.size(); ++tick) {
      for (; sample < sample_times_.size() && sample_times_[sample] <= tick_times_[tick]; ++sample)
        RS_RETURN_IF_ERROR(WriteState(*samples_, sample, sample_times_, joint_states, file));
      for (; picture < pictures_.size() && pictures_[picture].t <= tick_times_[tick]; ++picture)
        RS_RETURN_IF_ERROR(WritePicture(pictures_[picture], file, summary));
      if (!samples_ && !states_.position.Empty(*ticks_, tick))
        RS_RETURN_IF_ERROR(WriteState(*ticks_, tick, tick_times_, joint_states, file));
      for (size_t g = 0; g < groups_.size(); ++g) {
        if (groups_[g].Empty(*ticks_, tick)) continue;
        RS_ASSIGN_OR_RETURN(const std::vector<double> values, groups_[g].At(*ticks_, tick));
        CdrEncoder message = Begin(tick_times_[tick]);
        for (const double value : values) message.Number(value);
        RS_RETURN_IF_ERROR(Send(joints[g], tick_times_[tick], message, file));
      }
      RS_RETURN_IF_ERROR(WriteClient(tick, client, file));
      ++summary.ticks;
    }
    for (; sample < sample_times_.size(); ++sample)
      RS_RETURN_IF_ERROR(WriteState(*samples_, sample, sample_times_, joint_states, file));
    for (; picture < pictures_.size(); ++picture)
      RS_RETURN_IF_ERROR(WritePicture(pictures_[picture], file, summary));
    summary.samples = static_cast<int64_t>(sample_times_.size());
    return summary;
  }

 private:
  struct ShownPicture {
    double t = 0, stamp = 0;  // [s] of the run's clock: when it was shown, when it was taken
    std::string camera, file;
  };

  // The rows of frames.csv whose picture was kept; a client before 0.2 kept none.
  absl::Status ReadPictures() {
    RS_ASSIGN_OR_RETURN(const std::optional<CsvTable> frames, ReadTable(folder_, "frames.csv"));
    if (!frames || !frames->Has("picture")) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const size_t t, frames->Column("t"));
    RS_ASSIGN_OR_RETURN(const size_t stamp, frames->Column("stamp"));
    RS_ASSIGN_OR_RETURN(const size_t camera, frames->Column("camera"));
    RS_ASSIGN_OR_RETURN(const size_t file, frames->Column("picture"));
    for (size_t row = 0; row < frames->rows(); ++row) {
      ShownPicture picture;
      picture.file = std::string(frames->Text(row, file));
      if (picture.file.empty()) continue;
      if (!absl::StartsWith(picture.file, "pictures/") || absl::StrContains(picture.file, ".."))
        return absl::InvalidArgumentError(absl::StrCat(frames->Place(row, file), " is '",
                                                       picture.file,
                                                       "', must be a file in the run's pictures/"));
      picture.camera = std::string(frames->Text(row, camera));
      RS_ASSIGN_OR_RETURN(picture.t, frames->Number(row, t));
      RS_ASSIGN_OR_RETURN(picture.stamp, frames->Number(row, stamp));
      pictures_.push_back(std::move(picture));
    }
    return absl::OkStatus();
  }

  absl::Status WritePicture(const ShownPicture& picture, McapWriter* file,
                            ArmRunSummary& summary) const {
    const std::string path = absl::StrCat(folder_, "/", picture.file);
    const absl::StatusOr<std::string> png = ReadFileUpTo(path, kMostPictureBytes);
    if (absl::IsNotFound(png.status())) {
      ++summary.pictures_missing;
      return absl::OkStatus();
    }
    RS_RETURN_IF_ERROR(png.status());
    if (!absl::StartsWith(*png, "\x89PNG\r\n\x1a\n"))
      return absl::DataLossError(absl::StrCat(path, ": is no PNG; delete it to leave it out"));
    ++summary.pictures;
    return Send(cameras_.at(picture.camera), picture.t,
                Begin(picture.stamp).Text("png").Bytes(*png), file);
  }

  int64_t Stamp(double t) const { return std::llround((t + shift_) * kSecond); }
  CdrEncoder Begin(double t) const { return CdrEncoder().Header(Stamp(t), "base"); }
  absl::Status Send(uint16_t channel, double t, const CdrEncoder& message, McapWriter* file) const {
    return file->Write(channel, static_cast<uint64_t>(Stamp(t)), message.Message());
  }

  absl::Status WriteState(const CsvTable& table, size_t row, const std::vector<double>& times,
                          uint16_t channel, McapWriter* file) const {
    RS_ASSIGN_OR_RETURN(const std::vector<double> q, states_.position.At(table, row));
    RS_ASSIGN_OR_RETURN(const std::vector<double> dq, states_.velocity.At(table, row));
    RS_ASSIGN_OR_RETURN(const std::vector<double> tau, states_.effort.At(table, row));
    return Send(channel, times[row],
                Begin(times[row]).Texts(axes_).Numbers(q).Numbers(dq).Numbers(tau), file);
  }

  absl::Status WriteClient(size_t tick, uint16_t channel, McapWriter* file) const {
    CdrEncoder message = Begin(tick_times_[tick]);
    for (size_t i = 0; i < 2; ++i) message.Text(ticks_->Text(tick, client_[i]));
    for (size_t i = 2; i < client_.size(); ++i) {
      if (ticks_->Text(tick, client_[i]).empty()) {
        message.Number(std::nan(""));  // nothing was estimated
        continue;
      }
      RS_ASSIGN_OR_RETURN(const double value, ticks_->Number(tick, client_[i]));
      message.Number(value);
    }
    return Send(channel, tick_times_[tick], message, file);
  }

  std::string folder_;
  std::optional<CsvTable> ticks_, samples_;
  std::vector<ShownPicture> pictures_;
  std::map<std::string, uint16_t> cameras_;  // channels
  std::vector<double> tick_times_, sample_times_;
  std::vector<std::string> axes_;
  double shift_ = 0;  // [s] of the run's clock to the file's
  std::vector<AxisColumns> groups_;
  StateColumns states_;
  std::vector<size_t> client_;
};

}  // namespace

bool IsArmRun(const std::string& folder) { return !TableFile(folder, "ticks.csv").empty(); }

absl::StatusOr<ArmRunSummary> WriteArmRunMcap(const std::string& folder, const std::string& path) {
  ArmRun run;
  RS_RETURN_IF_ERROR(run.Open(folder));
  RS_ASSIGN_OR_RETURN(McapWriter file, McapWriter::Create(path, "ros2"));
  RS_ASSIGN_OR_RETURN(const ArmRunSummary summary, run.Write(&file));
  RS_RETURN_IF_ERROR(file.AddMetadata(
      "robostress", {{"config.yaml", ReadFile(folder + "/config.yaml").value_or("")},
                     {"run", fs::path(folder).lexically_normal().filename().string()}}));
  RS_RETURN_IF_ERROR(file.Publish());
  return summary;
}

}  // namespace robostress
