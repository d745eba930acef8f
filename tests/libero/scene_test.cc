// Compiled scenes against the model arrays that LIBERO 8f1084e on robosuite 1.4.0 compiled with MuJoCo 2.2.2.
#include "sim_worker/libero/scene.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "tests/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::HasSubstr;

// One array of the model by its oracle name; `width` values per row.
struct ArrayView {
  const char* name;
  int width;
  std::function<double(const mjModel&, int)> at;
};

#define ARRAY(name, width) \
  { #name, width, [](const mjModel& m, int i) { return static_cast<double>(m.name[i]); } }

const std::vector<ArrayView>& Arrays() {
  static const std::vector<ArrayView>& arrays = *new std::vector<ArrayView>{
      ARRAY(qpos0, 1),           ARRAY(body_mass, 1),        ARRAY(body_inertia, 3),     ARRAY(body_ipos, 3),
      ARRAY(body_iquat, 4),      ARRAY(body_pos, 3),         ARRAY(body_quat, 4),        ARRAY(body_parentid, 1),
      ARRAY(jnt_type, 1),        ARRAY(jnt_qposadr, 1),      ARRAY(jnt_bodyid, 1),       ARRAY(jnt_pos, 3),
      ARRAY(jnt_axis, 3),        ARRAY(jnt_range, 2),        ARRAY(jnt_limited, 1),      ARRAY(jnt_solref, 2),
      ARRAY(jnt_solimp, 5),      ARRAY(dof_damping, 1),      ARRAY(dof_armature, 1),     ARRAY(dof_frictionloss, 1),
      ARRAY(geom_type, 1),       ARRAY(geom_bodyid, 1),      ARRAY(geom_contype, 1),     ARRAY(geom_conaffinity, 1),
      ARRAY(geom_condim, 1),     ARRAY(geom_group, 1),       ARRAY(geom_priority, 1),    ARRAY(geom_size, 3),
      ARRAY(geom_pos, 3),        ARRAY(geom_quat, 4),        ARRAY(geom_friction, 3),    ARRAY(geom_solref, 2),
      ARRAY(geom_solimp, 5),     ARRAY(geom_solmix, 1),      ARRAY(geom_margin, 1),      ARRAY(geom_gap, 1),
      ARRAY(site_type, 1),       ARRAY(site_bodyid, 1),      ARRAY(site_pos, 3),         ARRAY(site_quat, 4),
      ARRAY(site_size, 3),       ARRAY(cam_pos, 3),          ARRAY(cam_quat, 4),         ARRAY(cam_fovy, 1),
      ARRAY(actuator_ctrlrange, 2), ARRAY(actuator_forcerange, 2), ARRAY(actuator_gainprm, mjNGAIN),
      ARRAY(actuator_biasprm, mjNBIAS)};
  return arrays;
}

absl::StatusOr<LiberoScene> Compose(const std::string& suite, int task) {
  absl::StatusOr<LiberoPaths> paths = FindLibero(LiberoTree(), RobosuiteTree());
  if (!paths.ok()) return paths.status();
  absl::StatusOr<std::vector<std::string>> names = LiberoTaskNames(suite);
  if (!names.ok()) return names.status();
  absl::StatusOr<BddlProblem> problem = ReadBddl(absl::StrCat(paths->libero, "/bddl_files/", suite, "/", (*names)[task], ".bddl"));
  if (!problem.ok()) return problem.status();
  return ComposeScene(*paths, *problem);
}

// Largest absolute difference of one array; the rows in `skip` (replaced visual geoms) do not count.
double LargestDifference(const ArrayView& array, const mjModel& model, const std::vector<double>& expected, const std::set<int>& skip) {
  double largest = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (skip.count(static_cast<int>(i) / array.width) > 0) continue;
    largest = std::max(largest, std::abs(array.at(model, static_cast<int>(i)) - expected[i]));
  }
  return largest;
}

void ExpectNames(const mjModel& model, const nlohmann::json& names) {
  for (const auto& [key, type] : {std::pair<const char*, mjtObj>("body", mjOBJ_BODY), {"joint", mjOBJ_JOINT},
                                  {"geom", mjOBJ_GEOM}, {"site", mjOBJ_SITE}, {"actuator", mjOBJ_ACTUATOR}}) {
    if (!names.contains(key)) continue;
    for (size_t i = 0; i < names[key].size(); ++i) {
      const char* name = mj_id2name(&model, type, static_cast<int>(i));
      const std::string expected = names[key][i].is_string() ? names[key][i].get<std::string>() : "";
      EXPECT_EQ(name == nullptr ? "" : name, expected) << key << " " << i;
    }
  }
}

// The originals' arrays are exact here: the same XML numbers go through the same compiler. The bound leaves
// room for the last digit of what Python prints.
constexpr double kExact = 1e-12;

TEST(LiberoSceneTest, CompiledArraysEqualTheOriginalsInEveryOracleTask) {
  SKIP_WITHOUT_SHARED_DATA();
  std::map<std::string, double> largest;
  int compared = 0;
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    for (int task = 0; task < 10; ++task) {
      const std::string stem = absl::StrCat(SharedFolder(), "/oracles/libero/", suite, task < 10 ? "_0" : "_", task);
      if (!std::filesystem::exists(stem + ".safetensors")) continue;
      SCOPED_TRACE(absl::StrCat(suite, " ", task));
      absl::StatusOr<LiberoScene> scene = Compose(suite, task);
      ASSERT_TRUE(scene.ok()) << scene.status();
      const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(stem + ".safetensors");
      ASSERT_TRUE(oracle.ok()) << oracle.status();
      const nlohmann::json facts = nlohmann::json::parse(*ReadFile(stem + ".json"));
      std::vector<FixturePose> poses;
      for (const auto& [fixture, pose] : facts["fixture_pose"].items()) {
        poses.push_back({fixture, pose[0].get<std::array<double, 3>>(), pose[1].get<std::array<double, 4>>()});
      }
      const absl::StatusOr<SharedModel> model = PlaceFixtures(*scene, poses);
      ASSERT_TRUE(model.ok()) << model.status();
      ASSERT_EQ((*model)->nq, facts["nq"].get<int>());
      ASSERT_EQ((*model)->nv, facts["nv"].get<int>());
      ASSERT_EQ((*model)->nbody, facts["nbody"].get<int>());
      ASSERT_EQ((*model)->ngeom, facts["ngeom"].get<int>());
      ASSERT_EQ((*model)->nsite, facts["nsite"].get<int>());
      ExpectNames(**model, facts["names"]);
      const std::set<int> replaced(scene->replaced_geoms.begin(), scene->replaced_geoms.end());
      double task_largest = 0;
      for (const ArrayView& array : Arrays()) {
        const absl::StatusOr<std::vector<double>> expected = oracle->ReadDoubles(absl::StrCat("model.", array.name));
        ASSERT_TRUE(expected.ok()) << expected.status();
        const bool of_mesh = absl::StartsWith(array.name, "geom_size") || absl::StartsWith(array.name, "geom_pos") ||
                             absl::StartsWith(array.name, "geom_quat");
        const double difference = LargestDifference(array, **model, *expected, of_mesh ? replaced : std::set<int>());
        EXPECT_LE(difference, kExact) << array.name;
        largest[array.name] = std::max(largest[array.name], difference);
        task_largest = std::max(task_largest, difference);
      }
      std::printf("%-15s %2d  %-34s nq %2d ngeom %3d  replaced visuals %3zu  largest difference %.3g\n", suite, task,
                  facts["problem"].get<std::string>().c_str(), (*model)->nq, (*model)->ngeom, replaced.size(), task_largest);
      ++compared;
    }
  }
  if (compared == 0) GTEST_SKIP() << "no oracles/libero/*.safetensors in " << SharedFolder();
  std::printf("largest difference per array over %d tasks:\n", compared);
  for (const auto& [name, difference] : largest) std::printf("  %-20s %.3g\n", name.c_str(), difference);
}

}  // namespace
}  // namespace robostress::libero
