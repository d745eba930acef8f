#include "robot_client/recorder.h"

#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robot_client/state_reporter.h"

namespace robostress {
namespace {

constexpr char kTicks[] = "/ticks.csv";
constexpr char kSamples[] = "/samples.csv";
constexpr char kFrames[] = "/frames.csv";
constexpr char kUnfinished[] = ".partial";
constexpr char kEvents[] = "/events.jsonl";

double Seconds(int64_t ns, int64_t origin_ns) { return static_cast<double>(ns - origin_ns) * 1e-9; }

void AppendVector(const ArmVector& v, const ArmAxes& axes, bool applies, std::string* out) {
  for (int axis = 0; axis < axes.count(); ++axis) {
    out->push_back(',');
    if (applies) absl::StrAppendFormat(out, "%.9g", v[axis]);
  }
}

// ",q_J1,q_J2 ..": a column per axis and group.
void AppendColumns(std::initializer_list<const char*> groups, const ArmAxes& axes,
                   std::string* header) {
  for (const char* group : groups) {
    for (const std::string& axis : axes.names()) absl::StrAppend(header, ",", group, "_", axis);
  }
}

absl::Status FileError(const std::string& what) {
  return absl::DataLossError(absl::StrCat(
      what, ": ", std::strerror(errno), "; the recording ends there: free space or correct --out"));
}

absl::StatusOr<std::FILE*> BeginTable(const std::string& path, const std::string& header) {
  std::FILE* file = std::fopen((path + kUnfinished).c_str(), "wx");
  if (file == nullptr || std::fputs(header.c_str(), file) < 0) return FileError(path + kUnfinished);
  return file;
}

// Gives a whole table its name.
absl::Status FinishTable(std::FILE* file, const std::string& path) {
  const bool synced = std::fflush(file) == 0 && fsync(fileno(file)) == 0;
  if (std::fclose(file) != 0 || !synced) return FileError(path + kUnfinished);
  if (std::rename((path + kUnfinished).c_str(), path.c_str()) != 0) return FileError(path);
  return absl::OkStatus();
}

std::string SampleHeader(const ArmAxes& axes) {
  std::string header = "t,sequence";
  AppendColumns({"q", "dq", "tau"}, axes, &header);
  return header + "\n";
}

std::string SampleRow(const ArmSnapshot& sample, const ArmAxes& axes, int64_t origin_ns) {
  std::string row =
      absl::StrFormat("%.9f,%d", Seconds(sample.stamp_ns, origin_ns), sample.sequence);
  for (const ArmVector* group : {&sample.position, &sample.velocity, &sample.effort})
    AppendVector(*group, axes, true, &row);
  return row + "\n";
}

constexpr char kFrameHeader[] =
    "t,request,prediction,episode,chunk,camera,use,sequence,stamp,age_ms,picture\n";

// A number that joins with the column of ticks.csv: without the session above it.
uint64_t PredictionNumber(uint64_t id) { return id & ((uint64_t{1} << 48) - 1); }

// `picture`: its file, or empty.
std::string FrameRow(const FrameRecord& r, int64_t origin_ns, const std::string& picture) {
  std::string row = absl::StrFormat("%.9f,%d,", Seconds(r.observed_ns, origin_ns), r.request);
  if (r.prediction_id != 0) absl::StrAppend(&row, PredictionNumber(r.prediction_id));
  absl::StrAppendFormat(&row, ",%d,%d,%s,%s,", r.episode, r.chunk, r.camera.data(),
                        FrameUseName(r.use));
  if (r.use == FrameUse::kMissing) return row + ",,,\n";
  absl::StrAppendFormat(&row, "%d,%.9f,%.3f,%s\n", r.sequence, Seconds(r.stamp_ns, origin_ns),
                        static_cast<double>(r.observed_ns - r.stamp_ns) * 1e-6, picture);
  return row;
}

}  // namespace

std::string Recorder::Header(const ArmAxes& axes) {
  std::string header =
      "t,tick,due,wake_us,sent_us,state,cause,flags,limiter,faults,episode,chunk,row,prediction,"
      "stamp,sequence";
  AppendColumns({"policy", "requested", "blended", "corrected", "sent", "q", "dq", "tau", "excess"},
                axes, &header);
  return header + ",delay";
}

std::string Recorder::Row(const TickRecord& r, int64_t origin_ns) {
  const bool played = (r.flags & (kTickPlayed | kTickLive)) != 0, measured = r.sequence != 0;
  const bool streams = r.state == ClientState::kEnabled || r.state == ClientState::kRun ||
                       r.state == ClientState::kHold || r.state == ClientState::kMove;
  std::string row = absl::StrFormat(
      "%.9f,%d,%.9f,%.1f,%.1f,%s,%s,%d,%d,%d,%d,%d,%d,%d,%.9f,%d", Seconds(r.start_ns, origin_ns),
      r.tick, Seconds(r.due_ns, origin_ns), static_cast<double>(r.start_ns - r.due_ns) / 1e3,
      static_cast<double>(r.sent_ns - r.due_ns) / 1e3, StateName(r.state), CauseName(r.cause),
      r.flags, r.limiter, r.faults, r.episode, r.chunk, r.row, PredictionNumber(r.prediction_id),
      measured ? Seconds(r.stamp_ns, origin_ns) : 0, r.sequence);
  AppendVector(r.policy, r.axes, played, &row);
  AppendVector(r.requested, r.axes, played, &row);
  AppendVector(r.blended, r.axes, streams, &row);
  AppendVector(r.corrected, r.axes, streams, &row);
  AppendVector(r.sent, r.axes, streams, &row);
  AppendVector(r.position, r.axes, measured, &row);
  AppendVector(r.velocity, r.axes, measured, &row);
  AppendVector(r.effort, r.axes, measured, &row);
  AppendVector(r.excess, r.axes, measured && streams, &row);
  row.push_back(',');
  if (std::isfinite(r.delay_s)) absl::StrAppendFormat(&row, "%.4f", r.delay_s);
  return row;
}

absl::StatusOr<std::unique_ptr<Recorder>> Recorder::Create(const std::string& directory,
                                                           const ArmAxes& axes) {
  RS_RETURN_IF_ERROR(MakeDirectories(directory));
  for (const char* name : {kTicks, kSamples, kFrames}) {
    const std::string file = directory + name;
    for (const std::string& path : {file, file + kUnfinished}) {
      if (std::filesystem::exists(path))
        return absl::AlreadyExistsError(absl::StrCat(
            path, " is there already: a recording is never overwritten; name another --out"));
    }
  }
  auto recorder = std::unique_ptr<Recorder>(new Recorder(directory, axes));
  RS_ASSIGN_OR_RETURN(recorder->ticks_, BeginTable(directory + kTicks, Header(axes) + "\n"));
  return recorder;
}

Recorder::~Recorder() {
  for (std::FILE* file : {ticks_, samples_file_, frames_file_}) {
    if (file != nullptr) std::fclose(file);
  }
}

absl::Status Recorder::NoteChange(const TickRecord& r) {
  state_ = r.state;
  cause_ = r.cause;
  nlohmann::ordered_json event = {{"t", Seconds(r.start_ns, origin_ns_)},
                                  {"tick", r.tick},
                                  {"event", "state"},
                                  {"state", StateName(r.state)},
                                  {"cause", CauseName(r.cause)},
                                  {"episode", r.episode}};
  if (r.faults != 0) event["faults"] = ArmFaultNames(r.faults, r.fault_joints);
  if (const std::string text = CauseText(r); !text.empty()) event["text"] = text;
  return Event(event.dump());
}

absl::Status Recorder::Event(const std::string& json) {
  return AppendLine(directory_ + kEvents, json);
}

absl::Status Recorder::Drain() {
  if (ticks_ == nullptr) return absl::FailedPreconditionError("the recording is finished");
  TickRecord record;
  while (ring_.Pop(record)) {
    if (rows_++ == 0) {
      origin_ns_ = record.start_ns;
      RS_RETURN_IF_ERROR(Event(
          nlohmann::ordered_json{{"t", 0.0}, {"event", "origin"}, {"monotonic_ns", origin_ns_}}
              .dump()));
    }
    const std::string row = Row(record, origin_ns_) + "\n";
    if (std::fputs(row.c_str(), ticks_) < 0) return FileError(directory_ + kTicks);
    if (record.state != state_ || record.cause != cause_) RS_RETURN_IF_ERROR(NoteChange(record));
  }
  if (std::fflush(ticks_) != 0) return FileError(directory_ + kTicks);
  if (rows_ == 0) return absl::OkStatus();
  RS_RETURN_IF_ERROR(DrainSamples());
  return DrainFrames();
}

absl::Status Recorder::DrainSamples() {
  ArmSnapshot sample;
  while (samples_.Pop(sample)) {
    if (samples_file_ == nullptr) {
      RS_ASSIGN_OR_RETURN(samples_file_, BeginTable(directory_ + kSamples, SampleHeader(axes_)));
    }
    if (std::fputs(SampleRow(sample, axes_, origin_ns_).c_str(), samples_file_) < 0)
      return FileError(directory_ + kSamples);
  }
  if (samples_file_ != nullptr && std::fflush(samples_file_) != 0)
    return FileError(directory_ + kSamples);
  return absl::OkStatus();
}

absl::Status Recorder::DrainFrames() {
  FrameRecord frame;
  while (frames_.Pop(frame)) {
    if (frames_file_ == nullptr) {
      RS_ASSIGN_OR_RETURN(frames_file_, BeginTable(directory_ + kFrames, kFrameHeader));
    }
    std::string picture;
    if (frame.picture != nullptr) {
      picture = absl::StrFormat("pictures/%06d_%s.png", frame.request,
                                CameraInFileNames(frame.camera.data()));
      RS_RETURN_IF_ERROR(MakeDirectories(directory_ + "/pictures"));
      RS_ASSIGN_OR_RETURN(const std::string png, EncodePng(*frame.picture));
      RS_RETURN_IF_ERROR(WriteFileAtomically(absl::StrCat(directory_, "/", picture), png));
    }
    if (std::fputs(FrameRow(frame, origin_ns_, picture).c_str(), frames_file_) < 0)
      return FileError(directory_ + kFrames);
  }
  if (frames_file_ != nullptr && std::fflush(frames_file_) != 0)
    return FileError(directory_ + kFrames);
  return absl::OkStatus();
}

absl::Status Recorder::Run(const std::atomic<bool>& stop,
                           const std::function<void(const absl::Status&)>& failed) {
  absl::Status first;
  while (!stop.load(std::memory_order_acquire)) {
    if (first.ok()) {
      first = Drain();
      if (!first.ok()) failed(first);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return first;
}

absl::Status Recorder::Finish() {
  RS_RETURN_IF_ERROR(Drain());
  RS_RETURN_IF_ERROR(FinishTable(std::exchange(ticks_, nullptr), directory_ + kTicks));
  if (samples_file_ != nullptr) {
    RS_RETURN_IF_ERROR(FinishTable(std::exchange(samples_file_, nullptr), directory_ + kSamples));
  }
  if (frames_file_ == nullptr) return absl::OkStatus();
  return FinishTable(std::exchange(frames_file_, nullptr), directory_ + kFrames);
}

}  // namespace robostress
