#include "sim_worker/libero/catalog.h"

#include <filesystem>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/libero/home.h"
#include "common/libero/own_tasks.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;

constexpr std::array<double, 3> kDefaultFriction = {1, 0.005, 0.0001};
constexpr std::array<double, 4> kAgentQuat = {0.6380177736282349, 0.3048497438430786,
                                              0.30484986305236816, 0.6380177736282349};
constexpr std::array<double, 4> kLowAgentQuat = {0.6182166934013367, 0.3432307541370392,
                                                 0.3432314395904541, 0.6182177066802979};
constexpr CameraPlacement kGalleryView = {
    "galleryview",
    {2.844547668904445, 2.1279684793440667, 3.128616846013882},
    {0.42261379957199097, 0.23374411463737488, 0.41646939516067505, 0.7702690958976746}};
constexpr std::array<double, 4> kPaperQuat = {0.513, 0.353, 0.443, 0.645};
constexpr std::array<double, 4> kFrontQuat = {0.56, 0.43, 0.43, 0.56};
constexpr CameraPlacement kTableAgentView = {
    "agentview", {0.6586131746834771, 0.0, 1.6103500240372423}, kAgentQuat};
constexpr CameraPlacement kTableFrontView = {"frontview", {1.0, 0.0, 1.48}, kFrontQuat};
constexpr CameraPlacement kTablePaperView = {"paperview", {2.1, 0.535, 2.075}, kPaperQuat};
// A robot stands 0.16 m (study: 0.25 m) behind the table's edge. Fixtures are placed 1 cm above the
// table's lower face plus their own bottom offset.
constexpr ProblemClass kProblems[] = {
    {.name = "libero_tabletop_manipulation",
     .workspace = "table",
     .region_marker = "main_table",
     .scene = "scenes/libero_tabletop_base_style.xml",
     .arena_body = "table",
     .has_table = true,
     .table_size = {1.0, 1.2, 0.05},
     .workspace_offset = {0, 0, 0.90},
     .floor_texture = "light-gray-floor-tile.png",
     .wall_texture = "light-gray-plaster.png",
     .table_friction = {0.6, 0.005, 0.0001},
     .robot_base = {-0.16 - 1.0 / 2, 0, 0},
     .mounted = true,
     .fixture_z = 0.01 - 0.05,
     .zone_at_workspace = false,
     .zone_z = 0.02,
     .draws_inset = true,
     .cameras = {{kTableAgentView, kTableFrontView, kGalleryView}}},
    {.name = "libero_kitchen_tabletop_manipulation",
     .workspace = "kitchen_table",
     .region_marker = "kitchen_table",
     .scene = "scenes/libero_kitchen_tabletop_base_style.xml",
     .arena_body = "table",
     .has_table = true,
     .table_size = {1.0, 1.2, 0.05},
     .workspace_offset = {0, 0, 0.90},
     .floor_texture = "gray_ceramic_tile.png",
     .wall_texture = "yellow_linen_wall_texture.png",
     .table_friction = kDefaultFriction,
     .robot_base = {-0.16 - 1.0 / 2, 0, 0},
     .mounted = true,
     .fixture_z = 0.01 - 0.05,
     .zone_at_workspace = true,
     .zone_z = 0.90 + -0.90,
     .cameras = {{kTableAgentView, kTableFrontView, kGalleryView, kTablePaperView}}},
    {.name = "libero_floor_manipulation",
     .workspace = "floor",
     .region_marker = "floor",
     .scene = "scenes/libero_floor_base_style.xml",
     .arena_body = "floor",
     .has_table = false,
     .table_size = {0, 0, 0},
     .workspace_offset = {0, 0, -0.035},
     .floor_texture = "light-gray-floor-tile.png",
     .wall_texture = "light-gray-plaster.png",
     .table_friction = kDefaultFriction,
     .robot_base = {-0.6, 0, 0},
     .mounted = false,
     .fixture_z = -0.025,
     .zone_at_workspace = false,
     .zone_z = 0.02,
     .draws_inset = true,
     .cameras = {{{"agentview", {0.8965773716836134, 5.216182733499864e-07, 0.65}, kLowAgentQuat},
                  {"frontview", {1.0, 0.0, 0.65}, kFrontQuat},
                  kGalleryView}}},
    {.name = "libero_living_room_tabletop_manipulation",
     .workspace = "living_room_table",
     .region_marker = "living_room_table",
     .scene = "scenes/libero_living_room_tabletop_base_style.xml",
     .arena_body = "living_room_table",
     .has_table = false,
     .table_size = {0.70, 1.6, 0.024},
     .workspace_offset = {0, 0, 0.41},
     .floor_texture = "seamless_wood_planks_floor.png",
     .wall_texture = "light-gray-plaster.png",
     .table_friction = kDefaultFriction,
     .robot_base = {-0.16 - 0.70 / 2, 0, 0.42},
     .mounted = false,
     .fixture_z = 0.01 - 0.024,
     .zone_at_workspace = true,
     .zone_z = 0.41,
     .cameras = {{{"agentview", {0.6065773716836134, 0.0, 0.96}, kLowAgentQuat},
                  {"frontview", {1.5, 0.0, 0.9}, kFrontQuat},
                  kGalleryView,
                  {"paperview", {2.1, 0.735, 1.875}, kPaperQuat}}}},
    {.name = "libero_study_tabletop_manipulation",
     .workspace = "study_table",
     .region_marker = "study_table",
     .scene = "scenes/libero_study_base_style.xml",
     .arena_body = "study_table",
     .has_table = false,
     .table_size = {1.0, 1.2, 0.05},
     .workspace_offset = {-0.2, 0, 0.867},
     .floor_texture = "light-gray-floor-tile.png",
     .wall_texture = "light-gray-plaster.png",
     .table_friction = kDefaultFriction,
     .robot_base = {-0.25 - 1.0 / 2, 0, 0},
     .mounted = true,
     .fixture_z = 0.01 - 0.05,
     .zone_at_workspace = true,
     .zone_z = 0.867,
     .cameras = {{{"agentview", {0.4586131746834771, 0.0, 1.6103500240372423}, kAgentQuat},
                  kTableFrontView,
                  kGalleryView,
                  kTablePaperView}}},
};

constexpr Articulation kArticulations[] = {
    {.category = "wooden_cabinet", .open_range = {-0.16, -0.14}, .close_range = {0.0, 0.005}},
    {.category = "white_cabinet", .open_range = {-0.16, -0.14}, .close_range = {0.0, 0.005}},
    {.category = "yellow_cabinet", .open_range = {-0.16, -0.14}, .close_range = {0.0, 0.005}},
    {.category = "microwave", .open_range = {-2.094, -1.3}, .close_range = {-0.005, 0.0}},
    {.category = "short_cabinet",
     .open_below = false,
     .open_range = {0.10, 0.16},
     .close_range = {-0.005, 0.0}},
    {.category = "short_fridge",
     .open_below = false,
     .open_range = {2.0, 2.7},
     .close_range = {-0.005, 0.0}},
    {.category = "flat_stove",
     .has_switch = true,
     .on_range = {0.5, 2.1},
     .off_range = {-0.005, 0.0}},
    {.category = "yellow_stove",
     .has_switch = true,
     .on_range = {0.5, 2.1},
     .off_range = {-0.005, 0.0}},
};

constexpr double kQuarterTurn = std::numbers::pi / 2;
constexpr PlacementRotation::Turn kQuarterX = {'x', kQuarterTurn, kQuarterTurn};
constexpr PlacementRotation::Turn kQuarterZ = {'z', kQuarterTurn, kQuarterTurn};
constexpr PlacementRotation::Turn kUnturned = {'x', 0, 0};
constexpr PlacementRotation::Turn kUnturnedY = {'y', 0, 0};
constexpr PlacementRotation::Turn kBackQuarterX = {'x', -kQuarterTurn, -kQuarterTurn};
constexpr PlacementRotation::Turn kHalfY = {'y', -std::numbers::pi, -std::numbers::pi};
constexpr PlacementRotation::Turn kHalfZ = {'z', std::numbers::pi, std::numbers::pi};
constexpr PlacementRotation::Turn kBookX = {'x', -kQuarterTurn, -std::numbers::pi / 4};
// The folders' rules are those of the base classes (HopeBaseObject and its siblings).
constexpr PlacementRotation kRotations[] = {
    {"articulated_objects", {{{'x', std::numbers::pi / 4, kQuarterTurn}}}},
    {"stable_hope_objects", {{kQuarterX}}},
    {"stable_scanned_objects", {{kQuarterX}}},
    {"turbosquid_objects", {{kUnturned}}},
    {"alphabet_soup", {{kQuarterZ}}},
    {"bigger_alphabet_soup", {{kQuarterZ}}},
    {"bigger_milk", {{kQuarterZ}}},
    {"black_book", {{kBookX}}},
    {"blue_ketchup", {{kQuarterZ}}},
    {"butter", {{kUnturned}}},
    {"chocolate_pudding", {{kUnturned}}},
    {"cream_cheese", {{kUnturned}}},
    {"flat_stove", {{kUnturnedY}}},
    {"green_butter", {{kUnturned}}},
    {"green_chocolate_pudding", {{kUnturned}}},
    {"green_ketchup", {{kQuarterX, kQuarterZ}}},
    {"ketchup", {{kQuarterX, kQuarterZ}}},
    {"libero_mug_yellow", {{kBackQuarterX, kHalfY, kHalfZ}}},
    {"macaroni_and_cheese", {{kQuarterX, kQuarterZ}}},
    {"mayo", {{kQuarterX, kQuarterZ}}},
    {"milk", {{kQuarterX, kQuarterZ}}},
    {"new_salad_dressing", {{kQuarterX, kQuarterZ}}},
    {"orange_juice", {{kQuarterX, kQuarterZ}}},
    {"popcorn", {{kUnturned}}},
    {"porcelain_mug", {{kBackQuarterX}}},
    {"rack", {{kUnturned}}},
    {"red_alphabet_soup", {{kQuarterZ}}},
    {"red_coffee_mug", {{kBackQuarterX}}},
    {"red_cream_cheese", {{kUnturned}}},
    {"red_orange_juice", {{kQuarterX, kQuarterZ}}},
    {"red_salad_dressing", {{kQuarterX, kQuarterZ}}},
    {"red_yellow_book", {{kBackQuarterX}}},
    {"salad_dressing", {{kQuarterX, kQuarterZ}}},
    {"tomato_sauce", {{kQuarterZ}}},
    {"white_porcelain_mug", {{kBackQuarterX}}},
    {"white_storage_box", {{kUnturnedY}}},
    {"white_yellow_mug", {{kBackQuarterX}}},
    {"yellow_book", {{kBookX}}},
    {"yellow_milk", {{kQuarterZ}}},
    {"yellow_stove", {{kUnturnedY}}},
    {"yellow_tomato_sauce", {{kQuarterZ}}},
};

// Where a root was given, as the user wrote it.
std::string Origin(const std::string& root, const char* variable, const char* option) {
  const char* set = std::getenv(variable);
  return set != nullptr && set == root ? absl::StrCat("the variable ", variable, "=", root)
                                       : absl::StrCat(option, " ", root);
}

absl::Status LinkGone(const std::string& root, const std::string& what) {
  return absl::NotFoundError(absl::StrCat(
      root, ": what `robostress libero setup` linked is gone (no ", what, "); run it again"));
}

// The folder that holds `marker`: root itself or one of the candidates below it.
absl::StatusOr<std::string> FindRoot(const std::string& given, const char* variable,
                                     const char* option, const std::vector<std::string>& candidates,
                                     const std::string& marker, const char* what) {
  const std::string root = LiberoRoot(given, variable);
  if (root.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("LIBERO's suites read ", what,
                                                   ": run `robostress libero setup`, give ", option,
                                                   " DIR or set ", variable));
  }
  std::error_code ignored;
  for (const std::string& candidate : candidates) {
    const fs::path path = fs::path(root) / candidate;
    if (fs::exists(path / marker, ignored))
      return fs::absolute(path, ignored).lexically_normal().string();
  }
  if (root == RememberedLibero())
    return LinkGone(root, absl::StrCat(candidates.front(), "/", marker));
  return absl::NotFoundError(absl::StrCat(Origin(root, variable, option), ": no ",
                                          candidates.front(), "/", marker, " below it; expected ",
                                          what));
}

}  // namespace

absl::StatusOr<LiberoPaths> FindLibero(const std::string& libero_root,
                                       const std::string& robosuite_root) {
  LiberoPaths paths;
  RS_ASSIGN_OR_RETURN(
      paths.libero, FindRoot(libero_root, "LIBERO_ROOT", "--libero-root",
                             {"libero/libero", "libero", "."}, "bddl_files", "a LIBERO checkout"));
  std::error_code ignored;
  if (!fs::exists(paths.libero + "/assets", ignored)) {
    const std::string root = LiberoRoot(libero_root, "LIBERO_ROOT");
    if (root == RememberedLibero()) return LinkGone(root, "libero/libero/assets");
    return absl::NotFoundError(absl::StrCat(
        Origin(root, "LIBERO_ROOT", "--libero-root"), ": no assets beside bddl_files in ",
        paths.libero,
        "; a LIBERO installed from PyPI keeps them elsewhere: `robostress libero setup` finds and "
        "links them, and without that option or variable they are used"));
  }
  RS_ASSIGN_OR_RETURN(paths.robosuite,
                      FindRoot(robosuite_root, "ROBOSUITE_ROOT", "--robosuite-root",
                               {"robosuite/models/assets", "models/assets", "."}, "base.xml",
                               "a robosuite 1.4 checkout"));
  return paths;
}

std::vector<std::string> LiberoSuites() {
  std::vector<std::string> names;
  for (const LiberosOwnSuite& entry : LiberosOwnSuites()) names.emplace_back(entry.suite);
  return names;
}

absl::StatusOr<std::vector<std::string>> LiberoTaskNames(const std::string& suite) {
  for (const LiberosOwnSuite& entry : LiberosOwnSuites()) {
    if (entry.suite == suite)
      return std::vector<std::string>(entry.tasks.begin(), entry.tasks.end());
  }
  return absl::NotFoundError(absl::StrCat(
      "'", suite, "' is not a LIBERO suite; known: ", absl::StrJoin(LiberoSuites(), ", ")));
}

std::string LiberoInstruction(const std::string& task_name) {
  std::string words = task_name;
  const size_t scene = task_name.find("SCENE");
  if (!task_name.empty() && task_name[0] >= 'A' && task_name[0] <= 'Z' &&
      scene != std::string::npos) {
    words = task_name.substr(task_name.find('_', scene) + 1);
  }
  return absl::StrReplaceAll(words, {{"_", " "}});
}

absl::StatusOr<ProblemClass> FindProblemClass(const std::string& name) {
  std::vector<std::string> known;
  for (const ProblemClass& problem : kProblems) {
    if (problem.name == name) return problem;
    known.emplace_back(problem.name);
  }
  return absl::NotFoundError(
      absl::StrCat("problem class '", name, "' is unknown; known: ", absl::StrJoin(known, ", ")));
}

const Articulation* FindArticulation(const std::string& category) {
  for (const Articulation& articulation : kArticulations) {
    if (articulation.category == category) return &articulation;
  }
  return nullptr;
}

absl::StatusOr<PlacementRotation> FindPlacementRotation(const std::string& category,
                                                        const std::string& object_file) {
  for (const PlacementRotation& rotation : kRotations) {
    if (rotation.name == category) return rotation;
  }
  for (const fs::path& folder : fs::path(object_file)) {
    for (const PlacementRotation& rotation : kRotations) {
      if (rotation.name == folder.string()) return rotation;
    }
  }
  return absl::NotFoundError(
      absl::StrCat("no rule for the rotation of category '", category, "' in ", object_file));
}

absl::StatusOr<std::string> FindObjectFile(const LiberoPaths& paths, const std::string& category) {
  const std::string file = category == "rack" ? "simple_rack" : category;
  const std::string assets = paths.libero + "/assets/";
  const std::string articulated = absl::StrCat(assets, "articulated_objects/", file, ".xml");
  std::error_code ignored;
  if (fs::exists(articulated, ignored)) return articulated;
  constexpr std::string_view kFolders[] = {"stable_scanned_objects", "stable_hope_objects",
                                           "turbosquid_objects", "custom_objects"};
  for (const std::string_view folder : kFolders) {
    std::string path = absl::StrCat(assets, std::string(folder), "/", file, "/", file, ".xml");
    if (fs::exists(path, ignored)) return path;
    if (fs::is_directory(fs::path(path).parent_path(), ignored))
      return absl::NotFoundError(absl::StrCat("category '", category, "': no file ", path));
  }
  return absl::NotFoundError(absl::StrCat(
      "no object or fixture of category '", category, "': ", paths.libero, "/assets has neither ",
      "articulated_objects/", file, ".xml nor a folder ", file, " in stable_scanned_objects, ",
      "stable_hope_objects, turbosquid_objects or custom_objects"));
}

}  // namespace robostress::libero
