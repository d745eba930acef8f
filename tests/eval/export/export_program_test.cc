// A sweep that records, and its episodes as data sets: the programs, as a person starts them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/lerobot/parquet_reader.h"
#include "common/libero_demonstrations.h"
#include "common/recordings/recording.h"
#include "common/records/episode_recording.h"
#include "tests/common/lerobot/read_back.h"
#include "tests/common/recordings/collected_rows.h"
#include "tests/common/recordings/peers_environment.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
namespace fs = std::filesystem;

constexpr char kUnit[] = "/run/units/tabletop_goal-heavy_payload-L5-expert-base-s0";

class Export : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    root_ = ::testing::TempDir() + "/export";
    fs::remove_all(root_);
    fs::create_directories(root_);
    const auto [output, code] = Sweep("run", "--record-episodes 32 --split-episodes 1");
    ASSERT_EQ(code, 0) << output;
  }
  static std::pair<std::string, int> Sweep(const std::string& name, const std::string& more) {
    return RunProgram(
        BIN_DIR "/robostress-sweep",
        absl::StrCat("--suites tabletop_goal --tasks 0,3 --policies expert --methods base "
                     "--scenarios heavy_payload --episodes 2 --first-initial-state 40 --workers 1 "
                     "--quiet --no-report --out ",
                     root_, "/", name, " ", more));
  }
  static std::pair<std::string, int> Write(const std::string& arguments) {
    return RunProgram(BIN_DIR "/robostress-export", absl::StrCat(root_, "/run ", arguments));
  }
  static std::string root_;
};
std::string Export::root_;

TEST_F(Export, RecordingChangesNoRow) {
  const auto [output, code] = Sweep("plain", "");
  ASSERT_EQ(code, 0) << output;
  EXPECT_EQ(*ReadFile(root_ + "/run/episodes.csv"), *ReadFile(root_ + "/plain/episodes.csv"));
  EXPECT_FALSE(fs::exists(root_ + "/plain/units/tabletop_goal-heavy_payload-L5-expert-base-s0/"
                                  "episodes"));
}

TEST_F(Export, LerobotsLibrariesReadTheEpisodes) {
  const std::string set = root_ + "/lerobot";
  const auto [said, code] = Write("--lerobot " + set);
  ASSERT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr("4 episodes, "));
  const std::string origins = *ReadFile(set + "/meta/robostress_episodes.jsonl");
  EXPECT_THAT(origins, HasSubstr(R"({"episode_index":3,"unit":"tabletop_goal-heavy_payload-L5-)"
                                 R"(expert-base-s0","scenario":"heavy_payload","severity":5)"));
  const std::string table = set + "/data/chunk-000/file-001.parquet";
  const auto parquet = ParquetReader::Parse(table, *ReadFile(table));
  ASSERT_TRUE(parquet.ok()) << parquet.status();
  const auto recorded =
      ReadEpisodeRecording(absl::StrCat(root_, kUnit, "/episodes/task0_episode1.safetensors"));
  ASSERT_TRUE(recorded.ok()) << recorded.status();
  const auto holds = [&](const std::string& column, int width, const auto& of_step) {
    const auto numbers = parquet->Numbers(column, width);
    ASSERT_TRUE(numbers.ok()) << numbers.status();
    ASSERT_EQ(numbers->size(), recorded->steps.size() * static_cast<size_t>(width));
    for (size_t t = 0; t < recorded->steps.size(); ++t) {
      for (int i = 0; i < width; ++i)
        EXPECT_EQ((*numbers)[t * width + i], static_cast<float>(of_step(recorded->steps[t])[i]))
            << column << " of step " << t;
    }
  };
  using Step = EpisodeRecording::Step;
  holds("observation.state", 8, [](const Step& s) { return s.proprioception; });
  holds("observation.joints", 7, [](const Step& s) { return s.before.q; });
  holds("observation.joint_velocities", 7, [](const Step& s) { return s.before.dq; });
  holds("action", 7, [](const Step& s) { return s.commanded; });
  holds("action.sent", 7, [](const Step& s) { return s.sent; });
  holds("action.measured", 7, [](const Step& s) { return s.measured; });
  const auto [again, refused] = Write("--lerobot " + set);
  EXPECT_EQ(refused, 2);
  EXPECT_THAT(again, HasSubstr("holds something already"));
  if (!ReaderFailure().empty()) GTEST_SKIP() << "not read back: " << ReaderFailure();
  const auto [output, read] = ReadBack(set);
  EXPECT_EQ(read, 0) << output;
  EXPECT_THAT(output, HasSubstr("episode 3: 'put the bottle on the rack'"));
}

TEST_F(Export, LiberosFormHoldsWhatWasRecorded) {
  const auto [said, code] = Write("--libero " + root_ + "/libero");
  ASSERT_EQ(code, 0) << said;
  const auto file =
      LiberoDemonstrationFile::Open(root_ + "/libero/open_the_drawer_of_the_cabinet_demo.hdf5");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->instruction(), "open the drawer of the cabinet");
  ASSERT_EQ(file->demonstrations(), 2);
  const auto recorded =
      ReadEpisodeRecording(absl::StrCat(root_, kUnit, "/episodes/task0_episode1.safetensors"));
  ASSERT_TRUE(recorded.ok()) << recorded.status();
  ASSERT_EQ(file->steps(1), static_cast<int64_t>(recorded->steps.size()));
  const LiberoColumns columns = *file->ReadColumns(1);
  for (size_t t = 0; t < recorded->steps.size(); ++t) {
    for (int i = 0; i < 7; ++i) {
      EXPECT_EQ(columns.actions[7 * t + i], recorded->steps[t].commanded[i]);
      EXPECT_EQ(columns.joint_states[7 * t + i], recorded->steps[t].before.q[i]);
    }
  }
  Hdf5File hdf5 = *Hdf5File::Open(file->path());
  const auto sent = hdf5.ReadDoubles("data/demo_1/actions_sent", {file->steps(1), 7}, 1000);
  const auto measured = hdf5.ReadDoubles("data/demo_1/actions_measured", {file->steps(1), 7}, 1000);
  ASSERT_TRUE(sent.ok() && measured.ok()) << sent.status() << measured.status();
  EXPECT_EQ(*sent, columns.actions) << "nothing corrects base";
  EXPECT_NE(*measured, *sent);
  // What was measured is where the arm went: 0.05 m a unit.
  const auto& steps = recorded->steps;
  EXPECT_NEAR((*measured)[7 * 10],
              (steps[11].before.tool.p_base_tool - steps[10].before.tool.p_base_tool).x() / 0.05,
              1e-6);
}

TEST_F(Export, McapsLibrariesReadTheEpisodes) {
  const std::string folder = root_ + "/mcap";
  const auto [said, code] = Write("--mcap " + folder);
  ASSERT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr("4 episodes, "));
  const std::string file =
      folder + "/tabletop_goal-heavy_payload-L5-expert-base-s0-task3-episode1.mcap";
  const std::string recorded = absl::StrCat(root_, kUnit, "/episodes/task3_episode1.safetensors");
  recording_test::CollectedRows rows;
  const absl::Status status = ReadRecording(file, {}, &rows);
  ASSERT_TRUE(status.ok()) << status;
  const auto recording = ReadEpisodeRecording(recorded);
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ(rows.channels.size(), 11);
  std::erase_if(rows.rows, [](const auto& row) { return row.channel != "/joint_states"; });
  ASSERT_EQ(rows.rows.size(), recording->steps.size());
  for (size_t t = 0; t < rows.rows.size(); ++t) {
    EXPECT_EQ(rows.rows[t].stamp_ns, 1'000'000'000 + 50'000'000 * static_cast<int64_t>(t));
    for (int i = 0; i < 7; ++i) {
      const std::string joint = absl::StrCat("J", i + 1);
      EXPECT_EQ(rows.rows[t].values.at("position " + joint), recording->steps[t].before.q[i]);
      EXPECT_EQ(rows.rows[t].values.at("velocity " + joint), recording->steps[t].before.dq[i]);
    }
  }
  const auto [inspected, inspect] = RunProgram(BIN_DIR "/robostress-log", "inspect " + file);
  EXPECT_EQ(inspect, 0) << inspected;
  EXPECT_THAT(inspected, HasSubstr("/joint_states"));
  if (!RecordingPeersFailure().empty())
    GTEST_SKIP() << "not read back: " << RecordingPeersFailure();
  const auto [output, read] =
      RunProgram("nice -n 19 " RECORDINGS_VENV "/bin/python " EXPORT_TESTS "/read_mcap.py",
                 absl::StrCat(file, " ", recorded));
  EXPECT_EQ(read, 0) << output;
  EXPECT_THAT(output,
              HasSubstr(absl::StrCat(11 * recording->steps.size(), " messages of 11 topics in ")));
  EXPECT_THAT(output, Not(HasSubstr(" in 1 chunks"))) << "nothing to seek in";
  EXPECT_THAT(
      output,
      HasSubstr("SCHEMA CHANNEL STATISTICS CHUNK_INDEX METADATA_INDEX; heavy_payload base"));
}

TEST_F(Export, WhatCannotBeWrittenIsSaidAndNothingStays) {
  const std::string set = root_ + "/refused";
  const auto refuses = [&](const std::string& arguments, int code, const std::string& message) {
    const auto [output, got] = Write(arguments);
    EXPECT_EQ(got, code) << arguments << output;
    EXPECT_THAT(output, HasSubstr(message));
    EXPECT_FALSE(fs::exists(set)) << arguments;
  };
  refuses("", 2, "give --lerobot FOLDER");
  refuses("--lerobot " + set + " --methods ours", 2,
          "--methods ours: the run has none; it has base");
  refuses("--lerobot " + set + " --scenarios clean", 2, "it has heavy_payload");
  const std::string file = absl::StrCat(root_, kUnit, "/episodes/task3_episode1.safetensors");
  const std::string kept = *ReadFile(file);
  ASSERT_TRUE(WriteFileAtomically(file, kept.substr(0, kept.size() / 2)).ok());
  refuses(absl::StrCat("--lerobot ", set, " --libero ", set, "_libero"), 1,
          "task3_episode1.safetensors");
  EXPECT_FALSE(fs::exists(set + "_libero"));
  refuses("--mcap " + set, 1, "task3_episode1.safetensors");
  const std::string other = absl::StrCat(root_, kUnit, "/episodes/task3_episode0.safetensors");
  ASSERT_TRUE(WriteFileAtomically(file, *ReadFile(other)).ok());
  refuses("--lerobot " + set, 1,
          "is not of the episode in episodes.jsonl, but of tabletop_goal task 3 episode 0");
  fs::remove(file);
  refuses("--lerobot " + set, 1, "play the run anew into another folder with `robostress sweep");
  ASSERT_TRUE(WriteFileAtomically(file, kept).ok());
}

}  // namespace
}  // namespace robostress
