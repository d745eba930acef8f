// The originals' resets, drawn again: 24 references hold what LIBERO 8f1084e on robosuite 1.4.0
// left after env.seed(7) and one env.reset().
#include "sim_worker/libero/numpy_placement.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::HasSubstr;

constexpr uint32_t kSeed = 7;  // of openpi's evaluation and of the references

using Edits = std::vector<std::pair<std::string, std::string>>;

// A task's scene, with pieces of its BDDL file exchanged.
LiberoScene Compose(const std::string& suite, int task, const Edits& edits = {}) {
  const LiberoPaths paths = FindLibero(LiberoTree(), RobosuiteTree()).value();
  const std::string name = LiberoTaskNames(suite).value()[task];
  std::string text =
      ReadFile(absl::StrCat(paths.libero, "/bddl_files/", suite, "/", name, ".bddl")).value();
  for (const auto& [from, to] : edits) {
    EXPECT_NE(text.find(from), std::string::npos) << from;
    text = absl::StrReplaceAll(text, {{from, to}});
  }
  return ComposeScene(paths, ParseBddl(name, text).value()).value();
}

// Largest difference per kind of quantity.
using Differences = std::map<std::string, double>;

void Note(Differences& differences, const std::string& kind, double ours, double theirs) {
  double& largest = differences[kind];
  largest = std::max(largest, std::abs(ours - theirs));
}

std::string KindOf(const mjModel& model, int address) {
  if (address < 7) return "arm";
  if (address < 9) return "fingers";
  for (int joint = 0; joint < model.njnt; ++joint) {
    const int start = model.jnt_qposadr[joint];
    if (model.jnt_type[joint] != mjJNT_FREE || address < start || address >= start + 7) continue;
    return address < start + 3 ? "object position" : "object quaternion";
  }
  return "fixture joint";
}

void Compare(const LiberoScene& scene, const ResetDraw& draw, const std::string& stem,
             Differences& differences) {
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(stem + ".safetensors");
  ASSERT_TRUE(oracle.ok()) << oracle.status();
  const std::vector<double> qpos = oracle->ReadDoubles("reset_qpos").value();
  ASSERT_EQ(draw.qpos.size(), qpos.size());
  for (size_t i = 0; i < qpos.size(); ++i) {
    Note(differences, KindOf(*scene.model, static_cast<int>(i)), draw.qpos[i], qpos[i]);
  }
  const std::vector<double> pos = oracle->ReadDoubles("body_pos").value(),
                            quat = oracle->ReadDoubles("body_quat").value();
  const nlohmann::json facts = nlohmann::json::parse(*ReadFile(stem + ".json"));
  ASSERT_EQ(draw.fixtures.size(), facts["fixture_pose"].size());
  for (const FixturePose& fixture : draw.fixtures) {
    const int body = scene.objects.at(fixture.fixture).body;
    for (int k = 0; k < 3; ++k)
      Note(differences, "fixture position", fixture.pos[k], pos[3 * body + k]);
    for (int k = 0; k < 4; ++k)
      Note(differences, "fixture quaternion", fixture.quat[k], quat[4 * body + k]);
  }
}

// Two units in the last place of a number below 1, for the sine and cosine of a drawn angle: NumPy
// has its own for some processors, the C library's are used here. Everything else is exact.
constexpr double kSineTolerance = 2.3e-16;

TEST(NumpyPlacementTest, TheFirstResetEqualsTheOriginalsIn24Tasks) {
  SKIP_WITHOUT_SHARED_DATA();
  Differences largest;
  int compared = 0;
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    for (int task = 0; task < 6; ++task) {
      const std::string stem = absl::StrCat(SharedFolder(), "/oracles/libero/", suite, "_0", task);
      if (!std::filesystem::exists(stem + ".safetensors")) continue;
      SCOPED_TRACE(stem);
      const LiberoScene scene = Compose(suite, task);
      absl::StatusOr<NumpyPlacement> resets = NumpyPlacement::Create(scene, kSeed);
      ASSERT_TRUE(resets.ok()) << resets.status();
      const absl::StatusOr<ResetDraw> draw = resets->Reset();
      ASSERT_TRUE(draw.ok()) << draw.status();
      Differences differences;
      Compare(scene, *draw, stem, differences);
      for (const auto& [kind, difference] : differences) {
        EXPECT_LE(difference, absl::StrContains(kind, "quaternion") ? kSineTolerance : 0) << kind;
        largest[kind] = std::max(largest[kind], difference);
      }
      ++compared;
    }
  }
  std::printf("largest difference over %d tasks:\n", compared);
  for (const auto& [kind, difference] : largest)
    std::printf("  %-20s %.3g\n", kind.c_str(), difference);
}

// How far a fixture moves along x and y [mm] over the first four resets.
std::array<double, 2> Spread(const LiberoScene& scene, const std::string& fixture) {
  NumpyPlacement resets = NumpyPlacement::Create(scene, kSeed).value();
  std::array<double, 2> low = {INFINITY, INFINITY}, high = {-INFINITY, -INFINITY};
  for (int reset = 0; reset < 4; ++reset) {
    const ResetDraw draw = resets.Reset().value();
    for (const FixturePose& pose : draw.fixtures) {
      if (pose.fixture != fixture) continue;
      for (int k = 0; k < 2; ++k) {
        low[k] = std::min(low[k], pose.pos[k]);
        high[k] = std::max(high[k], pose.pos[k]);
      }
    }
  }
  return {1e3 * (high[0] - low[0]), 1e3 * (high[1] - low[1])};
}

// What was measured on the originals over four resets of one environment, to 0.1 mm.
TEST(NumpyPlacementTest, FourResetsMoveFixturesAsFarAsTheOriginals) {
  SKIP_WITHOUT_SHARED_DATA();
  struct Measured {
    const char* suite;
    int task;
    const char* fixture;
    std::array<double, 2> spread;
  };
  for (const Measured& m : {Measured{"libero_goal", 0, "wooden_cabinet_1", {10.6, 10.8}},
                            {"libero_goal", 0, "flat_stove_1", {10.0, 9.4}},
                            {"libero_goal", 0, "wine_rack_1", {15.9, 14.7}},
                            {"libero_10", 2, "flat_stove_1", {5.8, 15.0}}}) {
    const std::array<double, 2> spread = Spread(Compose(m.suite, m.task), m.fixture);
    for (int k = 0; k < 2; ++k)
      EXPECT_NEAR(spread[k], m.spread[k], 0.05001) << m.suite << " " << m.fixture;
  }
}

TEST(NumpyPlacementTest, AllTasksReset50Times) {
  SKIP_WITHOUT_SHARED_DATA();
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    for (int task = 0; task < 10; ++task) {
      SCOPED_TRACE(absl::StrCat(suite, " ", task));
      const LiberoScene scene = Compose(suite, task);
      absl::StatusOr<NumpyPlacement> resets = NumpyPlacement::Create(scene, kSeed);
      ASSERT_TRUE(resets.ok()) << resets.status();
      for (int reset = 0; reset < 50; ++reset) {
        const absl::StatusOr<ResetDraw> draw = resets->Reset();
        ASSERT_TRUE(draw.ok()) << draw.status();
        EXPECT_EQ(draw->fixtures.size(), scene.centred_fixtures.size());
      }
    }
  }
}

std::string ErrorOf(const Edits& edits) {
  const LiberoScene scene = Compose("libero_goal", 0, edits);
  absl::StatusOr<NumpyPlacement> resets = NumpyPlacement::Create(scene, kSeed);
  if (!resets.ok()) return std::string(resets.status().message());
  const absl::StatusOr<ResetDraw> draw = resets->Reset();
  return draw.ok() ? "drawn" : std::string(draw.status().message());
}

TEST(NumpyPlacementTest, WhatTheOriginalsCannotPlaceIsAnError) {
  SKIP_WITHOUT_SHARED_DATA();
  const std::string bowl = "(On akita_black_bowl_1 main_table_akita_black_bowl_region)";
  EXPECT_EQ(ErrorOf({{bowl, "(On akita_black_bowl_1 wooden_cabinet_1_top_side)"}}), "drawn");
  EXPECT_THAT(ErrorOf({{bowl, "(Open plate_1)"}}), HasSubstr("'plate_1' cannot open"));
  EXPECT_THAT(ErrorOf({{bowl, "(On nothing_1 main_table_plate_region)"}}),
              HasSubstr("'nothing_1' is not an object"));
  EXPECT_THAT(ErrorOf({{bowl, "(On flat_stove_1 wooden_cabinet_1_top_side)"}}),
              HasSubstr("only movable objects start at the site"));
  EXPECT_THAT(ErrorOf({{bowl, bowl + bowl}}), HasSubstr("'akita_black_bowl_1' is placed twice"));
  EXPECT_THAT(ErrorOf({{bowl, "(On akita_black_bowl_1 cream_cheese_1)"},
                       {"(On cream_cheese_1 main_table_cream_cheese_region)", ""}}),
              HasSubstr("'akita_black_bowl_1' is placed before 'cream_cheese_1'"));
  EXPECT_THAT(ErrorOf({{bowl, "(On akita_black_bowl_1 main_table_plate_region)"}}),
              HasSubstr("found no room"))
      << "two objects in a region of 2 cm";
}

}  // namespace
}  // namespace robostress::libero
