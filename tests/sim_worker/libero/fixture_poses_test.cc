#include "sim_worker/libero/fixture_poses.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr char kTask[] = "wipe_the_stove";

// A scene as far as a table needs it: two fixtures.
LiberoScene TwoFixtures() {
  LiberoScene scene;
  for (const char* name : {"stove_1", "rack_1"})
    scene.centred_fixtures.push_back({name, {0, 0, 0.9}, {1, 0, 0, 0}});
  return scene;
}

nlohmann::json Pose(double x) { return {{"pos", {x, 0.2, 0.9}}, {"quat", {1, 0, 0, 0}}}; }

nlohmann::json GoodTable() {
  return {{kTask,
           {{"0", {{"stove_1", Pose(0.1)}, {"rack_1", Pose(0.2)}}},
            {"41", {{"stove_1", Pose(0.3)}, {"rack_1", Pose(0.4)}}}}}};
}

std::string WriteTable(const std::string& text) {
  const std::string file = absl::StrCat(::testing::TempDir(), "/table.json");
  EXPECT_TRUE(WriteFileAtomically(file, text).ok());
  return file;
}

std::string ErrorOfText(const std::string& text) {
  const LiberoScene scene = TwoFixtures();
  const absl::Status status = ReadFixtureTable(WriteTable(text), kTask, scene).status();
  return status.ok() ? "read" : std::string(status.message());
}

std::string ErrorOf(const nlohmann::json& table) { return ErrorOfText(table.dump()); }

TEST(FixtureTableTest, GivesThePosesOfTheListedStates) {
  const LiberoScene scene = TwoFixtures();
  LiberoFixtures choice{.source = LiberoFixtures::Source::kTable};
  choice.table = WriteTable(GoodTable().dump());
  absl::StatusOr<FixturePoses> poses = FixturePoses::Create(choice, kTask, scene);
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->At(41)->size(), 2u);
  EXPECT_EQ(poses->At(41)->at(0).fixture, "stove_1");
  EXPECT_EQ(poses->At(41)->at(0).pos[0], 0.3);
  EXPECT_EQ(poses->At(0)->at(1).pos[0], 0.2);
  EXPECT_THAT(std::string(poses->At(1).status().message()),
              AllOf(HasSubstr(choice.table), HasSubstr(kTask), HasSubstr("initial state 1"),
                    HasSubstr("add what is absent")));
  EXPECT_TRUE(poses->CheckListed(41, 1).ok());
  EXPECT_THAT(std::string(poses->CheckListed(40, 3).message()),
              HasSubstr("no poses for initial state 40, 42;"));
}

TEST(FixtureTableTest, ErrorsNameFileTaskStateAndFixture) {
  EXPECT_EQ(ErrorOf(GoodTable()), "read");
  EXPECT_THAT(ErrorOfText("{"), AllOf(HasSubstr("table.json: not JSON"), HasSubstr("line 1")));
  EXPECT_THAT(ErrorOfText("[]"), HasSubstr("must be an object of tasks"));
  EXPECT_THAT(ErrorOfText(R"({"other": {}})"),
              AllOf(HasSubstr("no task 'wipe_the_stove'; it has other"), HasSubstr("add one")));
  nlohmann::json table = GoodTable();
  table[kTask]["last"] = table[kTask]["0"];
  EXPECT_THAT(ErrorOf(table), HasSubstr("'last' is not the index of an initial state"));
  table = GoodTable();
  table[kTask]["41"].erase("rack_1");
  EXPECT_THAT(ErrorOf(table),
              AllOf(HasSubstr("table.json: task 'wipe_the_stove', initial state 41"),
                    HasSubstr("no pose for fixture 'rack_1'; add it")));
  table = GoodTable();
  table[kTask]["0"]["sink_1"] = Pose(0);
  EXPECT_THAT(ErrorOf(table),
              HasSubstr("'sink_1' is not a fixture of this task; it has stove_1, rack_1"));
  table = GoodTable();
  table[kTask]["0"]["stove_1"]["pos"] = {1, 2};
  EXPECT_THAT(ErrorOf(table), HasSubstr("fixture 'stove_1': \"pos\" must be 3 numbers"));
  table[kTask]["0"]["stove_1"]["pos"] = {1, 2, "3"};
  EXPECT_THAT(ErrorOf(table), HasSubstr("\"pos\" must be 3 numbers"));
  table = GoodTable();
  table[kTask]["0"]["stove_1"].erase("quat");
  EXPECT_THAT(ErrorOf(table), HasSubstr("\"quat\" must be 4 numbers, w x y z"));
  table[kTask]["0"]["stove_1"]["quat"] = {1, 1, 0, 0};
  EXPECT_THAT(ErrorOf(table), HasSubstr("\"quat\" has norm 1.41"));
  table[kTask]["0"]["stove_1"] = 5;
  EXPECT_THAT(ErrorOf(table), HasSubstr("must be an object with \"pos\" [3] and \"quat\" [4]"));
  table[kTask] = nlohmann::json::array();
  EXPECT_THAT(ErrorOf(table), HasSubstr("must be an object of initial states"));
  EXPECT_EQ(ReadFixtureTable("/no/file", kTask, TwoFixtures()).status().code(),
            absl::StatusCode::kNotFound);
}

TEST(FixtureTableTest, ATaskWithoutFixturesNeedsNoEntry) {
  const absl::StatusOr<FixtureTable> table =
      ReadFixtureTable(WriteTable("{}"), kTask, LiberoScene());
  EXPECT_TRUE(table.ok()) << table.status();
}

UnitConfig GoalUnit(const std::string& fixtures) {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  unit.libero_fixtures = fixtures;
  unit.sim.settle_steps = 0;
  return unit;
}

// Where the fixtures stand in the simulator after a reset, in the order of centred_fixtures.
std::vector<std::array<double, 3>> StandingAfterReset(LiberoSimTask& task, int initial_state) {
  const absl::Status reset = task.Reset(initial_state);
  EXPECT_TRUE(reset.ok()) << reset;
  std::vector<std::array<double, 3>> positions;
  for (const FixturePose& pose : task.scene().centred_fixtures) {
    const double* xpos =
        std::as_const(task.sim()).data().xpos + 3 * task.scene().objects.at(pose.fixture).body;
    positions.push_back({xpos[0], xpos[1], xpos[2]});
  }
  return positions;
}

TEST(LiberoFixturesTest, EachChoiceStandsWhereItSays) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto centred = LiberoSimTask::Create(GoalUnit("centred"), 0);
  ASSERT_TRUE(centred.ok()) << centred.status();
  const auto at_centre = StandingAfterReset(**centred, 0);
  for (size_t i = 0; i < at_centre.size(); ++i)
    EXPECT_EQ(at_centre[i], (*centred)->scene().centred_fixtures[i].pos);
  EXPECT_EQ(StandingAfterReset(**centred, 3), at_centre);

  for (const char* choice : {"sampled", "numpy", "numpy:8", "numpy-each:8"}) {
    SCOPED_TRACE(choice);
    const auto task = LiberoSimTask::Create(GoalUnit(choice), 0);
    ASSERT_TRUE(task.ok()) << task.status();
    const auto third = StandingAfterReset(**task, 3), first = StandingAfterReset(**task, 0);
    EXPECT_NE(third, first);
    EXPECT_EQ(StandingAfterReset(**task, 3), third) << "a function of the initial state";
    for (size_t i = 0; i < first.size(); ++i) {
      for (int k = 0; k < 2; ++k) EXPECT_NEAR(first[i][k], at_centre[i][k], 0.0101);
      EXPECT_NEAR(first[i][2], at_centre[i][2], 1e-15);
    }
  }
}

TEST(LiberoFixturesTest, NumpyStandsWhereTheOriginalsStood) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<std::string> facts =
      ReadFile(SharedFolder() + "/oracles/libero/libero_goal_00.json");
  if (!facts.ok()) GTEST_SKIP() << facts.status();
  const nlohmann::json poses = nlohmann::json::parse(*facts)["fixture_pose"];
  const auto task = LiberoSimTask::Create(GoalUnit("numpy"), 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const auto positions = StandingAfterReset(**task, 0);
  for (size_t i = 0; i < positions.size(); ++i) {
    const nlohmann::json& pose = poses[(*task)->scene().centred_fixtures[i].fixture];
    EXPECT_EQ(positions[i], (pose[0].get<std::array<double, 3>>()));
  }
}

// Nothing of libero_goal is drawn before its cabinet, so that one reset more changes nothing there.
TEST(LiberoFixturesTest, NumpyEachSeedsEveryStateByItself) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto each = LiberoSimTask::Create(GoalUnit("numpy-each:5"), 0);
  ASSERT_TRUE(each.ok()) << each.status();
  for (const int state : {0, 2}) {
    const auto once = LiberoSimTask::Create(GoalUnit(absl::StrCat("numpy:", 5 + state)), 0);
    ASSERT_TRUE(once.ok()) << once.status();
    EXPECT_EQ(StandingAfterReset(**each, state), StandingAfterReset(**once, 0)) << state;
  }
}

// An open drawer is. The positions are LIBERO's, reset as LeRobot resets it
// (originals/look.py --suites libero_10 --tasks 3 --reseeded 2).
TEST(LiberoFixturesTest, NumpyEachCountsTheResetBeforeTheSeed) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit("numpy-each:1000");
  unit.suite = "libero_10";
  const auto task = LiberoSimTask::Create(unit, 3);
  ASSERT_TRUE(task.ok()) << task.status();
  const std::map<std::string, std::array<double, 2>> originals[] = {
      {{"white_cabinet_1", {0.009052887984430836, 0.3086228686935502}},
       {"wine_rack_1", {-0.10942036681226258, -0.290359450308036}}},
      {{"white_cabinet_1", {0.004109720960239302, 0.3093101828468968}},
       {"wine_rack_1", {-0.097882104841424, -0.3056523932789704}}}};
  for (const int state : {0, 1}) {
    const auto positions = StandingAfterReset(**task, state);
    ASSERT_EQ(positions.size(), 2u);
    for (size_t i = 0; i < 2; ++i) {
      const std::string& name = (*task)->scene().centred_fixtures[i].fixture;
      for (int k = 0; k < 2; ++k)
        EXPECT_NEAR(positions[i][k], originals[state].at(name)[k], 1e-15) << name << state;
    }
  }
}

TEST(LiberoFixturesTest, BadChoicesFailBeforeTheFirstEpisode) {
  SKIP_WITHOUT_SHARED_DATA();
  EXPECT_THAT(std::string(LiberoSimTask::Create(GoalUnit("centre"), 0).status().message()),
              HasSubstr("libero_fixtures 'centre'"));
  const std::string file = WriteTable(R"({"open_the_middle_drawer_of_the_cabinet": {"0": {}}})");
  EXPECT_THAT(std::string(LiberoSimTask::Create(GoalUnit(file), 0).status().message()),
              HasSubstr("no pose for fixture 'wooden_cabinet_1'"));
}

// An expert is made once per task and refers to the simulator: it must survive what moves between
// episodes.
TEST(LiberoFixturesTest, TheExpertOpensTheDrawerWhereverTheCabinetStands) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit("numpy");
  unit.sim.settle_steps = 10;
  const auto task = LiberoSimTask::Create(unit, 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const auto expert = MakeExpertPolicy(**task);
  ASSERT_TRUE(expert.ok()) << expert.status();
  for (const int state : {0, 25}) {
    ASSERT_TRUE((*task)->Reset(state).ok());
    ASSERT_TRUE((*expert)->StartEpisode({0, state}).ok());
    for (int step = 0; step < (*task)->horizon() && !(*task)->Success(); ++step) {
      const absl::StatusOr<PredictedChunk> chunk = (*expert)->Predict({}, step);
      ASSERT_TRUE(chunk.ok()) << chunk.status();
      ASSERT_TRUE((*task)->Step(chunk->actions.row(0).transpose()).ok());
    }
    EXPECT_TRUE((*task)->Success()) << state;
  }
}

}  // namespace
}  // namespace robostress::libero
