#include "sim_worker/libero/fixture_table.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

using nlohmann::json;

// Of a quaternion's norm from 1: room for numbers written with six digits.
constexpr double kNormTolerance = 1e-5;

absl::Status Error(const std::string& where, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(where, ": ", what));
}

absl::StatusOr<json> ParseFile(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  try {
    return json::parse(text);
  } catch (const json::exception& error) {
    return Error(file, absl::StrCat("not JSON: ", error.what()));
  }
}

template <size_t N>
absl::Status ReadArray(const std::string& where, const json& pose, const char* key,
                       std::array<double, N>& values) {
  const auto array = pose.find(key);
  const auto is_number = [](const json& element) {
    return element.is_number() && std::isfinite(element.get<double>());
  };
  if (array == pose.end() || !array->is_array() || array->size() != N ||
      !std::all_of(array->begin(), array->end(), is_number)) {
    return Error(where, absl::StrCat("\"", key, "\" must be ", N, " numbers, ",
                                     N == 3 ? "x y z [m] in the world" : "w x y z"));
  }
  for (size_t i = 0; i < N; ++i) values[i] = (*array)[i].get<double>();
  return absl::OkStatus();
}

absl::StatusOr<FixturePose> ReadPose(const std::string& where, const std::string& fixture,
                                     const json& entry) {
  if (!entry.is_object())
    return Error(where, "must be an object with \"pos\" [3] and \"quat\" [4]");
  FixturePose pose;
  pose.fixture = fixture;
  RS_RETURN_IF_ERROR(ReadArray(where, entry, "pos", pose.pos));
  RS_RETURN_IF_ERROR(ReadArray(where, entry, "quat", pose.quat));
  const auto& [w, x, y, z] = pose.quat;
  const double norm = std::sqrt(w * w + x * x + y * y + z * z);
  if (std::abs(norm - 1) > kNormTolerance)
    return Error(where, absl::StrCat("\"quat\" has norm ", norm, ", must be 1"));
  return pose;
}

absl::StatusOr<std::vector<FixturePose>> ReadEpisode(const std::string& where, const json& entry,
                                                     const std::vector<std::string>& fixtures) {
  if (!entry.is_object()) return Error(where, "must be an object of fixtures");
  for (const auto& [name, pose] : entry.items()) {
    if (std::find(fixtures.begin(), fixtures.end(), name) == fixtures.end()) {
      return Error(where, absl::StrCat("'", name, "' is not a fixture of this task; it has ",
                                       absl::StrJoin(fixtures, ", ")));
    }
  }
  std::vector<FixturePose> poses;
  for (const std::string& fixture : fixtures) {
    const auto pose = entry.find(fixture);
    if (pose == entry.end())
      return Error(where, absl::StrCat("no pose for fixture '", fixture, "'; add it"));
    RS_ASSIGN_OR_RETURN(poses.emplace_back(),
                        ReadPose(absl::StrCat(where, ", fixture '", fixture, "'"), fixture, *pose));
  }
  return poses;
}

}  // namespace

absl::StatusOr<FixtureTable> ReadFixtureTable(const std::string& file, const std::string& task,
                                              const LiberoScene& scene) {
  RS_ASSIGN_OR_RETURN(const json table, ParseFile(file));
  if (!table.is_object()) return Error(file, "must be an object of tasks");
  std::vector<std::string> fixtures, tasks;
  for (const FixturePose& pose : scene.centred_fixtures) fixtures.push_back(pose.fixture);
  for (const auto& [name, entry] : table.items()) tasks.push_back(name);
  const auto found = table.find(task);
  if (found == table.end()) {
    if (fixtures.empty()) return FixtureTable();
    return Error(file, absl::StrCat("no task '", task, "'; it has ", absl::StrJoin(tasks, ", "),
                                    "; add one, or leave it out with --tasks"));
  }
  const std::string where = absl::StrCat(file, ": task '", task, "'");
  if (!found->is_object()) return Error(where, "must be an object of initial states");
  FixtureTable result;
  for (const auto& [index, entry] : found->items()) {
    int initial_state = -1;
    if (!absl::SimpleAtoi(index, &initial_state) || initial_state < 0) {
      return Error(where, absl::StrCat("'", index, "' is not the index of an initial state, 0 on"));
    }
    RS_ASSIGN_OR_RETURN(
        result[initial_state],
        ReadEpisode(absl::StrCat(where, ", initial state ", initial_state), entry, fixtures));
  }
  return result;
}

}  // namespace robostress::libero
