#include "common/recordings/lerobot_recording.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/lerobot/parquet_reader.h"
#include "common/recordings/table_rows.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMostInfo = uint64_t{64} << 20;
constexpr size_t kMostFiles = 1'000'000;
constexpr size_t kMostWidth = 128;
constexpr double kMostSeconds = 1e9;  // of an episode

// A feature of info.json that joints are read from.
struct Feature {
  std::string name;
  JointQuantity quantity = JointQuantity::kPosition;
  std::vector<std::string> joints;
  bool scalar = false;  // shape [1] is a plain column
};

struct Info {
  std::string version;
  double fps = 0;
  std::vector<Feature> features;
  std::string caution;
};

// Names stand in a list, in a list in a list, or in a map of one list.
std::vector<std::string> NamesOf(const nlohmann::json& names) {
  std::vector<std::string> result;
  if (names.is_object() && names.size() == 1) return NamesOf(names.begin().value());
  if (!names.is_array()) return result;
  if (names.size() == 1 && names[0].is_array()) return NamesOf(names[0]);
  for (const auto& name : names) {
    if (!name.is_string()) return {};
    result.push_back(name.get<std::string>());
  }
  return result;
}

absl::StatusOr<Feature> FeatureOf(const std::string& path, const nlohmann::json& features,
                                  const std::string& name, JointQuantity quantity) {
  Feature feature{name, quantity, {}, false};
  if (!features.contains(name)) return feature;
  const nlohmann::json& entry = features[name];
  const auto wrong = [&](const auto&... parts) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": features.", name, ": ", absl::StrCat(parts...)));
  };
  if (!entry.is_object()) return wrong("is no object");
  const auto dtype = entry.value("dtype", nlohmann::json());
  if (dtype != "float32" && dtype != "float64")
    return wrong("dtype is ", dtype.dump(), ", read are float32 and float64");
  const auto shape = entry.value("shape", nlohmann::json());
  if (!shape.is_array() || shape.size() != 1 || !shape[0].is_number_unsigned() ||
      shape[0].get<uint64_t>() < 1 || shape[0].get<uint64_t>() > kMostWidth)
    return wrong("shape is ", shape.dump(), ", must be [joints], up to ", kMostWidth);
  const size_t width = shape[0].get<size_t>();
  feature.joints = NamesOf(entry.value("names", nlohmann::json()));
  if (feature.joints.size() != width) feature.joints = NumberedJoints(width);
  feature.scalar = width == 1;
  return feature;
}

absl::StatusOr<Info> ReadInfo(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostInfo));
  const auto json = ParseJsonObject(text);
  const auto wrong = [&](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", absl::StrCat(parts...)));
  };
  if (!json.ok()) return wrong(json.status().message());
  Info info;
  const auto version = json->value("codebase_version", nlohmann::json());
  info.version = version.is_string() ? version.get<std::string>() : "";
  if (!absl::StartsWith(info.version, "v2.") && !absl::StartsWith(info.version, "v3."))
    return wrong("codebase_version is ", version.dump(), "; read are v2 and v3");
  const auto storage = json->value("storage_format", nlohmann::json());
  if (!storage.is_null() && storage != "parquet")
    return wrong("storage_format is ", storage.dump(), "; read is parquet, convert the data set");
  const auto fps = json->value("fps", nlohmann::json());
  info.fps = fps.is_number() ? fps.get<double>() : 0;
  if (!(info.fps > 0 && info.fps <= 1e5)) return wrong("fps is ", fps.dump());
  const auto features = json->value("features", nlohmann::json::object());
  if (!features.is_object()) return wrong("features is no object");
  for (const auto& [quantity, names] :
       {std::pair(JointQuantity::kPosition,
                  std::vector<std::string>{"observation.joints", "observation.state"}),
        std::pair(JointQuantity::kVelocity,
                  std::vector<std::string>{"observation.joint_velocities", "observation.velocity"}),
        std::pair(JointQuantity::kEffort,
                  std::vector<std::string>{"observation.effort", "observation.torque"}),
        std::pair(JointQuantity::kCommand, std::vector<std::string>{"action"})}) {
    for (const std::string& name : names) {
      RS_ASSIGN_OR_RETURN(Feature feature, FeatureOf(path, features, name, quantity));
      if (feature.joints.empty()) continue;
      info.features.push_back(std::move(feature));
      break;
    }
  }
  if (info.features.empty() || info.features[0].quantity != JointQuantity::kPosition)
    return wrong("features has neither observation.state nor observation.joints");
  info.caution =
      "an action is what was requested; what was sent after limits the data set does not say";
  if (info.features.back().quantity == JointQuantity::kCommand &&
      info.features.back().joints != info.features[0].joints) {
    info.caution = "actions are not taken for commands: their names are not those of the state";
    info.features.pop_back();
  }
  return info;
}

// Parquet files below data/, whose names count with leading zeros.
absl::StatusOr<std::vector<std::string>> DataFiles(const std::string& folder) {
  std::vector<std::string> files;
  std::error_code error;
  for (fs::recursive_directory_iterator entry(fs::path(folder) / "data", error), end;
       !error && entry != end; entry.increment(error)) {
    if (entry->path().extension() == ".parquet" && files.size() < kMostFiles)
      files.push_back(entry->path().string());
  }
  std::sort(files.begin(), files.end());
  if (!files.empty()) return files;
  return absl::InvalidArgumentError(
      absl::StrCat(folder, ": has no .parquet file below data/; download them, not only meta/"));
}

// The rows [first, last) of `columns`, an episode's.
absl::Status SendPart(size_t channel, const std::vector<double>& seconds, size_t first, size_t last,
                      const std::vector<JointColumns>& columns, RowStream* rows) {
  std::vector<int64_t> times;
  for (size_t i = first; i < last; ++i) times.push_back(std::llround(seconds[i] * 1e9));
  std::vector<JointColumns> part;
  for (const JointColumns& group : columns) {
    const auto width = static_cast<std::ptrdiff_t>(group.joints.size());
    part.push_back(
        {group.quantity, group.joints,
         std::vector<double>(group.values.begin() + static_cast<std::ptrdiff_t>(first) * width,
                             group.values.begin() + static_cast<std::ptrdiff_t>(last) * width)});
  }
  return SendRows(channel, times, true, part, rows);
}

// `episode`: of the last row before; it goes on where a group begins with it.
absl::Status ReadGroup(const ParquetReader& table, size_t group, const std::string& path,
                       const Info& info, size_t channel, double* episode, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const std::vector<double> of, table.NumbersOfGroup(group, "episode_index"));
  RS_ASSIGN_OR_RETURN(const std::vector<double> seconds, table.NumbersOfGroup(group, "timestamp"));
  for (const double t : seconds) {
    if (!(std::abs(t) <= kMostSeconds))
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": timestamp is ", t, ", must be seconds of an episode"));
  }
  std::vector<JointColumns> columns;
  for (const Feature& feature : info.features) {
    JointColumns column{feature.quantity, feature.joints, {}};
    RS_ASSIGN_OR_RETURN(
        column.values,
        table.NumbersOfGroup(group, feature.name,
                             feature.scalar ? 0 : static_cast<int>(feature.joints.size())));
    columns.push_back(std::move(column));
  }
  for (size_t first = 0; first < of.size();) {
    size_t last = first;
    while (last < of.size() && of[last] == of[first]) ++last;
    if (last == first) ++last;  // no number is equal to itself
    if (of[first] != *episode) {
      *episode = of[first];
      rows->visitor().OnEpisode(absl::StrFormat("episode %.0f", *episode));
    }
    RS_RETURN_IF_ERROR(SendPart(channel, seconds, first, last, columns, rows));
    first = last;
  }
  return absl::OkStatus();
}

}  // namespace

bool IsLerobotFolder(const std::string& folder) {
  std::error_code error;
  return fs::is_regular_file(fs::path(folder) / "meta" / "info.json", error);
}

absl::Status ReadLerobotRecording(const std::string& folder, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const Info info,
                      ReadInfo((fs::path(folder) / "meta" / "info.json").string()));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> files, DataFiles(folder));
  RecordedChannel description;
  description.name = info.features[0].name;
  description.type = "LeRobot " + info.version;
  description.unit_because =
      "info.json says none: followers have degrees, or -100 to 100 of their range";
  description.caution = info.caution;
  description.times =
      absl::StrFormat("timestamps at %.4g Hz, as the writer counted them", info.fps);
  description.decoded = true;
  RS_ASSIGN_OR_RETURN(const size_t channel, rows->Channel(description));
  double episode = -1;
  for (const std::string& path : files) {
    RS_ASSIGN_OR_RETURN(const ParquetReader table, ParquetReader::Open(path));
    for (size_t group = 0; group < table.groups(); ++group)
      RS_RETURN_IF_ERROR(ReadGroup(table, group, path, info, channel, &episode, rows));
  }
  return absl::OkStatus();
}

}  // namespace robostress
