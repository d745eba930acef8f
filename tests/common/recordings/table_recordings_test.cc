// Recordings in tables: CSV, HDF5, LeRobot.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "common/atomic_file.h"
#include "common/hdf5_file.h"
#include "common/lerobot/parquet_table.h"
#include "common/recordings/recording.h"
#include "tests/common/recordings/collected_rows.h"

namespace robostress::recording_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;

std::string NewFolder(const std::string& name) {
  const fs::path folder = fs::path(testing::TempDir()) / name;
  fs::remove_all(folder);
  fs::create_directories(folder);
  return folder.string();
}

std::string TextFile(const std::string& path, const std::string& text) {
  fs::create_directories(fs::path(path).parent_path());
  std::ofstream(path, std::ios::binary) << text;
  return path;
}

absl::StatusOr<CollectedRows> RowsOf(const std::string& path, double rate_hz = 0) {
  CollectedRows rows;
  const absl::Status status = ReadRecording(path, {rate_hz}, &rows);
  if (!status.ok()) return status;
  return rows;
}

std::string Refusal(const std::string& path) {
  const auto rows = RowsOf(path);
  EXPECT_FALSE(rows.ok());
  return std::string(rows.status().message());
}

TEST(CsvRecordingTest, ReadsTheColumnsOfARigsLog) {
  const std::string folder = NewFolder("csv");
  const auto rows = RowsOf(TextFile(folder + "/a.csv",
                                    "t,q_cmd_x,q_x,dq_x,tau_x,temp_x,q_motor_y\n"
                                    "0.5,1,0.1,3,4,5,6\n0.75,2,0.2,3,4,5,6\n"));
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 2);
  EXPECT_EQ(rows->rows[1].stamp_ns, 750'000'000);
  EXPECT_THAT(rows->rows[1].values, ElementsAre(Pair("command x", 2), Pair("effort x", 4),
                                                Pair("position x", 0.2), Pair("velocity x", 3)));
  EXPECT_THAT(Refusal(TextFile(folder + "/b.csv", "time,q_x\n1,2\n")),
              HasSubstr("columns t [s] and q_JOINT are needed"));
  EXPECT_THAT(Refusal(TextFile(folder + "/c.csv", "t,q_x\n1e12,2\n2e12,3\n")),
              HasSubstr("c.csv:2: t is 1e+12, must be seconds up to 4e+09; nanoseconds? multiply "
                        "t by 1e-9"));
  const auto without = RowsOf(TextFile(folder + "/d.csv", "t,q_x\n0,1\n1,nan\n2,\n3,4\n"));
  ASSERT_TRUE(without.ok()) << without.status();
  ASSERT_EQ(without->rows.size(), 4);
  EXPECT_TRUE(std::isnan(without->rows[1].values.at("position x")));
  EXPECT_TRUE(std::isnan(without->rows[2].values.at("position x")));
  EXPECT_THAT(Refusal(TextFile(folder + "/e.csv", "t,q_x\n0,1\n1,x\n")), HasSubstr("q_x is 'x'"));
}

TEST(Hdf5RecordingTest, ReadsAlohaByItsNamesAndRate) {
  const std::string path = NewFolder("aloha") + "/episode_0.hdf5";
  auto file = Hdf5File::Create(path);
  ASSERT_TRUE(file.ok());
  std::vector<double> q(28);
  for (size_t i = 0; i < q.size(); ++i) q[i] = 0.1 * static_cast<double>(i);
  q[3] = std::nan("");
  ASSERT_TRUE(file->WriteDoubles("observations/qpos", {2, 14}, q).ok());
  ASSERT_TRUE(file->WriteDoubles("action", {2, 14}, q).ok());
  ASSERT_TRUE(file->Publish().ok());
  const auto rows = RowsOf(path);
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 2);
  EXPECT_EQ(rows->rows[1].log_ns, 20'000'000);
  EXPECT_FALSE(rows->rows[1].stamped);
  EXPECT_TRUE(std::isnan(rows->rows[0].values.at("position left_forearm_roll")));
  EXPECT_EQ(rows->rows[1].values.at("position right_gripper"), q[27]);
  EXPECT_EQ(rows->rows[1].values.at("command left_waist"), q[14]);
  EXPECT_THAT(rows->channels[0].times, HasSubstr("50 Hz, as ALOHA's code has it"));
  EXPECT_EQ(RowsOf(path, 100)->rows[1].log_ns, 10'000'000);
  EXPECT_EQ(RowsOf(fs::path(path).parent_path().string())->rows.size(), 2) << "a folder of them";
}

TEST(Hdf5RecordingTest, RefusesColumnsOfDifferentLengthAndUnknownLayouts) {
  const std::string folder = NewFolder("hdf5_bad");
  auto file = Hdf5File::Create(folder + "/a.hdf5");
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(
      file->WriteDoubles("observations/qpos", {2, 2}, std::vector<double>{1, 2, 3, 4}).ok());
  ASSERT_TRUE(file->WriteDoubles("action", {1, 2}, std::vector<double>{1, 2}).ok());
  ASSERT_TRUE(file->Publish().ok());
  EXPECT_THAT(Refusal(folder + "/a.hdf5"), HasSubstr("command has 1 rows, position has 2"));
  auto other = Hdf5File::Create(folder + "/b.hdf5");
  ASSERT_TRUE(other.ok());
  ASSERT_TRUE(other->WriteDoubles("x", {1}, std::vector<double>{1}).ok());
  ASSERT_TRUE(other->Publish().ok());
  EXPECT_THAT(Refusal(folder + "/b.hdf5"), HasSubstr("holds neither observations/qpos (ALOHA)"));
  auto empty = Hdf5File::Create(folder + "/c.hdf5");
  ASSERT_TRUE(empty.ok());
  ASSERT_TRUE(empty->WriteDoubles("data/demo_0/actions", {1, 2}, std::vector<double>{1, 2}).ok());
  ASSERT_TRUE(empty->Publish().ok());
  EXPECT_THAT(Refusal(folder + "/c.hdf5"), HasSubstr("dataset_states_to_obs.py"));
}

constexpr char kInfo[] = R"({"codebase_version": "v3.0", "fps": 30, "features": {
  "observation.state": {"dtype": "float32", "shape": [2], "names": ["a.pos", "b.pos"]},
  "action": {"dtype": "float32", "shape": [2], "names": ["a.pos", "b.pos"]}}})";

std::string LerobotSet(const std::string& name, const std::string& info) {
  const std::string folder = NewFolder(name);
  TextFile(folder + "/meta/info.json", info);
  const auto table =
      ParquetTable({{"observation.state", "", std::vector<float>{1, 2, 3, 4, 5, 6}, false, 2},
                    {"action", "", std::vector<float>{7, 8, 9, 10, 11, 12}, false, 2},
                    {"timestamp", "", std::vector<float>{0, 0.5F, 0}},
                    {"episode_index", "", std::vector<int64_t>{0, 0, 1}}});
  EXPECT_TRUE(table.ok());
  TextFile(folder + "/data/chunk-000/file-000.parquet", *table);
  return folder;
}

TEST(LerobotRecordingTest, ReadsStateAndActionByNamesAndKeepsEpisodesApart) {
  const auto rows = RowsOf(LerobotSet("lerobot", kInfo));
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 3);
  EXPECT_THAT(rows->rows[1].values, ElementsAre(Pair("command a", 9), Pair("command b", 10),
                                                Pair("position a", 3), Pair("position b", 4)));
  EXPECT_EQ(rows->rows[1].stamp_ns, 500'000'000);
  EXPECT_THAT(rows->episodes, ElementsAre("episode 0", "episode 1"));
  EXPECT_EQ(rows->channels[0].unit, "");
  EXPECT_THAT(rows->channels[0].caution, HasSubstr("an action is what was requested"));
}

absl::StatusOr<CollectedRows> RowsWith(const std::string& from, const std::string& to) {
  std::string info = kInfo;
  info.replace(info.rfind(from), from.size(), to);
  return RowsOf(LerobotSet("lerobot_names", info));
}

TEST(LerobotRecordingTest, TakesCommandsByNameInAnyOrderAndNotesOtherNames) {
  const auto turned =
      RowsWith(R"(["a.pos", "b.pos"])", R"({"first": ["b"], "a_second": ["a.pos"]})");
  ASSERT_TRUE(turned.ok()) << turned.status();
  EXPECT_THAT(turned->rows[1].values, ElementsAre(Pair("command a", 10), Pair("command b", 9),
                                                  Pair("position a", 3), Pair("position b", 4)));
  EXPECT_THAT(turned->notes, IsEmpty());
  const auto one = RowsWith("a.pos", "x.vel");
  ASSERT_TRUE(one.ok()) << one.status();
  EXPECT_THAT(one->rows[0].values,
              ElementsAre(Pair("command b", 8), Pair("position a", 1), Pair("position b", 2)));
  EXPECT_THAT(one->notes, ElementsAre(HasSubstr("info.json: features.action: not used: x.vel; ")));
  const auto none = RowsWith(R"("a.pos", "b.pos")", R"("x", "y")");
  ASSERT_TRUE(none.ok()) << none.status();
  EXPECT_THAT(none->rows[0].values, ElementsAre(Pair("position a", 1), Pair("position b", 2)));
  EXPECT_THAT(none->channels[0].caution, HasSubstr("none of their names is a joint's"));
}

TEST(LerobotRecordingTest, ReadsVelocitiesAndTorquesOfNamesThatSayThem) {
  std::string info = kInfo;
  info.replace(info.find("b.pos"), 5, "a.torque");
  const auto torque = RowsOf(LerobotSet("lerobot_torque", info));
  ASSERT_TRUE(torque.ok()) << torque.status();
  EXPECT_THAT(torque->rows[0].values,
              ElementsAre(Pair("command a", 7), Pair("effort a", 2), Pair("position a", 1)));
  info.replace(info.find("a.torque"), 8, "base.vel");
  const auto base = RowsOf(LerobotSet("lerobot_base", info));
  ASSERT_TRUE(base.ok()) << base.status();
  EXPECT_THAT(base->rows[0].values, ElementsAre(Pair("command a", 7), Pair("position a", 1)))
      << "a base's velocity is no joint's";
  EXPECT_THAT(base->notes, ElementsAre(HasSubstr("not used: base.vel"), HasSubstr("b.pos")));
}

TEST(LerobotRecordingTest, NotesWhatInfoCountsAndTheFilesLack) {
  const auto notes = [](const std::string& counts) {
    std::string info = kInfo;
    info.replace(info.find("\"fps\""), 5, counts + ", \"fps\"");
    const auto rows = RowsOf(LerobotSet("lerobot_missing", info));
    EXPECT_TRUE(rows.ok()) << rows.status();
    return rows.ok() ? rows->notes : std::vector<std::string>();
  };
  EXPECT_THAT(notes(R"("total_episodes": 2, "total_frames": 3)"), IsEmpty());
  EXPECT_THAT(notes(R"("total_episodes": 6)"),
              ElementsAre(HasSubstr("2 of 6 episodes are here, 2 to 5 are missing; download")));
  EXPECT_THAT(notes(R"("total_episodes": 3)"), ElementsAre(HasSubstr("here, 2 is missing")));
  EXPECT_THAT(notes(R"("total_episodes": 2, "total_frames": 9)"),
              ElementsAre(HasSubstr("3 of 9 frames are here")));
}

TEST(LerobotRecordingTest, NamesTheFieldOfInfoThatIsWrong) {
  const auto with = [](const std::string& from, const std::string& to) {
    std::string info = kInfo;
    info.replace(info.find(from), from.size(), to);
    return Refusal(LerobotSet("lerobot_bad", info));
  };
  EXPECT_THAT(with("v3.0", "v1.6"), HasSubstr("codebase_version is \"v1.6\"; read are v2 and v3"));
  EXPECT_THAT(with("\"fps\": 30", "\"fps\": 0"), HasSubstr("fps is 0"));
  EXPECT_THAT(with("\"fps\": 30", "\"fps\": 30, \"storage_format\": \"lance\""),
              HasSubstr("storage_format is \"lance\"; read is parquet"));
  EXPECT_THAT(with("[2]", "[3]"), HasSubstr("a list has not 3 numbers"));
  EXPECT_THAT(with("[2]", "[1000]"), HasSubstr("shape is [1000], must be [joints]"));
  EXPECT_THAT(with("float32", "int8"), HasSubstr("dtype is \"int8\""));
  EXPECT_THAT(with("observation.state", "observation.other"),
              HasSubstr("has neither observation.state nor observation.joints"));
  EXPECT_THAT(with("{", "["), HasSubstr("info.json"));
  const std::string folder = NewFolder("lerobot_empty");
  TextFile(folder + "/meta/info.json", kInfo);
  EXPECT_THAT(Refusal(folder), HasSubstr("has no .parquet file below data/"));
}

}  // namespace
}  // namespace robostress::recording_test
