#include "common/records/episode_recording.h"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr char kFormat[] = "robostress.episode.1";
constexpr int kAction = 7, kJoints = 7, kProprioception = 8, kPose = 7, kLibero = 12;
constexpr int64_t kMostSteps = 100'000;
constexpr double kLargest = 1e30;  // fits in a float
constexpr char kPicture[] = "picture.";

// Texts and numbers of the metadata.
template <class Recording, class V>
void VisitMetadata(Recording& r, V& v) {
  v("suite", r.suite), v("scenario", r.scenario), v("policy", r.policy), v("method", r.method);
  v("task_name", r.task_name), v("instruction", r.instruction), v("model_file", r.model_file);
  v("severity", r.severity), v("task", r.task), v("episode", r.episode);
  v("initial_state", r.initial_state), v("seed", r.seed), v("success", r.success);
  v("rate_hz", r.rate_hz);
}

// One row of a table per step.
template <class T, class Row>
std::vector<T> Table(const EpisodeRecording& recording, const Row& row) {
  std::vector<T> values;
  for (const EpisodeRecording::Step& step : recording.steps) {
    const auto numbers = row(step);
    for (const auto& v : numbers) values.push_back(static_cast<T>(v));
  }
  return values;
}

std::array<double, kPose> PoseRow(const Pose& pose) {
  const auto& [p, q] = std::tie(pose.p_base_tool, pose.q_base_tool);
  return {p.x(), p.y(), p.z(), q.w(), q.x(), q.y(), q.z()};
}

std::array<double, kLibero> LiberoRow(const SimulatorRow& row) {
  std::array<double, kLibero> values;
  auto* at = std::copy(row.fingers.begin(), row.fingers.end(), values.begin());
  at = std::copy(row.ee_pos.begin(), row.ee_pos.end(), at);
  at = std::copy(row.ee_ori.begin(), row.ee_ori.end(), at);
  std::copy(row.ee_quat.begin(), row.ee_quat.end(), at);
  return values;
}

absl::Status Wrong(const std::string& file, const std::string& what) {
  return absl::DataLossError(absl::StrCat(file, ": ", what));
}

// The metadata of a file into a recording; the first error stays.
class MetadataReader {
 public:
  explicit MetadataReader(const SafetensorsFile& file) : file_(file) {}

  template <class T>
  void operator()(const char* key, T& value) {
    if (!status.ok()) return;
    const auto found = file_.metadata().find(key);
    if (found == file_.metadata().end()) {
      status = Wrong(file_.path(), absl::StrCat("metadata has no '", key, "'"));
      return;
    }
    bool good = true;
    if constexpr (std::is_same_v<T, std::string>) {
      value = found->second;
    } else if constexpr (std::is_same_v<T, bool>) {
      good = absl::SimpleAtob(found->second, &value);
    } else if constexpr (std::is_same_v<T, double>) {
      good = absl::SimpleAtod(found->second, &value) && std::isfinite(value);
    } else {
      good = absl::SimpleAtoi(found->second, &value);
    }
    if (!good) {
      status = Wrong(file_.path(),
                     absl::StrCat("metadata '", key, "' is '", found->second, "', not a number"));
    }
  }
  absl::Status status;

 private:
  const SafetensorsFile& file_;
};

absl::Status ReadPictures(const SafetensorsFile& file, const std::string& camera,
                          EpisodeRecording& recording) {
  const std::string name = kPicture + camera;
  RS_ASSIGN_OR_RETURN(const TensorView bytes, file.Get(name));
  RS_ASSIGN_OR_RETURN(const TensorView ends, file.Get(name + ".ends"));
  if (bytes.dtype != DType::kU8 || ends.dtype != DType::kI64 ||
      ends.num_elements() != static_cast<int64_t>(recording.steps.size()))
    return Wrong(file.path(), absl::StrCat(name, " does not hold a picture for every step"));
  std::vector<std::string>& pictures = recording.pictures.emplace_back();
  int64_t begin = 0;
  for (int64_t i = 0; i < ends.num_elements(); ++i) {
    int64_t end = 0;
    std::copy_n(ends.bytes.data() + i * sizeof(end), sizeof(end), reinterpret_cast<char*>(&end));
    if (end < begin || end > static_cast<int64_t>(bytes.bytes.size()))
      return Wrong(file.path(), absl::StrCat(name, ".ends is ", end, " in row ", i));
    pictures.emplace_back(bytes.bytes.begin() + begin, bytes.bytes.begin() + end);
    begin = end;
  }
  recording.cameras.push_back(camera);
  return absl::OkStatus();
}

absl::StatusOr<EpisodeRecording> RecordingOf(const SafetensorsFile& file) {
  const std::string& path = file.path();
  const auto format = file.metadata().find("format");
  if (format == file.metadata().end() || format->second != kFormat)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": is no recorded episode; its format must be '", kFormat, "'"));
  EpisodeRecording recording;
  MetadataReader metadata(file);
  VisitMetadata(recording, metadata);
  RS_RETURN_IF_ERROR(metadata.status);
  const auto problem = file.metadata().find("problem");  // older files have none
  if (problem != file.metadata().end()) recording.problem = problem->second;
  RS_ASSIGN_OR_RETURN(const std::vector<float> commanded,
                      file.ReadFloats("commanded", {-1, kAction}));
  const auto rows = static_cast<int64_t>(commanded.size()) / kAction;
  if (rows < 1 || rows > kMostSteps)
    return Wrong(path, absl::StrCat("holds ", rows, " steps, must be 1 to ", kMostSteps));
  recording.steps.resize(static_cast<size_t>(rows));
  const auto read = [&](const char* name, int width, const auto& take) -> absl::Status {
    RS_ASSIGN_OR_RETURN(const std::vector<double> values, file.ReadDoubles(name, {rows, width}));
    for (const double v : values) {
      if (!(std::abs(v) <= kLargest))  // nor a NaN
        return Wrong(path, absl::StrCat(name, " holds ", v, ", must be numbers up to ", kLargest));
    }
    const size_t each = values.size() / static_cast<size_t>(rows);
    for (size_t i = 0; i < recording.steps.size(); ++i)
      take(recording.steps[i], Eigen::Map<const Eigen::VectorXd>(values.data() + i * each,
                                                                 static_cast<Eigen::Index>(each)));
    return absl::OkStatus();
  };
  using Step = EpisodeRecording::Step;
  using Row = Eigen::Map<const Eigen::VectorXd>;
  const auto into = [](Eigen::VectorXf Step::*member) {
    return [member](Step& s, const Row& row) { s.*member = row.cast<float>(); };
  };
  RS_RETURN_IF_ERROR(read("commanded", kAction, into(&Step::commanded)));
  RS_RETURN_IF_ERROR(read("sent", kAction, into(&Step::sent)));
  RS_RETURN_IF_ERROR(read("measured", kAction, into(&Step::measured)));
  RS_RETURN_IF_ERROR(read("proprioception", kProprioception, into(&Step::proprioception)));
  RS_RETURN_IF_ERROR(read("q", kJoints, [](Step& s, const Row& row) { s.before.q = row; }));
  RS_RETURN_IF_ERROR(read("dq", kJoints, [](Step& s, const Row& row) { s.before.dq = row; }));
  RS_RETURN_IF_ERROR(read("tool", kPose, [](Step& s, const Row& row) {
    s.before.tool.p_base_tool = row.head<3>();
    s.before.tool.q_base_tool = Eigen::Quaterniond(row[3], row[4], row[5], row[6]);
  }));
  RS_RETURN_IF_ERROR(
      read("gripper", 1, [](Step& s, const Row& row) { s.before.gripper = row[0]; }));
  RS_RETURN_IF_ERROR(read("simulator", -1, [](Step& s, const Row& row) {
    s.simulator.state.assign(row.begin(), row.end());
  }));
  RS_RETURN_IF_ERROR(read("libero", kLibero, [](Step& s, const Row& row) {
    const double* at = row.data();
    std::copy_n(at, 2, s.simulator.fingers.begin());
    std::copy_n(at + 2, 3, s.simulator.ee_pos.begin());
    std::copy_n(at + 5, 3, s.simulator.ee_ori.begin());
    std::copy_n(at + 8, 4, s.simulator.ee_quat.begin());
    std::copy_n(s.before.q.begin(), kJoints, s.simulator.joints.begin());
  }));
  for (const auto& [name, tensor] : file.tensors()) {
    if (name.rfind(kPicture, 0) != 0 || name.ends_with(".ends")) continue;
    RS_RETURN_IF_ERROR(ReadPictures(file, name.substr(sizeof(kPicture) - 1), recording));
  }
  return recording;
}

}  // namespace

absl::Status WriteEpisodeRecording(const EpisodeRecording& recording, const std::string& file) {
  SafetensorsWriter writer;
  writer.SetMetadata("format", kFormat);
  const auto metadata = [&writer](const char* key, const auto& value) {
    writer.SetMetadata(key, absl::StrCat(value));
  };
  VisitMetadata(recording, metadata);
  if (!recording.problem.empty()) metadata("problem", recording.problem);
  const auto rows = static_cast<int64_t>(recording.steps.size());
  using Step = EpisodeRecording::Step;
  const auto floats = [&](const char* name, int64_t width, Eigen::VectorXf Step::*member) {
    writer.AddFloats(name, {rows, width},
                     Table<float>(recording, [&](const Step& s) { return s.*member; }));
  };
  floats("commanded", kAction, &Step::commanded);
  floats("sent", kAction, &Step::sent);
  floats("measured", kAction, &Step::measured);
  floats("proprioception", kProprioception, &Step::proprioception);
  const auto doubles = [&](const char* name, int64_t width, const auto& row) {
    writer.AddDoubles(name, {rows, width}, Table<double>(recording, row));
  };
  doubles("q", kJoints, [](const Step& s) { return s.before.q; });
  doubles("dq", kJoints, [](const Step& s) { return s.before.dq; });
  doubles("tool", kPose, [](const Step& s) { return PoseRow(s.before.tool); });
  doubles("gripper", 1, [](const Step& s) { return std::array{s.before.gripper}; });
  const size_t states = recording.steps.empty() ? 0 : recording.steps[0].simulator.state.size();
  doubles("simulator", static_cast<int64_t>(states),
          [](const Step& s) { return s.simulator.state; });
  doubles("libero", kLibero, [](const Step& s) { return LiberoRow(s.simulator); });
  for (size_t c = 0; c < recording.cameras.size(); ++c) {
    std::string bytes;
    std::vector<int64_t> ends;
    for (const std::string& picture : recording.pictures[c]) {
      bytes += picture;
      ends.push_back(static_cast<int64_t>(bytes.size()));
    }
    const std::string name = kPicture + recording.cameras[c];
    writer.Add(name, DType::kU8, {static_cast<int64_t>(bytes.size())}, bytes.data(), bytes.size());
    writer.AddInts(name + ".ends", {static_cast<int64_t>(ends.size())}, ends);
  }
  return writer.Write(file);
}

absl::StatusOr<EpisodeRecording> ReadEpisodeRecording(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  return RecordingOf(file);
}

absl::StatusOr<EpisodeRecording> ParseEpisodeRecording(const std::string& name, std::string bytes) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Parse(name, std::move(bytes)));
  return RecordingOf(file);
}

}  // namespace robostress
