// All 40 tasks compile and reset; where a reference exists, the compiled arrays equal those that
// LIBERO 8f1084e on robosuite 1.4.0 compiled with MuJoCo 2.2.2.
#include "sim_worker/libero/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

// One array of the model by its oracle name; `width` values per row.
struct ArrayView {
  const char* name;
  int width;
  std::function<double(const mjModel&, int)> at;
};

#define ARRAY(name, width)                                                               \
  {                                                                                      \
#name, width, [](const mjModel& m, int i) { return static_cast<double>(m.name[i]); } \
  }

const std::vector<ArrayView>& Arrays() {
  static const std::vector<ArrayView>& arrays =
      *new std::vector<ArrayView>{ARRAY(qpos0, 1),
                                  ARRAY(body_mass, 1),
                                  ARRAY(body_inertia, 3),
                                  ARRAY(body_ipos, 3),
                                  ARRAY(body_iquat, 4),
                                  ARRAY(body_pos, 3),
                                  ARRAY(body_quat, 4),
                                  ARRAY(body_parentid, 1),
                                  ARRAY(jnt_type, 1),
                                  ARRAY(jnt_qposadr, 1),
                                  ARRAY(jnt_bodyid, 1),
                                  ARRAY(jnt_pos, 3),
                                  ARRAY(jnt_axis, 3),
                                  ARRAY(jnt_range, 2),
                                  ARRAY(jnt_limited, 1),
                                  ARRAY(jnt_solref, 2),
                                  ARRAY(jnt_solimp, 5),
                                  ARRAY(dof_damping, 1),
                                  ARRAY(dof_armature, 1),
                                  ARRAY(dof_frictionloss, 1),
                                  ARRAY(geom_type, 1),
                                  ARRAY(geom_bodyid, 1),
                                  ARRAY(geom_contype, 1),
                                  ARRAY(geom_conaffinity, 1),
                                  ARRAY(geom_condim, 1),
                                  ARRAY(geom_group, 1),
                                  ARRAY(geom_priority, 1),
                                  ARRAY(geom_size, 3),
                                  ARRAY(geom_pos, 3),
                                  ARRAY(geom_quat, 4),
                                  ARRAY(geom_friction, 3),
                                  ARRAY(geom_solref, 2),
                                  ARRAY(geom_solimp, 5),
                                  ARRAY(geom_solmix, 1),
                                  ARRAY(geom_margin, 1),
                                  ARRAY(geom_gap, 1),
                                  ARRAY(site_type, 1),
                                  ARRAY(site_bodyid, 1),
                                  ARRAY(site_pos, 3),
                                  ARRAY(site_quat, 4),
                                  ARRAY(site_size, 3),
                                  ARRAY(cam_pos, 3),
                                  ARRAY(cam_quat, 4),
                                  ARRAY(cam_fovy, 1),
                                  ARRAY(actuator_ctrlrange, 2),
                                  ARRAY(actuator_forcerange, 2),
                                  ARRAY(actuator_gainprm, mjNGAIN),
                                  ARRAY(actuator_biasprm, mjNBIAS)};
  return arrays;
}

// Largest absolute difference of one array; the rows in `skip` (replaced visual geoms) do not
// count.
double LargestDifference(const ArrayView& array, const mjModel& model,
                         const std::vector<double>& expected, const std::set<int>& skip) {
  double largest = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (skip.count(static_cast<int>(i) / array.width) > 0) continue;
    largest = std::max(largest, std::abs(array.at(model, static_cast<int>(i)) - expected[i]));
  }
  return largest;
}

void ExpectNames(const mjModel& model, const nlohmann::json& names) {
  for (const auto& [key, type] : {std::pair<const char*, mjtObj>("body", mjOBJ_BODY),
                                  {"joint", mjOBJ_JOINT},
                                  {"geom", mjOBJ_GEOM},
                                  {"site", mjOBJ_SITE},
                                  {"actuator", mjOBJ_ACTUATOR}}) {
    if (!names.contains(key)) continue;
    for (size_t i = 0; i < names[key].size(); ++i) {
      const char* name = mj_id2name(&model, type, static_cast<int>(i));
      const std::string expected =
          names[key][i].is_string() ? names[key][i].get<std::string>() : "";
      EXPECT_EQ(name == nullptr ? "" : name, expected) << key << " " << i;
    }
  }
}

void ExpectTexturesOnlyWhereShown(const LiberoScene& scene, const mjModel& placed) {
  const mjModel& composed = *scene.model;
  EXPECT_GT(composed.ntexdata, 0);
  EXPECT_EQ(placed.ntexdata, 0);
  const auto shown = MakeRenderModel(scene, placed);
  ASSERT_TRUE(shown.ok()) << shown.status();
  ASSERT_EQ((*shown)->ntexdata, composed.ntexdata);
  EXPECT_TRUE(
      std::equal(composed.tex_rgb, composed.tex_rgb + composed.ntexdata, (*shown)->tex_rgb));
  EXPECT_TRUE(std::equal(composed.names, composed.names + composed.nnames, (*shown)->names));
}

// The originals' arrays are exact here: the same XML numbers go through the same compiler. The
// bound leaves room for the last digit of what Python prints.
constexpr double kExact = 1e-12;

// Compares with the oracle at `stem`; returns the largest difference and collects it per array.
double CompareWithOracle(const LiberoScene& scene, const std::string& stem,
                         std::map<std::string, double>& largest) {
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(stem + ".safetensors");
  EXPECT_TRUE(oracle.ok()) << oracle.status();
  if (!oracle.ok()) return INFINITY;
  const nlohmann::json facts = nlohmann::json::parse(*ReadFile(stem + ".json"));
  std::vector<FixturePose> poses;
  for (const auto& [fixture, pose] : facts["fixture_pose"].items()) {
    poses.push_back(
        {fixture, pose[0].get<std::array<double, 3>>(), pose[1].get<std::array<double, 4>>()});
  }
  const absl::StatusOr<SharedModel> model = PlaceFixtures(scene, poses);
  EXPECT_TRUE(model.ok()) << model.status();
  if (!model.ok()) return INFINITY;
  const mjModel& m = **model;
  ExpectTexturesOnlyWhereShown(scene, m);
  const std::vector<int> sizes = {m.nq, m.nv, m.nbody, m.ngeom, m.njnt, m.nsite};
  const std::vector<int> expected_sizes = {facts["nq"],    facts["nv"],   facts["nbody"],
                                           facts["ngeom"], facts["njnt"], facts["nsite"]};
  EXPECT_EQ(sizes, expected_sizes);
  if (sizes != expected_sizes) return INFINITY;
  ExpectNames(m, facts["names"]);
  const std::set<int> replaced(scene.replaced_geoms.begin(), scene.replaced_geoms.end());
  double task_largest = 0;
  for (const ArrayView& array : Arrays()) {
    const absl::StatusOr<std::vector<double>> expected =
        oracle->ReadDoubles(absl::StrCat("model.", array.name));
    EXPECT_TRUE(expected.ok()) << expected.status();
    if (!expected.ok()) continue;
    const std::string name = array.name;
    const bool of_mesh = name == "geom_size" || name == "geom_pos" || name == "geom_quat";
    const double difference =
        LargestDifference(array, m, *expected, of_mesh ? replaced : std::set<int>());
    EXPECT_LE(difference, kExact) << name;
    largest[name] = std::max(largest[name], difference);
    task_largest = std::max(task_largest, difference);
  }
  return task_largest;
}

TEST(LiberoSceneTest, All40TasksCompileAndResetAndEqualTheOriginalsArrays) {
  SKIP_WITHOUT_SHARED_DATA();
  std::map<std::string, double> largest;
  int compared = 0;
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    for (int task = 0; task < 10; ++task) {
      SCOPED_TRACE(absl::StrCat(suite, " ", task));
      UnitConfig unit;
      unit.suite = suite;
      unit.libero_root = LiberoTree();
      unit.robosuite_root = RobosuiteTree();
      const absl::StatusOr<std::unique_ptr<LiberoSimTask>> sim_task =
          LiberoSimTask::Create(unit, task);
      ASSERT_TRUE(sim_task.ok()) << sim_task.status();
      const LiberoScene& scene = (*sim_task)->scene();
      const absl::Status reset = (*sim_task)->Reset(0);
      EXPECT_TRUE(reset.ok()) << reset;
      EXPECT_FALSE((*sim_task)->goal().Holds((*sim_task)->sim().data()))
          << "solved before it starts";
      const std::string stem = absl::StrCat(SharedFolder(), "/oracles/libero/", suite, "_0", task);
      std::string difference = "no reference";
      if (std::filesystem::exists(stem + ".safetensors")) {
        difference = absl::StrCat("largest difference ", CompareWithOracle(scene, stem, largest));
        ++compared;
      }
      std::printf("%-15s %d  nq %2d  ngeom %3d  replaced visuals %2zu  reset %s  %s\n", suite, task,
                  scene.model->nq, scene.model->ngeom, scene.replaced_geoms.size(),
                  reset.ok() ? "ok" : "failed", difference.c_str());
    }
  }
  std::printf("largest difference per array over %d tasks:\n", compared);
  for (const auto& [name, difference] : largest)
    std::printf("  %-20s %.3g\n", name.c_str(), difference);
}

}  // namespace
}  // namespace robostress::libero
