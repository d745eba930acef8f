#include "common/recordings/lerobot_recording.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
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
constexpr double kMostSeconds = 1e9;   // of an episode
constexpr double kMostEpisodes = 1e9;  // that are counted
constexpr size_t kMostRanges = 5;      // of missing episodes that are said

// A column of a feature that is a joint's: what of the joint, and at which place.
struct NamedColumn {
  size_t place = 0;
  JointQuantity quantity = JointQuantity::kPosition;
  std::string joint;
};

// A feature of info.json that joints are read from.
struct Feature {
  std::string name;
  JointQuantity quantity = JointQuantity::kPosition;  // of names that do not say it
  std::vector<std::string> names;
  std::vector<NamedColumn> columns;
};

struct Info {
  std::string version;
  double fps = 0;
  std::vector<Feature> features;
  std::string caution;
  std::vector<std::string> notes;
  // Of the whole data set; -1: info.json does not say.
  int64_t episodes = -1, frames = -1;
};

// Names stand in a list, in a list in a list, or in a map of lists, one behind the other.
std::vector<std::string> NamesOf(const nlohmann::ordered_json& names) {
  std::vector<std::string> result;
  if (names.is_object() || (names.is_array() && names.size() == 1 && names[0].is_array())) {
    for (const auto& part : names) {
      const std::vector<std::string> of_part = NamesOf(part);
      if (of_part.empty()) return {};
      result.insert(result.end(), of_part.begin(), of_part.end());
    }
    return result;
  }
  if (!names.is_array()) return result;
  for (const auto& name : names) {
    if (!name.is_string()) return {};
    result.push_back(name.get<std::string>());
  }
  return result;
}

// "shoulder_pan.vel" is shoulder_pan's velocity; what a name does not say the feature does.
NamedColumn ColumnOf(absl::string_view name, size_t place, JointQuantity quantity) {
  for (const auto& [suffix, said] :
       {std::pair(".pos",
                  quantity == JointQuantity::kCommand ? quantity : JointQuantity::kPosition),
        std::pair(".vel", JointQuantity::kVelocity), std::pair(".effort", JointQuantity::kEffort),
        std::pair(".torque", JointQuantity::kEffort)}) {
    if (absl::ConsumeSuffix(&name, suffix)) return {place, said, std::string(name)};
  }
  return {place, quantity, std::string(name)};
}

// Columns of joints whose position is there, each once. What an action says of velocities and
// torques is no measurement. Other names are noted.
void ChooseColumns(const std::string& path, Info* info) {
  std::set<std::string> known;
  for (size_t place = 0; place < info->features[0].names.size(); ++place) {
    const NamedColumn column =
        ColumnOf(info->features[0].names[place], place, JointQuantity::kPosition);
    if (column.quantity == JointQuantity::kPosition) known.insert(column.joint);
  }
  std::set<std::pair<JointQuantity, std::string>> taken;
  for (Feature& feature : info->features) {
    std::vector<std::string> unused;
    for (size_t place = 0; place < feature.names.size(); ++place) {
      NamedColumn column = ColumnOf(feature.names[place], place, feature.quantity);
      const bool asked = feature.quantity == JointQuantity::kCommand;
      if (known.count(column.joint) == 0 || asked != (column.quantity == JointQuantity::kCommand) ||
          !taken.insert({column.quantity, column.joint}).second) {
        unused.push_back(feature.names[place]);
        continue;
      }
      feature.columns.push_back(std::move(column));
    }
    if (!unused.empty())
      info->notes.push_back(absl::StrCat(
          path, ": features.", feature.name, ": not used: ", absl::StrJoin(unused, ", "),
          "; read are names of joints whose positions the state has, "
          "each once"));
  }
}

absl::StatusOr<Feature> FeatureOf(const std::string& path, const nlohmann::ordered_json& features,
                                  const std::string& name, JointQuantity quantity) {
  Feature feature{name, quantity, {}, {}};
  if (!features.contains(name)) return feature;
  const nlohmann::ordered_json& entry = features[name];
  const auto wrong = [&](const auto&... parts) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": features.", name, ": ", absl::StrCat(parts...)));
  };
  if (!entry.is_object()) return wrong("is no object");
  const auto dtype = entry.value("dtype", nlohmann::ordered_json());
  if (dtype != "float32" && dtype != "float64")
    return wrong("dtype is ", dtype.dump(), ", read are float32 and float64");
  const auto shape = entry.value("shape", nlohmann::ordered_json());
  if (!shape.is_array() || shape.size() != 1 || !shape[0].is_number_unsigned() ||
      shape[0].get<uint64_t>() < 1 || shape[0].get<uint64_t>() > kMostWidth)
    return wrong("shape is ", shape.dump(), ", must be [joints], up to ", kMostWidth);
  const size_t width = shape[0].get<size_t>();
  feature.names = NamesOf(entry.value("names", nlohmann::ordered_json()));
  if (feature.names.size() != width) feature.names = NumberedJoints(width);
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
  // In the order of the file: names of a map of lists follow it.
  const nlohmann::ordered_json ordered = nlohmann::ordered_json::parse(text, nullptr, false);
  const auto features = ordered.value("features", nlohmann::ordered_json::object());
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
      if (feature.names.empty()) continue;
      info.features.push_back(std::move(feature));
      break;
    }
  }
  if (info.features.empty() || info.features[0].quantity != JointQuantity::kPosition)
    return wrong("features has neither observation.state nor observation.joints");
  ChooseColumns(path, &info);
  if (info.features[0].columns.empty())
    return wrong("features.", info.features[0].name, ": none of its names is a joint's position");
  std::erase_if(info.features, [](const Feature& feature) { return feature.columns.empty(); });
  const bool commanded = info.features.back().quantity == JointQuantity::kCommand;
  info.caution =
      commanded
          ? "an action is what was requested; what was sent after limits the data set does not say"
      : features.contains("action")
          ? "actions are not taken for commands: none of their names is a joint's of the state"
          : "";
  for (const auto& [key, count] :
       {std::pair("total_episodes", &info.episodes), std::pair("total_frames", &info.frames)}) {
    const auto value = json->value(key, nlohmann::json());
    if (value.is_number_unsigned()) *count = value.get<int64_t>();
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

// What of a data set was there.
struct Found {
  double episode = -1;  // of the last row; it goes on where a group begins with it
  std::set<int64_t> episodes;
  int64_t frames = 0;
};

absl::Status ReadGroup(const ParquetReader& table, size_t group, const std::string& path,
                       const Info& info, size_t channel, Found* found, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const std::vector<double> of, table.NumbersOfGroup(group, "episode_index"));
  RS_ASSIGN_OR_RETURN(const std::vector<double> seconds, table.NumbersOfGroup(group, "timestamp"));
  for (const double t : seconds) {
    if (!(std::abs(t) <= kMostSeconds))
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": timestamp is ", t, ", must be seconds of an episode"));
  }
  std::vector<JointColumns> columns;
  for (const Feature& feature : info.features) {
    const size_t width = feature.names.size();
    RS_ASSIGN_OR_RETURN(  // shape [1] is a plain column
        const std::vector<double> values,
        table.NumbersOfGroup(group, feature.name, width == 1 ? 0 : static_cast<int>(width)));
    for (const NamedColumn& named : feature.columns) {
      JointColumns column{named.quantity, {named.joint}, {}};
      for (size_t i = named.place; i < values.size(); i += width)
        column.values.push_back(values[i]);
      columns.push_back(std::move(column));
    }
  }
  for (size_t first = 0; first < of.size();) {
    size_t last = first;
    while (last < of.size() && of[last] == of[first]) ++last;
    if (last == first) ++last;  // no number is equal to itself
    if (of[first] != found->episode) {
      found->episode = of[first];
      if (std::abs(of[first]) < kMostEpisodes) found->episodes.insert(std::llround(of[first]));
      rows->visitor().OnEpisode(absl::StrFormat("episode %.0f", found->episode));
    }
    found->frames += static_cast<int64_t>(last - first);
    RS_RETURN_IF_ERROR(SendPart(channel, seconds, first, last, columns, rows));
    first = last;
  }
  return absl::OkStatus();
}

// What info.json counts and the files do not hold; empty: nothing.
std::string Missing(const Info& info, const Found& found) {
  const auto here = static_cast<int64_t>(found.episodes.size());
  if (info.episodes <= here) {
    if (info.frames <= found.frames) return "";
    return absl::StrFormat("%d of %d frames are here", found.frames, info.frames);
  }
  std::vector<std::string> ranges;
  int64_t next = 0;
  const auto lack = [&](int64_t end) {  // next ... end - 1
    if (end == next + 1) ranges.push_back(absl::StrCat(next));
    if (end > next + 1) ranges.push_back(absl::StrCat(next, " to ", end - 1));
  };
  for (const int64_t episode : found.episodes) {
    lack(std::min(episode, info.episodes));
    next = episode + 1;
  }
  lack(info.episodes);
  const size_t more = ranges.size() > kMostRanges ? ranges.size() - kMostRanges : 0;
  ranges.resize(ranges.size() - more);
  return absl::StrFormat("%d of %d episodes are here, %s%s missing", here, info.episodes,
                         absl::StrJoin(ranges, ", "),
                         more > 0                                                 ? " and more are"
                         : ranges.size() > 1 || absl::StrContains(ranges[0], " ") ? " are"
                                                                                  : " is");
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
  for (const std::string& note : info.notes) rows->visitor().OnNote(note);
  Found found;
  for (const std::string& path : files) {
    RS_ASSIGN_OR_RETURN(const ParquetReader table, ParquetReader::Open(path));
    for (size_t group = 0; group < table.groups(); ++group)
      RS_RETURN_IF_ERROR(ReadGroup(table, group, path, info, channel, &found, rows));
  }
  if (const std::string missing = Missing(info, found); !missing.empty())
    rows->visitor().OnNote(absl::StrCat(folder, ": by meta/info.json ", missing,
                                        "; download the rest, or go on without it"));
  return absl::OkStatus();
}

}  // namespace robostress
