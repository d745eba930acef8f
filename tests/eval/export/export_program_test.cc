// A sweep that records, and its episodes as data sets: the programs, as a person starts them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/lerobot/parquet_reader.h"
#include "common/libero/demonstrations.h"
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

TEST_F(Export, VerifyReadsTheRecordings) {
  const std::string run = root_ + "/rotten";
  fs::remove_all(run);
  fs::copy(root_ + "/run", run, fs::copy_options::recursive);
  const auto verify = [&] { return RunProgram(BIN_DIR "/robostress-store", "verify " + run); };
  EXPECT_EQ(verify().second, 0) << verify().first;
  const std::string episodes = run + fs::path(kUnit).string().substr(4) + "/episodes";
  fs::copy_file(episodes + "/task3_episode1.safetensors", episodes + "/task3_episode0.safetensors",
                fs::copy_options::overwrite_existing);
  EXPECT_EQ(verify().second, 3);
  EXPECT_THAT(verify().first, HasSubstr("task3_episode0.safetensors: task 3, episode 1, "));
  fs::resize_file(episodes + "/task0_episode0.safetensors", 20000);
  fs::remove(episodes + "/task0_episode1.safetensors");
  EXPECT_EQ(verify().second, 3);
  EXPECT_THAT(verify().first, testing::AllOf(HasSubstr("task0_episode0.safetensors"),
                                             HasSubstr("(and 2 more recorded episodes)")));
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
  EXPECT_THAT(*hdf5.StringAttribute("data/demo_1", "origin"),
              HasSubstr("\"scenario\":\"heavy_payload\",\"severity\":5,\"method\":\"base\""));
  EXPECT_NE(*measured, *sent);
  // What was measured is where the arm went: 0.05 m a unit.
  const auto& steps = recorded->steps;
  EXPECT_NEAR((*measured)[7 * 10],
              (steps[11].before.tool.p_base_tool - steps[10].before.tool.p_base_tool).x() / 0.05,
              1e-6);
}

// LIBERO stores its views unmirrored and no proprioception of ours, so its readers see what they
// know.
TEST_F(Export, ARecordingOfLiberosSuitesIsStoredAsLiberoStores) {
  fs::create_directories(root_ + "/as_libero");
  fs::copy(root_ + "/run", root_ + "/as_libero/run", fs::copy_options::recursive);
  const std::string name = "/episodes/task0_episode1.safetensors";
  const std::string episode = absl::StrCat(root_, "/as_libero", kUnit, name);
  for (const auto& file : fs::directory_iterator(fs::path(episode).parent_path())) {
    EpisodeRecording recording = *ReadEpisodeRecording(file.path().string());
    recording.problem = "libero_tabletop_manipulation";
    ASSERT_TRUE(WriteEpisodeRecording(recording, file.path().string()).ok());
  }
  const std::string file = "/open_the_drawer_of_the_cabinet_demo.hdf5";
  for (const std::string& run : {root_, root_ + "/as_libero"}) {
    const auto [said, code] =
        RunProgram(BIN_DIR "/robostress-export",
                   absl::StrCat(run, "/run --libero ", root_, run == root_ ? "/ours" : "/theirs"));
    ASSERT_EQ(code, 0) << said;
  }
  const auto ours = LiberoDemonstrationFile::Open(root_ + "/ours" + file);
  const auto theirs = LiberoDemonstrationFile::Open(root_ + "/theirs" + file);
  ASSERT_TRUE(ours.ok() && theirs.ok()) << ours.status() << theirs.status();
  EXPECT_TRUE(ours->has_proprioception());
  EXPECT_FALSE(theirs->has_proprioception());
  for (const auto view :
       {LiberoDemonstrationFile::View::kAgent, LiberoDemonstrationFile::View::kEyeInHand}) {
    const Image picture = *ours->ReadView(1, view, 5);
    EXPECT_EQ(theirs->ReadView(1, view, 5)->data, MirrorColumns(picture).data);
    EXPECT_NE(picture.data, MirrorColumns(picture).data);
  }
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

// A run of robot_client with three ticks, the first before the arm has power, four samples and the
// pictures of two requests; of a third nothing was shown, of a fourth nothing was kept.
void WriteArmRun(const std::string& folder) {
  fs::create_directories(folder);
  const std::vector<std::string> axes = {"J1", "J2", "J3", "J4", "J5", "J6", "gripper"};
  std::string ticks =
      "t,tick,due,wake_us,sent_us,state,cause,flags,limiter,faults,episode,chunk,row,prediction,"
      "stamp,sequence";
  for (const char* group :
       {"policy", "requested", "blended", "corrected", "sent", "q", "dq", "tau", "excess"})
    for (const std::string& axis : axes) absl::StrAppend(&ticks, ",", group, "_", axis);
  ticks += ",delay\n";
  for (int tick = 0; tick < 3; ++tick) {
    absl::StrAppend(&ticks, 0.02 * tick, ",", tick, ",0,12.5,40,", tick == 0 ? "IDLE" : "RUN",
                    ",operator,0,0,0,", tick, ",1,2,0,0,1");
    for (int group = 0; group < 9; ++group)
      for (int axis = 0; axis < 7; ++axis)
        absl::StrAppend(&ticks, ",",
                        tick == 0 && group < 5 ? "" : absl::StrCat(group + 0.1 * axis + 10 * tick));
    ticks += tick == 0 ? ",\n" : ",0.05\n";
  }
  std::string samples = "t,sequence";
  for (const char* group : {"q", "dq", "tau"})
    for (const std::string& axis : axes) absl::StrAppend(&samples, ",", group, "_", axis);
  samples += "\n";
  for (int sample = 0; sample < 4; ++sample) {
    absl::StrAppend(&samples, 0.015 * sample - 0.005, ",", sample);
    for (int value = 0; value < 21; ++value) absl::StrAppend(&samples, ",", 100 * sample + value);
    samples += "\n";
  }
  ASSERT_TRUE(WriteFileAtomically(folder + "/ticks.csv", ticks).ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/samples.csv", samples).ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/config.yaml", "bus: none\n").ok());
  ASSERT_TRUE(WriteFileAtomically(
                  folder + "/frames.csv",
                  "t,request,prediction,episode,chunk,camera,use,sequence,stamp,age_ms,picture\n"
                  "0.010,1,1,0,0,wrist,shown,8,-0.015,25.0,pictures/000001_wrist.png\n"
                  "0.020,2,,0,1,wrist,missing,,,,\n"
                  "0.025,3,2,0,1,wrist,shown,9,0.015,10.0,\n"
                  "0.060,4,3,0,2,wrist,shown,10,0.050,10.0,pictures/000004_wrist.png\n")
                  .ok());
  fs::create_directories(folder + "/pictures");
  for (const int request : {1, 4}) {
    const Image picture{2, 1, {1, 2, 3, 4, 5, static_cast<uint8_t>(request)}};
    ASSERT_TRUE(WriteFileAtomically(absl::StrCat(folder, "/pictures/00000", request, "_wrist.png"),
                                    *EncodePng(picture))
                    .ok());
  }
}

TEST_F(Export, AnArmsRunIsOneFile) {
  const std::string run = root_ + "/tuesday", out = root_ + "/tuesday_mcap";
  WriteArmRun(run);
  const auto [said, code] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --mcap ", out));
  ASSERT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr("3 ticks, 4 samples of the arm, 2 pictures"));
  recording_test::CollectedRows rows;
  const absl::Status status = ReadRecording(out + "/tuesday.mcap", {}, &rows);
  ASSERT_TRUE(status.ok()) << status;
  std::erase_if(rows.rows, [](const auto& row) { return row.channel != "/joint_states"; });
  ASSERT_EQ(rows.rows.size(), 4u);
  EXPECT_EQ(rows.rows[0].stamp_ns, 1'010'000'000) << "the first picture was taken 10 ms before";
  EXPECT_EQ(rows.rows[3].stamp_ns, 1'055'000'000);
  EXPECT_EQ(rows.rows[3].values.at("position J2"), 301);
  EXPECT_EQ(rows.rows[3].values.at("velocity J1"), 307);
  EXPECT_EQ(rows.rows[3].values.at("effort gripper"), 320);
  if (RecordingPeersFailure().empty()) {
    const auto [read, readers] =
        RunProgram("nice -n 19 " RECORDINGS_VENV "/bin/python " EXPORT_TESTS "/read_arm_mcap.py",
                   absl::StrCat(out, "/tuesday.mcap ", run, "/pictures/000004_wrist.png"));
    EXPECT_EQ(readers, 0) << read;
    for (const char* line :
         {"/client 3\n", "/joint_states 4\n", "/joints/sent 2\n", "/joints/measured 3\n",
          "sent 24.0 24.5 24.6\n", "client RUN operator 2.0 0.05\n", "/camera/wrist 2\n",
          "picture png 1.065 shown at 1.075 as on disk\n"})
      EXPECT_THAT(read, HasSubstr(line));
  }
  fs::remove(run + "/pictures/000001_wrist.png");
  fs::remove_all(out);
  const auto [fewer, still] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --mcap ", out));
  EXPECT_EQ(still, 0) << fewer;
  EXPECT_THAT(fewer, HasSubstr("1 pictures\n1 pictures that frames.csv names are not there"));
  for (const char* file : {"pictures/../../secret.png", "/etc/passwd"}) {
    ASSERT_TRUE(WriteFileAtomically(run + "/frames.csv",
                                    absl::StrCat("t,camera,stamp,picture\n0,wrist,0,", file, "\n"))
                    .ok());
    fs::remove_all(out);
    const auto [elsewhere, refused] =
        RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --mcap ", out));
    EXPECT_EQ(refused, 2) << elsewhere;
    EXPECT_THAT(elsewhere, HasSubstr("frames.csv:2: picture is '"));
  }
  fs::rename(run + "/frames.csv", run + "/frames.csv.partial");
  ASSERT_TRUE(WriteFileAtomically(run + "/frames.csv.partial", "t,camera").ok());
  // What was cut off is read up to there; what is wrong in it has its place.
  fs::rename(run + "/ticks.csv", run + "/ticks.csv.partial");
  fs::remove(run + "/samples.csv");
  const std::string ticks = *ReadFile(run + "/ticks.csv.partial");
  ASSERT_TRUE(
      WriteFileAtomically(run + "/ticks.csv.partial", ticks.substr(0, ticks.size() - 40)).ok());
  fs::remove_all(out);
  const auto [cut, rest] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --mcap ", out));
  EXPECT_EQ(rest, 0) << cut;
  EXPECT_THAT(cut, HasSubstr("2 ticks, 0 samples"));
  std::string wrong = ticks;
  wrong.replace(wrong.find("24.1"), 4, "fast");
  ASSERT_TRUE(WriteFileAtomically(run + "/ticks.csv.partial", wrong).ok());
  fs::remove_all(out);
  const auto [bad, refused] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --mcap ", out));
  EXPECT_EQ(refused, 2) << bad;
  EXPECT_THAT(bad, HasSubstr("ticks.csv.partial:4: sent_J2 is 'fast'"));
  EXPECT_FALSE(fs::exists(out));
  const auto [set, wanted] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --lerobot ", out));
  EXPECT_EQ(wanted, 2);
  EXPECT_THAT(set, HasSubstr("is a run of robot_client"));
}

// LIBERO-PRO's variants of a task have its name.
TEST_F(Export, TasksOfTwoSuitesDoNotShareAFile) {
  const std::string run = root_ + "/two_suites/run", unit = root_ + "/two_suites" + kUnit;
  fs::create_directories(root_ + "/two_suites");
  fs::copy(root_ + "/run", run, fs::copy_options::recursive);
  std::string other = unit;
  other.replace(other.find("tabletop_goal"), 13, "tabletop_long");
  fs::copy(unit, other, fs::copy_options::recursive);
  const std::vector<std::pair<std::string, std::string>> renamed = {
      {"tabletop_goal", "tabletop_long"}};
  for (const char* name : {"/config.yaml", "/episodes.jsonl"}) {
    ASSERT_TRUE(
        WriteFileAtomically(other + name, absl::StrReplaceAll(*ReadFile(other + name), renamed))
            .ok());
  }
  ASSERT_TRUE(WriteFileAtomically(other + "/DONE",
                                  absl::StrReplaceAll(*ReadFile(other + "/DONE"),
                                                      {{*Sha256OfFile(unit + "/episodes.jsonl"),
                                                        *Sha256OfFile(other + "/episodes.jsonl")}}))
                  .ok());
  for (const auto& file : fs::directory_iterator(other + "/episodes")) {
    EpisodeRecording recording = *ReadEpisodeRecording(file.path().string());
    recording.suite = "tabletop_long";
    ASSERT_TRUE(WriteEpisodeRecording(recording, file.path().string()).ok());
  }
  const auto [said, code] =
      RunProgram(BIN_DIR "/robostress-export", absl::StrCat(run, " --libero ", root_, "/two"));
  EXPECT_EQ(code, 2) << said;
  EXPECT_THAT(said, HasSubstr("suites tabletop_goal and tabletop_long both have a task "));
  EXPECT_FALSE(fs::exists(root_ + "/two"));
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
