#include "robot_client/demonstration/lerobot_reader.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/lerobot/lerobot_dataset.h"
#include "common/lerobot/parquet_reader.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

constexpr uint64_t kMostInfoBytes = 64 << 20;
constexpr uint64_t kMostTableBytes = uint64_t{2} << 30;

}  // namespace

absl::StatusOr<LerobotReader> LerobotReader::Open(const std::string& directory,
                                                  const ArmAxes& axes) {
  const std::string path = directory + "/meta/info.json";
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostInfoBytes));
  const auto info = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  const auto wrong = [&](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", parts...));
  };
  if (!info.is_object()) return wrong("is no JSON object");
  if (!info.contains("robostress"))
    return wrong(
        "is of a data set that robot_client did not record; what its actions mean is not known, so "
        "they are not played");
  const auto number = [&](const char* field) -> double {
    return info.contains(field) && info[field].is_number() ? info[field].get<double>() : -1;
  };
  LerobotReader reader;
  reader.directory_ = directory;
  reader.axes_ = axes;
  reader.rate_hz_ = number("fps");
  if (!(reader.rate_hz_ >= 1 && reader.rate_hz_ <= 1000))
    return wrong("fps is ", reader.rate_hz_, ", must be 1 to 1000");
  const double episodes = number("total_episodes");
  if (!(episodes >= 1 && episodes <= 1e9))
    return wrong("total_episodes is ", episodes, "; there is nothing to play");
  reader.episodes_ = static_cast<int64_t>(episodes);
  const auto names =
      info.value(nlohmann::json::json_pointer("/features/action/names"), nlohmann::json());
  const nlohmann::json ours = axes.names();
  if (names != ours) return wrong("features.action.names is ", names.dump(), ", not ", ours.dump());
  return reader;
}

absl::StatusOr<std::vector<ArmVector>> LerobotReader::ReadActions(int64_t episode) const {
  if (episode < 0 || episode >= episodes_)
    return absl::NotFoundError(
        absl::StrCat(directory_, ": has no episode ", episode, "; it holds 0 to ", episodes_ - 1));
  const std::string path = LerobotEpisodeFile(directory_, "data", episode);
  RS_ASSIGN_OR_RETURN(std::string bytes, ReadFileUpTo(path, kMostTableBytes));
  RS_ASSIGN_OR_RETURN(const ParquetReader table, ParquetReader::Parse(path, std::move(bytes)));
  RS_ASSIGN_OR_RETURN(const std::vector<double> of, table.Numbers("episode_index"));
  if (std::any_of(of.begin(), of.end(),
                  [&](double e) { return e != static_cast<double>(episode); }))
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": holds rows of another episode than ", episode));
  const auto axes = static_cast<size_t>(axes_.count());
  RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, table.Numbers("action", axes));
  std::vector<ArmVector> actions(numbers.size() / axes);
  for (size_t i = 0; i < actions.size(); ++i)
    std::copy_n(numbers.begin() + static_cast<int64_t>(i * axes), axes, actions[i].begin());
  return actions;
}

}  // namespace robostress
