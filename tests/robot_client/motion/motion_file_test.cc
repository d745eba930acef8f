#include "robot_client/motion/motion_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "robot_client/demonstration/demonstration.h"
#include "robot_client/piper/protocol.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

std::string Fresh(const std::string& name) {
  const std::string path = ::testing::TempDir() + "/motion_" + name;
  fs::remove_all(path);
  fs::create_directories(path);
  return path;
}

std::string File(const std::string& name, const std::string& text) {
  const std::string path = Fresh(name) + "/motion.csv";
  EXPECT_TRUE(WriteFileAtomically(path, text).ok());
  return path;
}

std::string Refusal(const std::string& path, std::optional<int> episode = std::nullopt) {
  const auto motion = ReadMotion(path, episode);
  EXPECT_FALSE(motion.ok()) << path;
  return std::string(motion.status().message());
}

TEST(MotionFileTest, ReadsATableOfSomeJoints) {
  const auto motion = ReadMotion(
      File("table", "t,q_cmd_J2,q_cmd_gripper\r\n5,0.1,0.02\r\n5.5,0.2,0.03\n\n6,0.3,0.04\n"),
      std::nullopt);
  ASSERT_TRUE(motion.ok()) << motion.status();
  EXPECT_THAT(motion->t, ::testing::ElementsAre(0, 0.5, 1));
  EXPECT_EQ(motion->poses[2][1], 0.3);
  EXPECT_EQ(motion->poses[2][piper::kJoints], 0.04);
  EXPECT_TRUE(motion->moves[1]);
  EXPECT_FALSE(motion->moves[0]);
}

TEST(MotionFileTest, ReadsTheNamesOfARigAndNoMixture) {
  std::vector<std::string> names;
  for (int j = 1; j <= piper::kJoints; ++j) names.push_back(absl::StrCat("piper_joint", j));
  const auto motion =
      ReadMotion(File("of_rig", "t,q_cmd_piper_joint2,q_cmd_piper_joint6\n0,0.1,0.2\n1,0.3,0.4\n"),
                 std::nullopt, {}, names);
  ASSERT_TRUE(motion.ok()) << motion.status();
  EXPECT_EQ(motion->poses[1][1], 0.3);
  EXPECT_EQ(motion->poses[1][5], 0.4);
  EXPECT_FALSE(motion->moves[0]);
  const auto mixed =
      ReadMotion(File("mixed", "t,q_cmd_piper_joint2,q_cmd_J3\n0,0.1,0.2\n1,0.3,0.4\n"),
                 std::nullopt, {}, names);
  EXPECT_THAT(std::string(mixed.status().message()),
              HasSubstr("column 'q_cmd_J3' is none of t, q_cmd_piper_joint1"));
}

TEST(MotionFileTest, WhatItWritesItReads) {
  Motion motion;
  motion.moves = {true, false, true, false, false, false, true};
  for (int i = 0; i < 9; ++i) {
    motion.t.push_back(0.1 * i);
    motion.poses.push_back({0.01 * i, 0, -0.02 * i, 0, 0, 0, 0.003 * i});
  }
  const auto back = ReadMotion(File("back", MotionCsv(motion)), std::nullopt);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->moves, motion.moves);
  for (size_t i = 0; i < 9; ++i) {
    EXPECT_NEAR(back->t[i], motion.t[i], 1e-9);
    for (int axis = 0; axis < piper::kAxes; ++axis)
      EXPECT_NEAR(back->poses[i][axis], motion.poses[i][axis], 1e-9);
  }
}

TEST(MotionFileTest, SaysFileLineColumnAndValue) {
  EXPECT_THAT(Refusal(File("word", "t,q_cmd_J1\n0,0.1\n1,fast\n")),
              HasSubstr("motion.csv:3: q_cmd_J1 is 'fast', must be a finite number"));
  EXPECT_THAT(Refusal(File("nan", "t,q_cmd_J1\n0,0.1\n1,nan\n2,0\n")), HasSubstr("is 'nan'"));
  EXPECT_THAT(Refusal(File("unknown", "t,q_cmd_J7\n0,0.1\n1,0\n")),
              HasSubstr("column 'q_cmd_J7' is none of"));
  EXPECT_THAT(Refusal(File("no_t", "q_cmd_J1\n0.1\n0\n")), HasSubstr("has no column 't'"));
  EXPECT_THAT(Refusal(File("ragged", "t,q_cmd_J1\n0\n1,0\n")), HasSubstr(":2: has 1 columns"));
  EXPECT_THAT(Refusal(File("empty", "")), HasSubstr("has no rows"));
  EXPECT_THAT(Refusal("/nowhere/motion.csv"), HasSubstr("is not there"));
  EXPECT_THAT(Refusal(Fresh("folder")), HasSubstr("neither a run"));
  EXPECT_THAT(Refusal(File("one", "t,q_cmd_J1\n0,0\n1,0\n"), 2), HasSubstr("--episode out"));
}

TEST(MotionFileTest, ReadsWhatWasSentInAnEpisodeOfARun) {
  const std::string run = Fresh("run");
  std::string text =
      "t,state,episode,sent_J1,sent_J2,sent_J3,sent_J4,sent_J5,sent_J6,sent_gripper\n";
  const auto row = [&](double t, const char* state, int episode, double j1) {
    text += absl::StrFormat("%g,%s,%d,%g,0,0,0,0,0,0.01\n", t, state, episode, j1);
  };
  text += "0,IDLE,-1,,,,,,,\n";
  row(1, "MOVE", -1, 0.1), row(2, "MOVE", -1, 0.2), row(3, "ENABLED", -1, 0.2);
  row(4, "RUN", 0, 0.3), row(5, "HOLD", 0, 0.4), row(6, "RUN", 0, 0.5), row(7, "ENABLED", 0, 0.5);
  row(8, "RUN", 1, 0.6), row(9, "RUN", 1, 0.7);
  ASSERT_TRUE(WriteFileAtomically(run + "/ticks.csv", text).ok());
  EXPECT_THAT(Refusal(run), HasSubstr("holds episodes 0, 1; say which with --episode"));
  EXPECT_THAT(Refusal(run, 7), HasSubstr("has no episode 7; it holds 0, 1"));
  const auto first = ReadMotion(run, 0);
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_THAT(first->t, ::testing::ElementsAre(0, 1, 2));
  EXPECT_EQ(first->poses[1][0], 0.4);
  text.resize(text.find("4,RUN"));
  ASSERT_TRUE(WriteFileAtomically(run + "/ticks.csv", text).ok());
  const auto way = ReadMotion(run, std::nullopt);
  ASSERT_TRUE(way.ok()) << way.status();
  EXPECT_EQ(way->poses.size(), 2u) << "the longest way of the client's own";
}

DemonstrationEpisode Episode(int ticks) {
  DemonstrationEpisode episode;
  episode.instruction = "wave";
  episode.success = true;
  for (int i = 0; i < ticks; ++i) {
    DemonstrationTick tick;
    for (int axis = 0; axis < piper::kAxes; ++axis) {
      tick.state[axis] = 9;
      tick.action[axis] = 0.01 * i + 0.1 * axis;
    }
    episode.ticks.push_back(tick);
  }
  return episode;
}

TEST(MotionFileTest, ReadsTheActionsOfADemonstration) {
  const std::string set = Fresh("set");
  auto dataset =
      LerobotDataset::Open(set + "/lerobot", LerobotSchemaOf("piper", ArmAxes(), 30, {}));
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  ASSERT_TRUE(dataset->Append(ToLerobot(Episode(40))).ok());
  ASSERT_TRUE(dataset->Append(ToLerobot(Episode(70))).ok());
  EXPECT_THAT(Refusal(set), HasSubstr("holds episodes 0 to 1; say which"));
  EXPECT_THAT(Refusal(set, 2), HasSubstr("has no episode 2; it holds 0 to 1"));
  const auto motion = ReadMotion(set, 1);
  ASSERT_TRUE(motion.ok()) << motion.status();
  ASSERT_EQ(motion->poses.size(), 70u);
  EXPECT_NEAR(motion->t[30], 1, 1e-12);
  for (int axis = 0; axis < piper::kAxes; ++axis)
    EXPECT_NEAR(motion->poses[69][axis], 0.69 + 0.1 * axis, 1e-6);  // float32
}

TEST(MotionFileTest, SevenJointsArePlayedOnAnArmOfSeven) {
  const ArmAxes seven{7, true};
  const std::string file = File("seven", "t,q_cmd_J7,q_cmd_gripper\n0,0.1,0.01\n1,0.2,0.02\n");
  const auto motion = ReadMotion(file, std::nullopt, seven);
  ASSERT_TRUE(motion.ok()) << motion.status();
  EXPECT_EQ(motion->poses[1][6], 0.2);
  EXPECT_EQ(motion->poses[1][7], 0.02);
  EXPECT_THAT(motion->moves,
              ::testing::ElementsAre(false, false, false, false, false, false, true, true));
  EXPECT_EQ(MotionCsv(*motion), "t,q_cmd_J7,q_cmd_gripper\n0,0.1,0.01\n1,0.2,0.02\n");
  EXPECT_THAT(Refusal(file), HasSubstr("column 'q_cmd_J7' is none of t, q_cmd_J1, q_cmd_J2"));
  const auto without = ReadMotion(file, std::nullopt, {7, false});
  EXPECT_THAT(std::string(without.status().message()), HasSubstr("'q_cmd_gripper' is none of"));

  const std::string run = Fresh("run_of_seven");
  std::string columns, zeros;
  for (int j = 1; j <= 7; ++j) columns += absl::StrFormat(",sent_J%d", j), zeros += ",0";
  const std::string text = "t,state,episode" + columns + ",sent_gripper\n1,RUN,0" + zeros +
                           ",0.03\n2,RUN,0" + zeros + ",0.04\n";
  ASSERT_TRUE(WriteFileAtomically(run + "/ticks.csv", text).ok());
  EXPECT_THAT(Refusal(run), HasSubstr("is of an arm of 7 joints and a gripper, this one has 6"));
  const auto again = ReadMotion(run, std::nullopt, seven);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->poses[1][7], 0.04);

  const std::string set = Fresh("set_of_seven");
  auto dataset = LerobotDataset::Open(set + "/lerobot", LerobotSchemaOf("franka", seven, 30, {}));
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  DemonstrationEpisode episode = Episode(40);
  episode.axes = seven;
  for (DemonstrationTick& tick : episode.ticks) tick.action[6] = 0.6, tick.action[7] = 0.07;
  ASSERT_TRUE(dataset->Append(ToLerobot(episode)).ok());
  const auto taught = ReadMotion(set, std::nullopt, seven);
  ASSERT_TRUE(taught.ok()) << taught.status();
  EXPECT_NEAR(taught->poses[39][6], 0.6, 1e-6);
  EXPECT_NEAR(taught->poses[39][7], 0.07, 1e-6);
  EXPECT_THAT(Refusal(set), HasSubstr(R"("J7","gripper"], not [)"));
}

TEST(MotionFileTest, ARigsNamesArePlayedOnTheArmThatHasThem) {
  const std::vector<std::string> names = {"pan", "lift", "flex"};
  const ArmAxes three{3, true};
  const std::string file = File("named", "t,q_cmd_flex,q_cmd_pan\n0,0.1,0.01\n1,0.2,0.02\n");
  const auto motion = ReadMotion(file, std::nullopt, three, names);
  ASSERT_TRUE(motion.ok()) << motion.status();
  EXPECT_EQ(motion->poses[1][2], 0.2);
  EXPECT_EQ(motion->poses[1][0], 0.02);
  EXPECT_THAT(motion->moves,
              ::testing::ElementsAre(true, false, true, false, false, false, false, false));
  const auto refusal = [&](const std::string& columns) {
    const auto read = ReadMotion(File("refused", "t," + columns + "\n0,0,0\n1,1,1\n"), std::nullopt,
                                 three, names);
    return std::string(read.status().message());
  };
  EXPECT_THAT(refusal("q_cmd_pan,q_cmd_J2"),
              HasSubstr("column 'q_cmd_J2' is none of t, q_cmd_pan, q_cmd_lift, q_cmd_flex"));
  EXPECT_THAT(refusal("q_cmd_J1,q_cmd_roll"),
              AllOf(HasSubstr("column 'q_cmd_roll' is none of t, q_cmd_J1, q_cmd_J2, q_cmd_J3"),
                    HasSubstr("nor of q_cmd_pan")));
  EXPECT_THAT(Refusal(file), HasSubstr("column 'q_cmd_flex' is none of")) << "a Piper's";
}

TEST(MotionFileTest, PlaysNoDataSetOfAnotherProgramOrAnotherArm) {
  const std::string set = Fresh("other");
  const std::string info = set + "/meta/info.json";
  ASSERT_TRUE(MakeDirectories(set + "/meta").ok());
  ASSERT_TRUE(WriteFileAtomically(info, R"({"fps": 30, "total_episodes": 3})").ok());
  EXPECT_THAT(Refusal(set), HasSubstr("robot_client did not record"));
  ASSERT_TRUE(WriteFileAtomically(info, R"({"fps": 30, "total_episodes": 1, "robostress": {},
                    "features": {"action": {"names": ["x", "y", "z"]}}})")
                  .ok());
  EXPECT_THAT(Refusal(set), HasSubstr(R"(features.action.names is ["x","y","z"])"));
  for (const char* text :
       {"", "[]", "{", R"({"robostress": {}, "fps": "30"})",
        R"({"robostress": {}, "fps": 30, "total_episodes": -1})",
        R"({"robostress": {}, "fps": 30, "total_episodes": 1, "features": 7})"}) {
    ASSERT_TRUE(WriteFileAtomically(info, text).ok());
    EXPECT_THAT(Refusal(set, 0), HasSubstr("info.json")) << text;
  }
}

}  // namespace
}  // namespace robostress
