#include "sim_worker/libero/demonstration_replay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <limits>
#include <map>

#include "absl/strings/str_cat.h"
#include "sim_worker/libero/compare.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::HasSubstr;
using Differences = std::map<std::string, double>;

struct Reference {
  std::string suite;
  int task;
};

std::string OracleFile(const Reference& reference) {
  return absl::StrCat(SharedFolder(), "/oracles/libero/", reference.suite, "_0", reference.task,
                      ".safetensors");
}

UnitConfig ParityUnit(const std::string& suite) {
  UnitConfig unit;
  unit.suite = suite;
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  unit.sim.stepping = Stepping::kParity;
  return unit;
}

// Replays a reference and returns the largest difference per key.
Differences ReplayAgainst(const Reference& reference, const UnitConfig& unit) {
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(OracleFile(reference));
  EXPECT_TRUE(oracle.ok()) << oracle.status();
  const auto task = LiberoSimTask::Create(unit, reference.task);
  EXPECT_TRUE(task.ok()) << task.status();
  if (!oracle.ok() || !task.ok()) return {};
  const absl::StatusOr<Recording> recording = ReadRecording(*oracle, **task);
  EXPECT_TRUE(recording.ok()) << recording.status();
  SafetensorsWriter writer;
  const absl::Status replayed = Replay(*recording, 10, **task, writer);
  EXPECT_TRUE(replayed.ok()) << replayed;
  const auto ours = SafetensorsFile::Parse("ours", *writer.Serialize());
  Differences differences;
  const auto compared = CompareTensors(*oracle, *ours);
  EXPECT_TRUE(compared.ok()) << compared.status();
  for (const TensorDifference& d : *compared) {
    EXPECT_TRUE(d.kind == TensorDifference::Kind::kEqualShape || d.key == "reset_qpos") << d.key;
    differences[d.key] = d.largest;
  }
  return differences;
}

#define SKIP_WITHOUT_ORACLE(reference)                 \
  SKIP_WITHOUT_SHARED_DATA();                          \
  if (!std::filesystem::exists(OracleFile(reference))) \
  GTEST_SKIP() << OracleFile(reference) << " is absent"

// Tasks of each suite in which nothing bifurcates; docs/results/libero-parity.md has all 24.
// libero_object 2 needs the bounds of visual meshes, which double contacts with the floor
// (visual_bounds.h).
TEST(ReplayTest, ParityFollowsTheOriginals) {
  for (const Reference& reference : {Reference{"libero_goal", 0},
                                     {"libero_object", 2},
                                     {"libero_spatial", 3},
                                     {"libero_10", 4}}) {
    SKIP_WITHOUT_ORACLE(reference);
    SCOPED_TRACE(absl::StrCat(reference.suite, " ", reference.task));
    const Differences d = ReplayAgainst(reference, ParityUnit(reference.suite));
    ASSERT_FALSE(d.empty());
    EXPECT_LT(d.at("qpos"), 1e-9);
    EXPECT_LT(d.at("eef_pos"), 1e-9);
    EXPECT_LT(d.at("eef_quat"), 1e-9);
    EXPECT_LT(d.at("gripper_qpos"), 1e-9);
    EXPECT_LT(d.at("goal_pos"), 1e-9);
    EXPECT_LT(d.at("goal_ori"), 1e-9);
    EXPECT_LT(d.at("sub_torque_first10"), 1e-9);
    EXPECT_EQ(d.at("ncon"), 0);
    EXPECT_EQ(d.at("success"), 0);
    EXPECT_EQ(d.at("time"), 0);
    EXPECT_EQ(d.at("body_pos"), 0);
    EXPECT_EQ(d.at("model.dof_damping"), 0);
  }
}

// What is off by without each behaviour, in the order of facts: each matters far above the bar.
TEST(ReplayTest, EachBehaviourOfTheOriginalsIsNeeded) {
  const Reference reference{"libero_goal", 0};
  SKIP_WITHOUT_ORACLE(reference);
  UnitConfig unit = ParityUnit(reference.suite);
  unit.sim.robosuite.stale_reset_pose = false;
  EXPECT_GT(ReplayAgainst(reference, unit).at("qpos"), 1e-4);
  unit = ParityUnit(reference.suite);
  unit.sim.robosuite.home_goal = false;
  EXPECT_GT(ReplayAgainst(reference, unit).at("qpos"), 1e-3);
  unit = ParityUnit(reference.suite);
  unit.sim.robosuite.single_precision_rotation = Switch::kOff;
  EXPECT_GT(ReplayAgainst(reference, unit).at("qpos"), 1e-9);
  unit = ParityUnit(reference.suite);
  unit.sim.robosuite.late_observation = Switch::kOff;
  const Differences d = ReplayAgainst(reference, unit);
  EXPECT_GT(d.at("gripper_qpos"), 1e-5);
  EXPECT_GT(d.at("eef_pos"), 1e-4);
  EXPECT_LT(d.at("qpos"), 1e-9) << "what is observed moves nothing";
}

TEST(ReplayTest, ARecordingOfAnotherSceneIsRefused) {
  const Reference reference{"libero_goal", 0};
  SKIP_WITHOUT_ORACLE(reference);
  const auto task = LiberoSimTask::Create(ParityUnit("libero_object"), 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const auto oracle = SafetensorsFile::Open(OracleFile(reference));
  ASSERT_TRUE(oracle.ok()) << oracle.status();
  EXPECT_THAT(std::string(ReadRecording(*oracle, **task).status().message()),
              ::testing::AllOf(HasSubstr("libero_goal_00.safetensors"), HasSubstr("init_state")));
}

SafetensorsFile FileWith(const std::string& name,
                         const std::map<std::string, std::vector<double>>& tensors) {
  SafetensorsWriter writer;
  for (const auto& [key, values] : tensors)
    writer.AddDoubles(key, {static_cast<int64_t>(values.size())}, values);
  return *SafetensorsFile::Parse(name, *writer.Serialize());
}

TEST(CompareTest, FindsTheLargestDifferenceAndWhatIsMissing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const SafetensorsFile a = FileWith("a", {{"only_a", {1}},
                                           {"equal", {1, nan}},
                                           {"far", {1, 2, 3}},
                                           {"nan", {nan, 1}},
                                           {"shape", {1, 2}}});
  const SafetensorsFile b = FileWith(
      "b",
      {{"equal", {1, nan}}, {"far", {1.5, 2, 2}}, {"nan", {0, 1}}, {"shape", {1}}, {"z", {1}}});
  const auto differences = CompareTensors(a, b);
  ASSERT_TRUE(differences.ok()) << differences.status();
  using Kind = TensorDifference::Kind;
  std::map<std::string, TensorDifference> by_key;
  for (const TensorDifference& d : *differences) by_key[d.key] = d;
  EXPECT_EQ(by_key.size(), 6u);
  EXPECT_EQ(by_key["only_a"].kind, Kind::kOnlyInA);
  EXPECT_EQ(by_key["z"].kind, Kind::kOnlyInB);
  EXPECT_EQ(by_key["shape"].kind, Kind::kShapes);
  EXPECT_EQ(by_key["equal"].largest, 0);
  EXPECT_EQ(by_key["far"].largest, 1);
  EXPECT_EQ(by_key["far"].at, 2);
  EXPECT_EQ(by_key["nan"].largest, std::numeric_limits<double>::infinity());
  const std::string table = ComparisonTable(*differences);
  EXPECT_THAT(table, HasSubstr("[2]: 3, 2"));
  EXPECT_THAT(table, HasSubstr("only in A"));
}

}  // namespace
}  // namespace robostress::libero
