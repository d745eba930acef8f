#include "tests/floors/include_floors.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <regex>
#include <set>

namespace robostress {
namespace {

enum Library : unsigned { kTorch = 1, kMujoco = 2, kRpc = 4 };

// What the files of one folder may include; the longest prefix decides.
struct Floor {
  const char* folder;
  std::vector<const char*>
      may_include;     // prefixes; the longest known folder of the included file must be among them
  unsigned libraries;  // that it may reach, directly or through others
};

// DESIGN's table. A folder of its own in this list is not covered by its parent's permission:
// "common/" does not include "common/rpc/".
const std::vector<Floor>& Floors() {
  static const auto& floors = *new std::vector<Floor>{
      {"common/", {"common/"}, 0},
      {"common/rpc/", {"common/", "common/rpc/", "proto/"}, kRpc},
      // openpi's "session" names a method.
      {"common/wire/", {"common/", "common/wire/"}, 0},
      // A unit names a method; the programs that play units stand above.
      {"common/unit/", {"common/", "common/unit/", "adapter/"}, 0},
      {"adapter/", {"adapter/", "common/"}, kTorch},
      // Nothing but the C and C++ runtimes may come with the library.
      {"python/", {"python/", "adapter/", "common/"}, 0},
      {"sim_worker/", {"sim_worker/", "adapter/", "common/"}, kMujoco},
      // Where a stream is opened.
      {"sim_worker/worker/",
       {"sim_worker/", "sim_worker/worker/", "adapter/", "common/", "common/unit/", "common/rpc/",
        "common/wire/"},
       kMujoco | kRpc},
      {"sim_worker/environment/",
       {"sim_worker/", "sim_worker/environment/", "adapter/", "common/", "common/unit/"},
       kMujoco},
      {"sim_worker/record/",
       {"sim_worker/", "sim_worker/record/", "adapter/", "common/", "common/unit/", "common/rpc/"},
       kMujoco | kRpc},
      {"robot_client/",
       {"robot_client/", "adapter/", "common/", "common/unit/", "common/rpc/"},
       kRpc},
      {"robot_client/emulator/",
       {"robot_client/", "robot_client/emulator/", "adapter/", "common/", "common/unit/",
        "common/rpc/"},
       kMujoco | kRpc},
      // Stands on the emulator, which knows nothing of it.
      {"robot_client/study/",
       {"robot_client/", "robot_client/emulator/", "robot_client/study/", "adapter/", "common/",
        "common/unit/", "common/rpc/"},
       kMujoco | kRpc},
      {"server/policies/", {"server/policies/", "adapter/", "common/"}, kTorch},
      {"server/training/",
       {"server/training/", "server/policies/", "server/inference/", "adapter/", "common/"},
       kTorch},
      {"server/operations/", {"server/operations/", "adapter/", "common/", "common/wire/"}, 0},
      {"server/inference/",
       {"server/inference/", "server/operations/", "server/policies/", "adapter/", "common/"},
       kTorch},
      {"server/sessions/",
       {"server/sessions/", "server/inference/", "server/operations/", "server/policies/",
        "adapter/", "common/", "common/rpc/", "proto/"},
       kTorch | kRpc},
      // A session's host is an interface.
      {"server/wire/",
       {"server/wire/", "server/sessions/", "server/operations/", "adapter/", "common/",
        "common/wire/"},
       0},
      // The service's base class is generated; its handlers convert and call.
      {"server/wire/grpc/",
       {"server/wire/grpc/", "server/wire/", "server/sessions/", "server/inference/",
        "server/operations/", "server/policies/", "adapter/", "common/", "common/rpc/",
        "common/wire/", "proto/"},
       kTorch | kRpc},
      {"server/pages/",
       {"server/pages/", "server/wire/", "server/operations/", "adapter/", "common/"},
       0},
      // Between a client and another's server: no session, no policy.
      {"server/proxy/",
       {"server/proxy/", "server/wire/", "server/operations/", "adapter/", "common/",
        "common/wire/"},
       0},
      {"server/",
       {"server/", "server/proxy/", "server/wire/", "server/wire/grpc/", "server/pages/",
        "server/sessions/", "server/inference/", "server/operations/", "server/policies/",
        "adapter/", "common/", "common/rpc/", "common/wire/", "proto/"},
       kTorch | kRpc},
      // The emulator for the Piper's model.
      {"calibration/data/",
       {"calibration/data/", "sim_worker/", "robot_client/emulator/", "common/"},
       kMujoco},
      {"calibration/model/", {"calibration/model/", "calibration/data/", "common/"}, kMujoco},
      {"calibration/search/",
       {"calibration/search/", "calibration/model/", "calibration/data/", "common/"},
       kMujoco},
      {"calibration/report/",
       {"calibration/report/", "calibration/search/", "calibration/model/", "calibration/data/",
        "common/"},
       kMujoco},
      {"calibration/excite/",
       {"calibration/excite/", "calibration/search/", "calibration/model/", "calibration/data/",
        "sim_worker/", "common/"},
       kMujoco},
      {"calibration/fidelity/",
       {"calibration/fidelity/", "calibration/report/", "calibration/search/", "calibration/model/",
        "calibration/data/", "calibration/", "sim_worker/", "common/"},
       kMujoco},
      {"calibration/",
       {"calibration/", "calibration/excite/", "calibration/report/", "calibration/search/",
        "calibration/model/", "calibration/data/", "sim_worker/", "common/"},
       kMujoco},
      // Its rooms stand on one another; the programs above them may use all.
      {"eval/plan/", {"eval/plan/", "adapter/", "common/", "common/unit/", "common/wire/"}, 0},
      {"eval/store/", {"eval/store/", "eval/plan/", "adapter/", "common/", "common/unit/"}, 0},
      {"eval/statistics/",
       {"eval/statistics/", "eval/store/", "eval/plan/", "adapter/", "common/", "common/unit/"},
       0},
      {"eval/report/",
       {"eval/report/", "eval/statistics/", "eval/store/", "eval/plan/", "adapter/", "common/",
        "common/unit/"},
       0},
      {"eval/launch/",
       {"eval/launch/", "eval/report/", "eval/store/", "eval/plan/", "adapter/", "common/",
        "common/unit/", "common/wire/"},
       0},
      {"eval/manual/", {"eval/manual/", "eval/launch/", "adapter/", "common/", "common/unit/"}, 0},
      {"eval/export/",
       {"eval/export/", "eval/store/", "eval/plan/", "adapter/", "common/", "common/unit/"},
       0},
      {"eval/paper/",
       {"eval/paper/", "eval/report/", "eval/statistics/", "eval/store/", "eval/plan/", "adapter/",
        "common/", "common/unit/"},
       0},
      {"eval/piper_study/",
       {"eval/piper_study/", "eval/paper/", "eval/launch/", "eval/report/", "eval/store/",
        "eval/plan/", "adapter/", "common/", "common/unit/"},
       0},
      {"eval/close_loop/",
       {"eval/close_loop/", "eval/launch/", "eval/plan/", "calibration/", "calibration/data/",
        "calibration/model/", "calibration/fidelity/", "adapter/", "common/", "common/unit/"},
       0},
      {"eval/",
       {"eval/", "eval/plan/", "eval/store/", "eval/statistics/", "eval/report/", "eval/launch/",
        "eval/export/", "eval/paper/", "eval/piper_study/", "eval/close_loop/", "adapter/",
        "common/", "common/unit/"},
       0},
      {"tests/",
       {"tests/",
        "eval/",
        "eval/plan/",
        "eval/store/",
        "eval/statistics/",
        "eval/report/",
        "eval/launch/",
        "eval/export/",
        "eval/paper/",
        "eval/piper_study/",
        "eval/close_loop/",
        "calibration/",
        "calibration/data/",
        "calibration/model/",
        "calibration/search/",
        "calibration/report/",
        "calibration/fidelity/",
        "calibration/excite/",
        "server/",
        "server/policies/",
        "server/training/",
        "server/operations/",
        "server/inference/",
        "server/sessions/",
        "server/wire/",
        "server/wire/grpc/",
        "server/pages/",
        "server/proxy/",
        "robot_client/",
        "robot_client/emulator/",
        "robot_client/study/",
        "sim_worker/",
        "sim_worker/environment/",
        "sim_worker/worker/",
        "sim_worker/record/",
        "adapter/",
        "common/",
        "common/rpc/",
        "common/unit/",
        "common/wire/",
        "proto/"},
       kTorch | kMujoco | kRpc},
      {"proto/", {}, kRpc}};
  return floors;
}

const Floor* FloorOf(const std::string& path) {
  const Floor* best = nullptr;
  for (const Floor& floor : Floors()) {
    const std::string folder = floor.folder;
    if (path.rfind(folder, 0) == 0 &&
        (best == nullptr || folder.size() > std::string(best->folder).size()))
      best = &floor;
  }
  return best;
}

std::optional<Library> LibraryOf(const std::string& include) {
  static const auto& prefixes = *new std::vector<std::pair<std::string, Library>>{
      {"torch/", kTorch}, {"ATen/", kTorch}, {"c10/", kTorch},          {"mujoco/", kMujoco},
      {"grpcpp/", kRpc},  {"grpc/", kRpc},   {"google/protobuf/", kRpc}};
  const std::string name = include.front() == '<' ? include.substr(1) : include;
  for (const auto& [prefix, library] : prefixes) {
    if (name.rfind(prefix, 0) == 0) return library;
  }
  return std::nullopt;
}

const char* NameOf(Library library) {
  switch (library) {
    case kTorch:
      return "LibTorch";
    case kMujoco:
      return "MuJoCo";
    case kRpc:
      return "gRPC or protobuf";
  }
  return "";
}

// Reports libraries that `file` must not know but reaches through its includes, with the way there.
void CheckReach(const IncludeGraph& graph, const std::string& file, unsigned allowed,
                std::vector<std::string>& complaints) {
  std::set<std::string> visited = {file};
  std::vector<std::pair<std::string, std::string>> open = {{file, file}};  // node, way
  unsigned reported = 0;
  while (!open.empty()) {
    const auto [node, way] = open.back();
    open.pop_back();
    const auto includes = graph.find(node);
    if (includes == graph.end()) continue;
    for (const std::string& include : includes->second) {
      const std::optional<Library> library = LibraryOf(include);
      if (library && (allowed & *library) == 0 && (reported & *library) == 0) {
        reported |= *library;
        complaints.push_back(file + " must not know " + NameOf(*library) + ", but " + way + " -> " +
                             include);
      }
      if (visited.insert(include).second) open.emplace_back(include, way + " -> " + include);
    }
  }
}

void CheckInclude(const IncludeGraph& graph, const std::string& file, const Floor& floor,
                  const std::string& include, std::vector<std::string>& complaints) {
  if (include.front() == '<' || LibraryOf(include)) return;
  const Floor* target = FloorOf(include);
  if (target == nullptr) {
    // A library's header in quotes is fine; a file of ours must be named from the root.
    const std::string beside =
        (std::filesystem::path(file).parent_path() / include).lexically_normal().string();
    if (graph.count(beside) != 0)
      complaints.push_back(file + " includes \"" + include +
                           "\", which must be named from the repository root: \"" + beside + "\"");
    return;
  }
  const bool allowed =
      std::any_of(floor.may_include.begin(), floor.may_include.end(),
                  [&](const char* folder) { return std::string(folder) == target->folder; });
  if (!allowed)
    complaints.push_back(file + " includes \"" + include + "\": " + floor.folder +
                         " may not include " + target->folder);
}

}  // namespace

std::vector<std::string> IncludesOf(const std::string& text) {
  static const auto& pattern = *new std::regex(
      R"re(^[ \t]*#[ \t]*include[ \t]*(?:"([^"]+)"|(<[^>]+)>))re", std::regex::multiline);
  std::vector<std::string> includes;
  for (std::sregex_iterator match(text.begin(), text.end(), pattern), end; match != end; ++match) {
    includes.push_back((*match)[1].matched ? (*match)[1].str() : (*match)[2].str());
  }
  return includes;
}

IncludeGraph ReadTree(const std::string& root) {
  IncludeGraph graph;
  for (const Floor& floor : Floors()) {
    const std::filesystem::path folder = std::filesystem::path(root) / floor.folder;
    if (!std::filesystem::is_directory(folder)) continue;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".h" && extension != ".cc") continue;
      std::ifstream file(entry.path());
      const std::string text((std::istreambuf_iterator<char>(file)),
                             std::istreambuf_iterator<char>());
      graph[std::filesystem::relative(entry.path(), root).string()] = IncludesOf(text);
    }
  }
  return graph;
}

std::vector<std::string> CheckFloors(const IncludeGraph& graph) {
  std::vector<std::string> complaints;
  for (const auto& [file, includes] : graph) {
    const Floor* floor = FloorOf(file);
    if (floor == nullptr) continue;
    for (const std::string& include : includes) {
      if (include.find("../") != std::string::npos || include.rfind("./", 0) == 0) {
        complaints.push_back(file + " includes \"" + include +
                             "\", which must be named from the repository root");
        continue;
      }
      CheckInclude(graph, file, *floor, include, complaints);
    }
    CheckReach(graph, file, floor->libraries, complaints);
  }
  return complaints;
}

}  // namespace robostress
