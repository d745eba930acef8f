#include "common/lerobot/lerobot_dataset.h"

#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/atomic_stream.h"
#include "common/lerobot/feature_statistics.h"
#include "common/lerobot/parquet_table.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr char kInfo[] = "/meta/info.json";
constexpr char kLock[] = "/meta/.lock", kBegun[] = "/meta/.begun";
constexpr char kImages[] = "observation.images.";
constexpr char kOurs[] = "robostress";  // in info.json; LeRobot passes over what it does not know
constexpr int kFilesPerChunk = 1000;
constexpr uint64_t kMostInfoBytes = 64 << 20;

Json Feature(const char* type, Json shape, Json names) {
  return {{"dtype", type}, {"shape", std::move(shape)}, {"names", std::move(names)}};
}

constexpr const char* kNumbers[] = {"timestamp", "next.reward"};
constexpr const char* kIndices[] = {"frame_index", "episode_index", "index", "task_index"};
constexpr const char* kMarks[] = {"next.done", "next.success"};

absl::Status CheckNames(const LerobotSchema& schema) {
  std::set<std::string> taken(std::begin(kNumbers), std::end(kNumbers));
  taken.insert(std::begin(kIndices), std::end(kIndices));
  taken.insert(std::begin(kMarks), std::end(kMarks));
  const auto check = [&taken](const char* kind, const std::string& name, const char* allowed,
                              const std::string& feature) -> absl::Status {
    const bool good = !name.empty() && std::all_of(name.begin(), name.end(), [&](char c) {
      return absl::ascii_isalnum(static_cast<unsigned char>(c)) || absl::StrContains(allowed, c);
    });
    if (!good) {
      return absl::InvalidArgumentError(absl::StrCat(
          kind, " '", name, "': its name is a feature's; use letters, digits and ", allowed));
    }
    if (!taken.insert(feature).second) {
      return absl::InvalidArgumentError(
          absl::StrCat(kind, " '", name, "': there is a feature ", feature, " already; rename it"));
    }
    return absl::OkStatus();
  };
  for (const auto& [name, axes] : schema.vectors) {
    RS_RETURN_IF_ERROR(check("feature", name, "._-", name));
    if (axes.empty())
      return absl::InvalidArgumentError(absl::StrCat("feature '", name, "' has no axes"));
  }
  for (const std::string& camera : schema.cameras)
    RS_RETURN_IF_ERROR(check("camera", camera, "_-", kImages + camera));
  return absl::OkStatus();
}

Json NewInfo(const LerobotSchema& schema) {
  const Json none = nullptr;
  Json features = Json::object();
  for (const auto& [name, axes] : schema.vectors)
    features[name] = Feature("float32", {axes.size()}, axes);
  for (const std::string& camera : schema.cameras) {
    // The size is that of the first episode.
    features[kImages + camera] = Feature("image", {0, 0, 3}, {"height", "width", "channels"});
    features[kImages + camera]["info"] = {{"is_depth_map", false}};
  }
  for (const char* name : kNumbers) features[name] = Feature("float32", {1}, none);
  for (const char* name : kIndices) features[name] = Feature("int64", {1}, none);
  for (const char* name : kMarks) features[name] = Feature("bool", {1}, none);
  return {{"codebase_version", "v3.0"},
          {"robot_type", schema.robot},
          {"total_episodes", 0},
          {"total_frames", 0},
          {"total_tasks", 0},
          {"chunks_size", kFilesPerChunk},
          {"data_files_size_in_mb", 100},
          {"video_files_size_in_mb", 200},
          {"fps", static_cast<int>(schema.rate_hz)},
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
        path, " is not a data set that RoboStress recorded; record into another folder"));
  }
  for (const char* field : {"codebase_version", "robot_type", "fps", "chunks_size"}) {
    if (there.value(field, Json()) != here[field])
      return Differs(path, field, there.value(field, Json()), here[field]);
  }
  // Names, and names of their entries.
  const auto features = [](const Json& info) {
    Json names = Json::object();
    if (info.contains("features") && info["features"].is_object()) {
      for (const auto& [name, feature] : info["features"].items())
        names[name] = feature.is_object() ? feature.value("names", Json()) : Json();
    }
    return names;
  };
  const Json theirs = features(there), ours = features(here);
  for (const Json* one : {&ours, &theirs}) {
    for (const auto& [name, names] : one->items()) {
      const auto entry = [&name = name](const Json& of) {
        return of.contains(name) ? of[name] : Json("not there");
      };
      if (entry(theirs) != entry(ours))
        return Differs(path, ("feature " + name).c_str(), entry(theirs), entry(ours));
    }
  }
  for (const char* field : {"total_episodes", "total_frames", "total_tasks"}) {
    if (!there.contains(field) || !there[field].is_number_unsigned()) {
      return absl::InvalidArgumentError(absl::StrCat(path, ": ", field, " is no count"));
    }
  }
  const Json tasks = there[kOurs].value("tasks", Json());
  if (!tasks.is_array() ||
      !std::all_of(tasks.begin(), tasks.end(), [](const Json& task) { return task.is_string(); }) ||
      !there[kOurs].value("statistics", Json()).is_object()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", kOurs,
                     " holds no list of texts, tasks, or no object, statistics; record into "
                     "another folder"));
  }
  return absl::OkStatus();
}

// The sizes of the first episode stay those of the set.
absl::Status CheckSizes(const LerobotEpisode& episode, const LerobotSchema& schema,
                        const std::string& directory, Json* info) {
  const size_t steps = episode.steps;
  if (steps == 0) return absl::InvalidArgumentError("the episode has no steps");
  for (size_t i = 0; i < schema.vectors.size(); ++i) {
    const auto& [name, axes] = schema.vectors[i];
    if (i < episode.vectors.size() && episode.vectors[i].size() == steps * axes.size()) continue;
    return absl::InternalError(absl::StrCat("feature ", name, " has not ", axes.size(),
                                            " numbers for each of ", steps, " steps"));
  }
  for (size_t c = 0; c < schema.cameras.size(); ++c) {
    const std::string& camera = schema.cameras[c];
    if (episode.pictures[c].size() != steps || episode.small[c].size() != steps) {
      return absl::InternalError(absl::StrCat("camera '", camera, "' has ",
                                              episode.pictures[c].size(), " pictures for ", steps,
                                              " steps"));
    }
    Json& shape = (*info)["features"][kImages + camera]["shape"];
    const Json now = {episode.height[c], episode.width[c], 3};
    if ((*info)["total_episodes"] == 0) shape = now;
    if (shape != now) {
      return Differs(directory + kInfo, (kImages + camera).c_str(), shape, now);
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

// LeRobot has a vector of one entry as a plain column.
int ListOf(const LerobotSchema::Vector& vector) {
  return vector.axes.size() == 1 ? 0 : static_cast<int>(vector.axes.size());
}

Table TableOf(const LerobotEpisode& episode, const LerobotSchema& schema, int64_t index,
              int64_t first, int64_t task) {
  const size_t n = episode.steps;
  std::vector<float> timestamp(n), reward(n, 0);
  std::vector<int64_t> frame(n), global(n);
  std::vector<uint8_t> done(n, 0), success(n, 0);
  for (size_t i = 0; i < n; ++i) {
    timestamp[i] = static_cast<float>(static_cast<double>(i) / schema.rate_hz);
    frame[i] = static_cast<int64_t>(i);
    global[i] = first + static_cast<int64_t>(i);
  }
  done.back() = 1;
  success.back() = episode.success ? 1 : 0;
  reward.back() = episode.success ? 1 : 0;
  Table table;
  for (size_t i = 0; i < schema.vectors.size(); ++i)
    table.Add(schema.vectors[i].name, episode.vectors[i], ListOf(schema.vectors[i]));
  for (size_t c = 0; c < schema.cameras.size(); ++c) {
    const std::string name = kImages + schema.cameras[c];
    std::vector<std::string> paths(n);
    for (size_t i = 0; i < n; ++i)
      paths[i] = absl::StrCat("frame-", absl::Dec(i, absl::kZeroPad6), ".", episode.picture_ending);
    table.columns.push_back({name, "bytes", episode.pictures[c]});
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

absl::StatusOr<std::string> EpisodeRow(const LerobotEpisode& episode, int64_t index,
                                       int64_t first) {
  const auto one = [](int64_t value) { return std::vector<int64_t>{value}; };
  const auto length = static_cast<int64_t>(episode.steps);
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

// With an info.json: data without it is from now on a set that lost it, and no remainder of ours.
void ForgetBeginning(const std::string& directory) {
  std::error_code ignored;
  fs::remove(directory + kBegun, ignored);
}

// Readers would fail at the first of the episodes that lies behind a lost one.
absl::Status CheckFiles(const std::string& directory, int64_t episodes) {
  std::error_code ignored;
  for (int64_t episode = 0; episode < episodes; ++episode) {
    for (const char* folder : {"data", "meta/episodes"}) {
      const std::string file = LerobotEpisodeFile(directory, folder, episode);
      if (fs::exists(file, ignored)) continue;
      return absl::FailedPreconditionError(
          absl::StrCat(file, " is not there, though ", directory, kInfo, " counts ", episodes,
                       " episodes; put it back, or record into another folder"));
    }
  }
  return absl::OkStatus();
}

// What meta/info.json says, `fresh` where there is none yet.
absl::StatusOr<Json> InfoOf(const std::string& directory, const Json& fresh) {
  const std::string path = directory + kInfo;
  if (fs::exists(path)) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostInfoBytes));
    Json there = Json::parse(text, nullptr, /*allow_exceptions=*/false);
    RS_RETURN_IF_ERROR(CheckInfo(path, there, fresh));
    RS_RETURN_IF_ERROR(CheckFiles(directory, there["total_episodes"].get<int64_t>()));
    return there;
  }
  // Of a first episode that was never finished, or of somebody else's set without its heart.
  if (!fs::exists(directory + kBegun) &&
      (fs::exists(directory + "/data") || fs::exists(directory + "/meta/episodes"))) {
    return absl::FailedPreconditionError(
        absl::StrCat(directory, " holds data without ", path, "; record into another folder"));
  }
  return fresh;
}

}  // namespace

std::string LerobotEpisodeFile(const std::string& directory, const char* folder, int64_t episode) {
  const auto three = [](int64_t number) { return absl::Dec(number, absl::kZeroPad3); };
  return absl::StrCat(directory, "/", folder, "/chunk-", three(episode / kFilesPerChunk), "/file-",
                      three(episode % kFilesPerChunk), ".parquet");
}

void LerobotDataset::Release::operator()(std::FILE* file) const {
  if (::getpid() == owner) ::flock(::fileno(file), LOCK_UN);
  std::fclose(file);
}

absl::StatusOr<LerobotDataset::Lock> LerobotDataset::TakeLock(const std::string& directory) {
  const std::string path = directory + kLock;
  RS_RETURN_IF_ERROR(MakeDirectories(directory + "/meta"));
  Lock lock(std::fopen(path.c_str(), "ae"), Release{::getpid()});
  if (lock == nullptr) return ErrnoStatus("cannot open", path, errno);
  // A file system without locks cannot protect; it does not stop the work either.
  if (::flock(::fileno(lock.get()), LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return lock;
  return absl::FailedPreconditionError(
      absl::StrCat("another recorder has ", directory,
                   " open, and there is one recorder a folder; close it, or record into another "
                   "folder"));
}

absl::StatusOr<LerobotDataset> LerobotDataset::Open(const std::string& directory,
                                                    const LerobotSchema& schema) {
  const double rate_hz = schema.rate_hz;
  if (!(rate_hz >= 1 && rate_hz <= 1000) || rate_hz != static_cast<int>(rate_hz)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "episodes at ", rate_hz, " Hz: LeRobot's fps is a whole number from 1 to 1000"));
  }
  RS_RETURN_IF_ERROR(CheckNames(schema));
  const Json fresh = NewInfo(schema);
  // Before the lock, so that somebody else's folder stays as it is; behind it, because a recorder
  // may have ended in between.
  RS_RETURN_IF_ERROR(InfoOf(directory, fresh).status());
  RS_ASSIGN_OR_RETURN(Lock lock, TakeLock(directory));
  RS_ASSIGN_OR_RETURN(Json info, InfoOf(directory, fresh));
  LerobotDataset set(directory, schema, std::move(info), std::move(lock));
  const bool complete = fs::exists(directory + kInfo);
  if (complete || fs::exists(directory + kBegun)) set.RemoveUnfinished();
  if (complete)
    ForgetBeginning(directory);
  else
    RS_RETURN_IF_ERROR(WriteInFolder(directory + kBegun, ""));
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

absl::Status LerobotDataset::Append(const LerobotEpisode& episode) {
  if (::getpid() != lock_.get_deleter().owner) {
    return absl::FailedPreconditionError(
        absl::StrCat(directory_,
                     " was opened by the process that this one was forked from, and there is one "
                     "recorder a folder; open another folder here, or record there"));
  }
  Json info = info_;
  RS_RETURN_IF_ERROR(CheckSizes(episode, schema_, directory_, &info));
  const int64_t index = episodes(), first = frames();
  const Table table =
      TableOf(episode, schema_, index, first, TaskIndex(episode.instruction, &info));
  Json& all = info[kOurs]["statistics"];
  for (const auto& [name, statistics] : table.statistics.items()) {
    try {
      all[name] = all.contains(name) ? JoinStatistics(all[name], statistics) : statistics;
    } catch (const Json::exception& error) {
      return absl::DataLossError(absl::StrCat(directory_, kInfo, ": ", kOurs, ".statistics.", name,
                                              ": ", error.what(), "; record into another folder"));
    }
  }
  info["total_episodes"] = index + 1;
  info["total_frames"] = first + static_cast<int64_t>(episode.steps);
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
  if (index == 0) ForgetBeginning(directory_);
  return absl::OkStatus();
}

}  // namespace robostress
