#include "robot_client/demonstration/lerobot_dataset.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "robot_client/demonstration/feature_statistics.h"
#include "robot_client/demonstration/parquet_table.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr char kInfo[] = "/meta/info.json";
constexpr char kImages[] = "observation.images.";
constexpr char kOurs[] = "robostress";  // in info.json; LeRobot passes over what it does not know
constexpr int kFilesPerChunk = 1000;
constexpr uint64_t kMostInfoBytes = 64 << 20;

Json Feature(const char* type, Json shape, Json names) {
  return {{"dtype", type}, {"shape", std::move(shape)}, {"names", std::move(names)}};
}

Json NewInfo(const std::string& robot, double rate_hz, const std::vector<std::string>& cameras) {
  const Json axes = {"J1", "J2", "J3", "J4", "J5", "J6", "gripper"}, none = nullptr;
  Json features = {{"observation.state", Feature("float32", {kArmAxes}, axes)},
                   {"action", Feature("float32", {kArmAxes}, axes)}};
  for (const std::string& camera : cameras) {
    // The size is that of the first episode.
    features[kImages + camera] = Feature("image", {0, 0, 3}, {"height", "width", "channels"});
    features[kImages + camera]["info"] = {{"is_depth_map", false}};
  }
  for (const char* name : {"timestamp", "next.reward"})
    features[name] = Feature("float32", {1}, none);
  for (const char* name : {"frame_index", "episode_index", "index", "task_index"})
    features[name] = Feature("int64", {1}, none);
  for (const char* name : {"next.done", "next.success"})
    features[name] = Feature("bool", {1}, none);
  return {{"codebase_version", "v3.0"},
          {"robot_type", robot},
          {"total_episodes", 0},
          {"total_frames", 0},
          {"total_tasks", 0},
          {"chunks_size", kFilesPerChunk},
          {"data_files_size_in_mb", 100},
          {"video_files_size_in_mb", 200},
          {"fps", static_cast<int>(rate_hz)},
          {"splits", {{"train", "0:0"}}},
          {"data_path", "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"},
          {"video_path", nullptr},
          {"features", std::move(features)},
          {kOurs, {{"tasks", Json::array()}, {"statistics", Json::object()}}}};
}

absl::Status Differs(const std::string& path, const char* field, const Json& there,
                     const Json& here) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": ", field, " is ", there.dump(),
                                                 ", this recording has ", here.dump(),
                                                 "; record into another folder"));
}

// A set of ours with the same schema; sizes of pictures are compared when an episode comes.
absl::Status CheckInfo(const std::string& path, const Json& there, const Json& here) {
  if (!there.is_object() || !there.contains(kOurs) || !there[kOurs].is_object()) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, " is not a data set that robot_client recorded; record into another folder"));
  }
  for (const char* field : {"codebase_version", "robot_type", "fps", "chunks_size"}) {
    if (there.value(field, Json()) != here[field])
      return Differs(path, field, there.value(field, Json()), here[field]);
  }
  const auto names = [](const Json& info) {
    Json list = Json::array();
    if (info.contains("features") && info["features"].is_object()) {
      for (const auto& [name, feature] : info["features"].items()) list.push_back(name);
    }
    return list;
  };
  if (names(there) != names(here)) return Differs(path, "features", names(there), names(here));
  for (const char* field : {"total_episodes", "total_frames", "total_tasks"}) {
    if (!there.contains(field) || !there[field].is_number_unsigned()) {
      return absl::InvalidArgumentError(absl::StrCat(path, ": ", field, " is no count"));
    }
  }
  return absl::OkStatus();
}

// The sizes of the first episode stay those of the set.
absl::Status CheckSizes(const DemonstrationEpisode& episode, const std::string& directory,
                        Json* info) {
  const size_t ticks = episode.ticks.size();
  if (ticks == 0) return absl::InvalidArgumentError("the episode has no ticks");
  for (size_t c = 0; c < episode.cameras.size(); ++c) {
    if (episode.jpegs[c].size() != ticks || episode.small[c].size() != ticks) {
      return absl::InternalError(absl::StrCat("camera '", episode.cameras[c], "' has ",
                                              episode.jpegs[c].size(), " pictures for ", ticks,
                                              " ticks"));
    }
    Json& shape = (*info)["features"][kImages + episode.cameras[c]]["shape"];
    const Json now = {episode.height[c], episode.width[c], 3};
    if ((*info)["total_episodes"] == 0) shape = now;
    if (shape != now) {
      return Differs(directory + kInfo, (kImages + episode.cameras[c]).c_str(), shape, now);
    }
  }
  return absl::OkStatus();
}

int64_t TaskIndex(const std::string& instruction, Json* info) {
  Json& tasks = (*info)[kOurs]["tasks"];
  const auto found = std::find(tasks.begin(), tasks.end(), instruction);
  const int64_t index = found - tasks.begin();
  if (found == tasks.end()) tasks.push_back(instruction);
  (*info)["total_tasks"] = tasks.size();
  return index;
}

// The columns of an episode, and its statistics.
struct Table {
  std::vector<ParquetColumn> columns;
  Json statistics = Json::object();

  template <class T>
  void Add(const std::string& name, std::vector<T> values, int list = 0) {
    if constexpr (!std::is_same_v<T, uint8_t>) {
      const std::vector<double> numbers(values.begin(), values.end());
      statistics[name] = VectorStatistics(numbers, static_cast<size_t>(std::max(list, 1)));
    }
    columns.push_back({name, "", std::move(values), false, list});
  }
};

Table TableOf(const DemonstrationEpisode& episode, int64_t index, int64_t first, int64_t task) {
  const size_t n = episode.ticks.size();
  std::vector<float> state, action, timestamp(n), reward(n, 0);
  std::vector<int64_t> frame(n), global(n);
  std::vector<uint8_t> done(n, 0), success(n, 0);
  for (size_t i = 0; i < n; ++i) {
    for (const double v : episode.ticks[i].state) state.push_back(static_cast<float>(v));
    for (const double v : episode.ticks[i].action) action.push_back(static_cast<float>(v));
    timestamp[i] = static_cast<float>(static_cast<double>(i) / episode.rate_hz);
    frame[i] = static_cast<int64_t>(i);
    global[i] = first + static_cast<int64_t>(i);
  }
  done.back() = 1;
  success.back() = episode.success ? 1 : 0;
  reward.back() = episode.success ? 1 : 0;
  Table table;
  table.Add("observation.state", std::move(state), kArmAxes);
  table.Add("action", std::move(action), kArmAxes);
  for (size_t c = 0; c < episode.cameras.size(); ++c) {
    const std::string name = kImages + episode.cameras[c];
    std::vector<std::string> paths(n);
    for (size_t i = 0; i < n; ++i) paths[i] = absl::StrFormat("frame-%06d.jpg", i);
    table.columns.push_back({name, "bytes", episode.jpegs[c]});
    table.columns.push_back({name, "path", std::move(paths), true});
    table.statistics[name] = PictureStatistics(episode.small[c]);
  }
  table.Add("timestamp", std::move(timestamp));
  table.Add("next.reward", std::move(reward));
  table.Add("frame_index", std::move(frame));
  table.Add("episode_index", std::vector<int64_t>(n, index));
  table.Add("index", std::move(global));
  table.Add("task_index", std::vector<int64_t>(n, task));
  table.Add("next.done", std::move(done));
  table.Add("next.success", std::move(success));
  return table;
}

absl::StatusOr<std::string> EpisodeRow(const DemonstrationEpisode& episode, int64_t index,
                                       int64_t first) {
  const auto one = [](int64_t value) { return std::vector<int64_t>{value}; };
  const auto length = static_cast<int64_t>(episode.ticks.size());
  const int64_t chunk = index / kFilesPerChunk, file = index % kFilesPerChunk;
  return ParquetTable({{"episode_index", "", one(index)},
                       {"tasks", "", std::vector<std::string>{episode.instruction}, true, 1},
                       {"length", "", one(length)},
                       {"data/chunk_index", "", one(chunk)},
                       {"data/file_index", "", one(file)},
                       {"dataset_from_index", "", one(first)},
                       {"dataset_to_index", "", one(first + length)},
                       {"meta/episodes/chunk_index", "", one(chunk)},
                       {"meta/episodes/file_index", "", one(file)}});
}

// LeRobot looks tasks up in the index of a pandas frame.
constexpr char kTaskFrame[] =
    R"({"index_columns":["task"],"column_indexes":[{"name":null,"field_name":null,)"
    R"("pandas_type":"unicode","numpy_type":"object","metadata":{"encoding":"UTF-8"}}],"columns":)"
    R"([{"name":"task_index","field_name":"task_index","pandas_type":"int64","numpy_type":"int64",)"
    R"("metadata":null},{"name":"task","field_name":"task","pandas_type":"unicode",)"
    R"("numpy_type":"object","metadata":null}],"pandas_version":"2.0.0"})";

absl::Status WriteInFolder(const std::string& path, const std::string& bytes) {
  RS_RETURN_IF_ERROR(MakeDirectories(fs::path(path).parent_path().string()));
  return WriteFileAtomically(path, bytes);
}

}  // namespace

std::string LerobotEpisodeFile(const std::string& directory, const char* folder, int64_t episode) {
  return absl::StrFormat("%s/%s/chunk-%03d/file-%03d.parquet", directory, folder,
                         episode / kFilesPerChunk, episode % kFilesPerChunk);
}

absl::StatusOr<LerobotDataset> LerobotDataset::Open(const std::string& directory,
                                                    const std::string& robot, double rate_hz,
                                                    const std::vector<std::string>& cameras) {
  if (!(rate_hz >= 1 && rate_hz <= 1000) || rate_hz != static_cast<int>(rate_hz)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "demonstrations at ", rate_hz, " Hz: LeRobot's fps is a whole number from 1 to 1000"));
  }
  for (const std::string& camera : cameras) {
    const bool good = !camera.empty() && std::all_of(camera.begin(), camera.end(), [](char c) {
      return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-';
    });
    if (!good) {
      return absl::InvalidArgumentError(absl::StrCat(
          "camera '", camera, "': its name becomes a feature's; use letters, digits, _ and -"));
    }
  }
  Json info = NewInfo(robot, rate_hz, cameras);
  const std::string path = directory + kInfo;
  if (fs::exists(path)) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostInfoBytes));
    Json there = Json::parse(text, nullptr, /*allow_exceptions=*/false);
    RS_RETURN_IF_ERROR(CheckInfo(path, there, info));
    info = std::move(there);
  } else if (fs::exists(directory + "/data") || fs::exists(directory + "/meta/episodes")) {
    // Of a first episode that was never finished, or of somebody else's set without its heart.
    if (fs::exists(LerobotEpisodeFile(directory, "data", 1))) {
      return absl::FailedPreconditionError(absl::StrCat(directory, " holds episodes without ", path,
                                                        "; record into another folder"));
    }
  }
  LerobotDataset set(directory, std::move(info));
  set.RemoveUnfinished();
  if (set.episodes() > 0) RS_RETURN_IF_ERROR(set.WriteTables(set.info_));
  return set;
}

// What a process left behind that was killed between its first file and info.json: one episode,
// and the temporary file that it was writing.
void LerobotDataset::RemoveUnfinished() const {
  std::error_code ignored;
  for (const char* folder : {"data", "meta/episodes"}) {
    const fs::path file = LerobotEpisodeFile(directory_, folder, episodes());
    fs::remove(file, ignored);
    for (const fs::path& parent : {file.parent_path(), fs::path(directory_ + "/meta")}) {
      for (const auto& entry : fs::directory_iterator(parent, ignored)) {
        if (absl::StrContains(entry.path().filename().string(), ".tmp."))
          fs::remove(entry.path(), ignored);
      }
    }
  }
}

absl::Status LerobotDataset::WriteTables(const Json& info) const {
  std::vector<std::string> texts;
  std::vector<int64_t> indices;
  for (const Json& task : info[kOurs]["tasks"]) {
    indices.push_back(static_cast<int64_t>(texts.size()));
    texts.push_back(task.get<std::string>());
  }
  RS_ASSIGN_OR_RETURN(const std::string tasks, ParquetTable({{"task_index", "", std::move(indices)},
                                                             {"task", "", std::move(texts), true}},
                                                            {{"pandas", kTaskFrame}}));
  RS_RETURN_IF_ERROR(WriteInFolder(directory_ + "/meta/tasks.parquet", tasks));
  return WriteInFolder(directory_ + "/meta/stats.json", info[kOurs]["statistics"].dump(1));
}

absl::Status LerobotDataset::Append(const DemonstrationEpisode& episode) {
  Json info = info_;
  RS_RETURN_IF_ERROR(CheckSizes(episode, directory_, &info));
  const int64_t index = episodes(), first = frames();
  const Table table = TableOf(episode, index, first, TaskIndex(episode.instruction, &info));
  Json& all = info[kOurs]["statistics"];
  for (const auto& [name, statistics] : table.statistics.items())
    all[name] = all.contains(name) ? JoinStatistics(all[name], statistics) : statistics;
  info["total_episodes"] = index + 1;
  info["total_frames"] = first + static_cast<int64_t>(episode.ticks.size());
  info["splits"]["train"] = absl::StrCat("0:", index + 1);

  RS_ASSIGN_OR_RETURN(const std::string data, ParquetTable(table.columns));
  RS_ASSIGN_OR_RETURN(const std::string row, EpisodeRow(episode, index, first));
  absl::Status written = WriteInFolder(LerobotEpisodeFile(directory_, "data", index), data);
  if (written.ok())
    written = WriteInFolder(LerobotEpisodeFile(directory_, "meta/episodes", index), row);
  if (written.ok()) written = WriteTables(info);
  if (written.ok()) written = WriteInFolder(directory_ + kInfo, info.dump(1));
  if (!written.ok()) {
    RemoveUnfinished();
    if (index > 0) WriteTables(info_).IgnoreError();
    return written;
  }
  info_ = std::move(info);
  return absl::OkStatus();
}

}  // namespace robostress
