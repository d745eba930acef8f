#include "server/policies/openpi/norm_stats.h"

#include <cmath>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

constexpr uint64_t kMaxJsonBytes = 16 << 20;
constexpr size_t kMaxDims = 4096;  // as action_dim

constexpr char kRemedy[] =
    "Take the statistics that were made with the checkpoint, or compute them again from its data";

// One list of FieldStats by its name in the files.
struct Statistic {
  const char* name;
  std::vector<double> FieldStats::*member;
  bool required;
};
constexpr Statistic kStatistics[] = {{"mean", &FieldStats::mean, true},
                                     {"std", &FieldStats::std, true},
                                     {"q01", &FieldStats::q01, false},
                                     {"q99", &FieldStats::q99, false}};

// Finite values, equal lengths, std >= 0, q01 <= q99; adds what is wrong.
void CheckField(const std::string& key, const FieldStats& field,
                std::vector<std::string>& problems) {
  for (const Statistic& statistic : kStatistics) {
    const std::vector<double>& values = field.*statistic.member;
    const std::string where = absl::StrCat(key, ".", statistic.name);
    if (values.size() != field.dims() && (statistic.required || !values.empty())) {
      problems.push_back(absl::StrCat(where, " has ", values.size(), " values, ", key, ".mean has ",
                                      field.dims()));
    }
    for (size_t i = 0; i < values.size(); ++i) {
      if (!std::isfinite(values[i])) {
        problems.push_back(absl::StrCat(where, "[", i, "] is ", values[i], ", must be finite"));
        break;
      }
      if (statistic.member == &FieldStats::std && values[i] < 0) {
        problems.push_back(absl::StrCat(where, "[", i, "] is ", values[i], ", must be >= 0"));
        break;
      }
    }
  }
  if (field.dims() == 0) problems.push_back(absl::StrCat(key, ".mean is empty"));
  if (field.q01.empty() != field.q99.empty()) {
    problems.push_back(absl::StrCat(key, ": ", field.q01.empty() ? "q99" : "q01",
                                    " stands alone, q01 and q99 belong together"));
  }
  for (size_t i = 0; i < std::min(field.q01.size(), field.q99.size()); ++i) {
    if (field.q99[i] < field.q01[i]) {
      problems.push_back(absl::StrCat(key, ".q99[", i, "] is ", field.q99[i], ", below q01[", i,
                                      "] ", field.q01[i]));
      break;
    }
  }
}

absl::StatusOr<NormStats> Checked(const std::string& file, NormStats stats,
                                  std::vector<std::string> problems) {
  for (const auto& [key, field] : stats.fields) CheckField(key, field, problems);
  RS_RETURN_IF_ERROR(
      ProblemList(file, "its normalisation statistics are not usable", problems, kRemedy));
  stats.source = file;
  return stats;
}

std::vector<double> ReadList(const nlohmann::json& list, const std::string& where,
                             std::vector<std::string>& problems) {
  std::vector<double> values;
  if (!list.is_array() || list.size() > kMaxDims) {
    problems.push_back(absl::StrCat(
        where, " is ", list.is_array() ? absl::StrCat(list.size(), " long") : list.type_name(),
        ", must be a list of at most ", kMaxDims, " numbers"));
    return values;
  }
  for (const nlohmann::json& value : list) {
    if (!value.is_number()) {
      problems.push_back(
          absl::StrCat(where, "[", values.size(), "] is ", value.dump(), ", must be a number"));
      return values;
    }
    values.push_back(value.get<double>());
  }
  return values;
}

FieldStats ReadField(const std::string& key, const nlohmann::json& json,
                     std::vector<std::string>& problems) {
  FieldStats field;
  if (!json.is_object()) {
    problems.push_back(absl::StrCat(key, " is not an object"));
    return field;
  }
  for (const Statistic& statistic : kStatistics) {
    const auto found = json.find(statistic.name);
    if (found == json.end() || found->is_null()) {
      if (statistic.required)
        problems.push_back(absl::StrCat(key, ".", statistic.name, " is missing"));
      continue;
    }
    field.*statistic.member = ReadList(*found, absl::StrCat(key, ".", statistic.name), problems);
  }
  return field;
}

// Where a tensor with statistics belongs: openpi's key and the statistic; nothing for others.
struct Slot {
  std::string key;
  const Statistic* statistic;
};

constexpr const char* kBufferPrefixes[] = {"normalize_inputs.",    "unnormalize_outputs.",
                                           "normalize_targets.",   "unnormalize_inputs.",
                                           "unnormalize_targets.", "normalize_outputs."};

std::optional<Slot> SlotOf(absl::string_view tensor) {
  absl::ConsumePrefix(&tensor, "model.");
  for (const char* prefix : kBufferPrefixes) absl::ConsumePrefix(&tensor, prefix);
  absl::ConsumePrefix(&tensor, "buffer_");
  for (const Statistic& statistic : kStatistics) {
    absl::string_view feature = tensor;
    if (!absl::ConsumeSuffix(&feature, absl::StrCat(".", statistic.name))) continue;
    if (feature == "observation.state" || feature == "observation_state")
      return Slot{"state", &statistic};
    if (feature == "action") return Slot{"actions", &statistic};
  }
  return std::nullopt;
}

// Adds the statistics that `file` holds.
absl::Status Collect(const SafetensorsFile& file, NormStats& stats,
                     std::vector<std::string>& problems) {
  for (const auto& [name, view] : file.tensors()) {
    const std::optional<Slot> slot = SlotOf(name);
    if (!slot) continue;
    if (view.shape.size() != 1 || view.num_elements() > static_cast<int64_t>(kMaxDims)) {
      problems.push_back(
          absl::StrCat("tensor '", name, "' must be a list of at most ", kMaxDims, " numbers"));
      continue;
    }
    RS_ASSIGN_OR_RETURN(std::vector<double> values, file.ReadDoubles(name));
    std::vector<double>& target = stats.fields[slot->key].*slot->statistic->member;
    if (!target.empty() && target != values) {
      problems.push_back(absl::StrCat("tensor '", name, "' contradicts another copy of ", slot->key,
                                      ".", slot->statistic->name));
    }
    target = std::move(values);
  }
  return absl::OkStatus();
}

}  // namespace

bool IsStatisticsBuffer(const std::string& tensor) {
  absl::string_view name = tensor;
  absl::ConsumePrefix(&name, "model.");
  for (const char* prefix : kBufferPrefixes) {
    if (absl::StartsWith(name, prefix)) return true;
  }
  return false;
}

absl::StatusOr<NormStats> ParseNormStats(const std::string& file, const std::string& text) {
  const absl::StatusOr<nlohmann::json> json = ParseJsonObject(text);
  if (!json.ok())
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", json.status().message()));
  const auto root = json->find("norm_stats");
  if (root == json->end() || !root->is_object() || root->empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": 'norm_stats' is not an object with statistics, as openpi writes it. ", kRemedy));
  }
  NormStats stats;
  std::vector<std::string> problems;
  for (const auto& [key, field] : root->items())
    stats.fields[key] = ReadField(key, field, problems);
  if (!problems.empty()) {
    return ProblemList(file, "its normalisation statistics are not usable", problems, kRemedy);
  }
  return Checked(file, std::move(stats), {});
}

absl::StatusOr<NormStats> ReadNormStatsJson(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMaxJsonBytes));
  return ParseNormStats(path, text);
}

absl::StatusOr<NormStats> NormStatsOf(const SafetensorsFile& file) {
  NormStats stats;
  std::vector<std::string> problems;
  RS_RETURN_IF_ERROR(Collect(file, stats, problems));
  return Checked(file.path(), std::move(stats), std::move(problems));
}

absl::StatusOr<NormStats> NormStatsOf(
    const std::vector<std::shared_ptr<const SafetensorsFile>>& shards) {
  NormStats stats;
  std::vector<std::string> problems;
  for (const auto& shard : shards) RS_RETURN_IF_ERROR(Collect(*shard, stats, problems));
  const std::string first = shards.empty() ? "" : shards.front()->path();
  return Checked(first, std::move(stats), std::move(problems));
}

}  // namespace robostress::openpi
