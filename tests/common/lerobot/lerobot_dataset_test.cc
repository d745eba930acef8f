#include "common/lerobot/lerobot_dataset.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <memory>

#include "common/atomic_file.h"
#include "common/image.h"
#include "common/lerobot/feature_statistics.h"
#include "common/lerobot/parquet_table.h"
#include "tests/common/lerobot/read_back.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

std::string Fresh(const std::string& name) {
  const std::string path = ::testing::TempDir() + "/lerobot_" + name;
  fs::remove_all(path);
  return path;
}

LerobotEpisode Episode(const std::string& instruction, int steps, double offset = 0) {
  LerobotEpisode episode;
  episode.instruction = instruction;
  episode.success = true;
  episode.steps = static_cast<size_t>(steps);
  episode.vectors.resize(2);
  episode.width = {64, 32};
  episode.height = {48, 32};
  episode.pictures.resize(2);
  episode.small.resize(2);
  for (int i = 0; i < steps; ++i) {
    for (int v = 0; v < 2; ++v)
      episode.vectors[v].insert(episode.vectors[v].end(), 7,
                                static_cast<float>(offset + 0.01 * (i + v)));
    for (size_t c = 0; c < 2; ++c) {
      Image image{episode.width[c], episode.height[c], {}};
      image.data.assign(size_t{3} * image.width * image.height, static_cast<uint8_t>(40 + 5 * i));
      episode.pictures[c].push_back(*EncodePng(image));
      image.width = image.height = 16;
      image.data.resize(size_t{3} * 16 * 16);
      episode.small[c].push_back(image);
    }
  }
  return episode;
}

LerobotSchema Schema() {
  const std::vector<std::string> axes = {"a", "b", "c", "d", "e", "f", "gripper"};
  return {"piper", 30, {{"observation.state", axes}, {"action", axes}}, {"base", "wrist"}};
}

absl::StatusOr<LerobotDataset> OpenAt(const std::string& path) {
  return LerobotDataset::Open(path, Schema());
}

TEST(LerobotDatasetTest, LerobotsOwnLibrariesReadWhatIsWritten) {
  if (!ReaderFailure().empty())
    GTEST_SKIP() << "needs python3-venv and PyPI for datasets: " << ReaderFailure();
  const std::string path = Fresh("read");
  {
    auto set = OpenAt(path);
    ASSERT_TRUE(set.ok()) << set.status();
    ASSERT_TRUE(set->Append(Episode("open the drawer", 20)).ok());
    ASSERT_TRUE(set->Append(Episode("close the drawer", 33, -1)).ok());
  }
  auto again = OpenAt(path);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->episodes(), 2);
  LerobotEpisode failed = Episode("open the drawer", 7, 3);
  failed.success = false;
  ASSERT_TRUE(again->Append(failed).ok());
  const auto [output, code] = ReadBack(path);
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("episode 0: 'open the drawer' length 20 success True state 0.190 "
                                "action 0.200"));
  EXPECT_THAT(output, HasSubstr("episode 1: 'close the drawer' length 33 success True state -0.680 "
                                "action -0.670"));
  EXPECT_THAT(output, HasSubstr("episode 2: 'open the drawer' length 7 success False state 3.060"));
}

TEST(LerobotDatasetTest, AKilledProcessLosesTheEpisodeUnderWayAndNoOther) {
  const std::string path = Fresh("killed");
  const LerobotEpisode episode = Episode("open the drawer", 60);
  int64_t before = 0;
  int killed_in_append = 0;
  for (int round = 0; round < 25; ++round) {
    int pipe_ends[2];
    ASSERT_EQ(pipe(pipe_ends), 0);
    const pid_t child = fork();
    if (child == 0) {
      auto set = OpenAt(path);
      if (!set.ok()) _exit(3);
      for (;;) {
        if (!set->Append(episode).ok()) _exit(4);
        if (write(pipe_ends[1], "x", 1) != 1) _exit(5);
      }
    }
    close(pipe_ends[1]);
    usleep(static_cast<useconds_t>(20'000 + 3'700 * round));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "exit code " << WEXITSTATUS(status);
    int64_t acknowledged = 0;
    for (char byte; read(pipe_ends[0], &byte, 1) == 1;) ++acknowledged;
    close(pipe_ends[0]);
    if (fs::exists(path + absl::StrCat("/data/chunk-000/file-",
                                       absl::Dec(before + acknowledged, absl::kZeroPad3),
                                       ".parquet")))
      ++killed_in_append;
    auto set = OpenAt(path);
    ASSERT_TRUE(set.ok()) << set.status();
    EXPECT_GE(set->episodes(), before + acknowledged) << "what was acknowledged is there";
    EXPECT_LE(set->episodes(), before + acknowledged + 1);
    EXPECT_EQ(set->frames(), 60 * set->episodes());
    before = set->episodes();
    for (const char* folder : {"/data", "/meta/episodes"}) {
      int64_t files = 0;
      if (fs::exists(path + folder + "/chunk-000")) {
        for ([[maybe_unused]] const auto& entry :
             fs::directory_iterator(path + folder + "/chunk-000"))
          ++files;
      }
      EXPECT_EQ(files, before) << folder << ": nothing half written stays";
    }
  }
  EXPECT_GT(before, 0);
  std::cout << before << " episodes, killed in mid-append " << killed_in_append << " of 25 times\n";
  if (!ReaderFailure().empty()) GTEST_SKIP() << "not read back: " << ReaderFailure();
  const auto [output, code] = ReadBack(path);
  EXPECT_EQ(code, 0) << output;
}

TEST(LerobotDatasetTest, AnEpisodeThatWasLeftHalfIsRemoved) {
  const std::string path = Fresh("half");
  for (const char* file : {"/file-000.parquet", "/file-001.parquet"}) {
    const std::string left = path + "/data/chunk-000" + file;
    ASSERT_TRUE(OpenAt(path).ok());
    fs::create_directories(path + "/data/chunk-000");
    ASSERT_TRUE(WriteFileAtomically(left, "half").ok());
    auto set = OpenAt(path);
    ASSERT_TRUE(set.ok()) << set.status();
    EXPECT_FALSE(fs::exists(left));
    EXPECT_TRUE(set->Append(Episode("a", 3)).ok());
  }
}

TEST(LerobotDatasetTest, DataWithoutItsInfoIsNotOursAndStays) {
  const auto refused = [](const std::string& path, const std::string& file) {
    const auto set = OpenAt(path);
    EXPECT_EQ(set.status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_THAT(std::string(set.status().message()), HasSubstr(path + " holds data without"));
    EXPECT_TRUE(fs::exists(path + file));
  };
  const std::string file = "/data/chunk-000/file-000.parquet", theirs = Fresh("theirs");
  fs::create_directories(theirs + "/data/chunk-000");
  ASSERT_TRUE(WriteFileAtomically(theirs + file, "all episodes of somebody else").ok());
  refused(theirs, file);
  EXPECT_FALSE(fs::exists(theirs + "/meta")) << "nothing of ours is put there either";
  const std::string lost = Fresh("lost");
  {
    auto set = OpenAt(lost);
    ASSERT_TRUE(set.ok() && set->Append(Episode("a", 3)).ok());
  }
  fs::remove(lost + "/meta/info.json");
  refused(lost, file);
}

TEST(LerobotDatasetTest, ThereIsOneRecorderAFolder) {
  const std::string path = Fresh("two");
  auto first = std::make_unique<absl::StatusOr<LerobotDataset>>(OpenAt(path));
  ASSERT_TRUE(first->ok()) << first->status();
  const auto second = OpenAt(path);
  EXPECT_EQ(second.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(second.status().message()),
              HasSubstr("another recorder has " + path +
                        " open, and there is one recorder a "
                        "folder"));
  // A child that was forked meanwhile, as by a worker pool, neither frees the folder nor keeps it.
  int go_on[2];
  ASSERT_EQ(pipe(go_on), 0);
  const auto child_that_waits = [&] {
    const pid_t child = fork();
    if (child == 0) {
      close(go_on[1]);
      char byte = 0;
      _exit(read(go_on[0], &byte, 1) == 0 ? 0 : 1);
    }
    return child;
  };
  const auto child_that_frees = [&] {
    const pid_t child = fork();
    if (child == 0) {
      first.reset();
      _exit(0);
    }
    return child;
  };
  int status = 0;
  const pid_t waiting = child_that_waits();
  ASSERT_EQ(waitpid(child_that_frees(), &status, 0) > 0, true);
  EXPECT_FALSE(OpenAt(path).ok()) << "the parent has it still";
  first.reset();
  EXPECT_TRUE(OpenAt(path).ok()) << "the parent has closed it";
  close(go_on[1]);
  waitpid(waiting, &status, 0);
}

TEST(LerobotDatasetTest, RefusesAnotherSchemaAndNamesTheValues) {
  const std::string path = Fresh("schema");
  auto set = OpenAt(path);
  ASSERT_TRUE(set.ok() && set->Append(Episode("a", 3)).ok());
  const auto fails = [&](const absl::Status& status, const std::string& text) {
    EXPECT_THAT(std::string(status.message()), HasSubstr(text));
  };
  const auto other = [](auto change) {
    LerobotSchema schema = Schema();
    change(schema);
    return schema;
  };
  const auto open = [](const std::string& at, const LerobotSchema& schema) {
    return LerobotDataset::Open(at, schema).status();
  };
  fails(open(path, other([](auto& s) { s.rate_hz = 20; })),
        "info.json: fps is 30, this recording has 20");
  fails(open(path, other([](auto& s) { s.cameras.pop_back(); })),
        "info.json: feature observation.images.wrist is");
  fails(open(path, other([](auto& s) {
               s.vectors.push_back({"action.sent", {"x"}});
             })),
        "info.json: feature action.sent is \"not there\", this recording has [\"x\"]");
  fails(open(path, other([](auto& s) { s.vectors[1].axes.pop_back(); })), "feature action is");
  fails(open(path, other([](auto& s) { s.robot = "panda"; })), "robot_type");
  fails(open(Fresh("name"), other([](auto& s) { s.cameras[0] = "a/b"; })), "camera 'a/b'");
  fails(open(Fresh("rate"), other([](auto& s) { s.rate_hz = 29.97; })), "whole number");
  LerobotEpisode larger = Episode("a", 3);
  larger.width[0] = 128;
  fails(set->Append(larger), "observation.images.base is [48,64,3], this recording has [48,128,3]");
  EXPECT_EQ(set->episodes(), 1);
  set = absl::CancelledError("closed");
  const std::string file = path + "/meta/info.json";
  const nlohmann::ordered_json whole = nlohmann::ordered_json::parse(ReadFile(file).value());
  const auto damaged = [&](const char* place, const nlohmann::ordered_json& value) {
    nlohmann::ordered_json info = whole;
    info[nlohmann::ordered_json::json_pointer(place)] = value;
    EXPECT_TRUE(WriteFileAtomically(file, info.dump()).ok());
    absl::StatusOr<LerobotDataset> again = OpenAt(path);
    return again.ok() ? again->Append(Episode("a", 3)) : again.status();
  };
  fails(damaged("/robostress/tasks", {5}), "info.json: robostress holds no list of texts, tasks");
  fails(damaged("/robostress/statistics", 5), "or no object, statistics");
  fails(damaged("/robostress/statistics/action/mean", {"x"}), "robostress.statistics.action: ");
  ASSERT_TRUE(WriteFileAtomically(file, "{\"fps\": 30}").ok());
  fails(OpenAt(path).status(), "is not a data set that RoboStress recorded");
}

TEST(LerobotDatasetTest, AFailedAppendLeavesTheSetAsItWas) {
  const std::string path = Fresh("failed");
  auto set = OpenAt(path);
  ASSERT_TRUE(set.ok() && set->Append(Episode("a", 3)).ok());
  const std::string info = *ReadFile(path + "/meta/info.json");
  // Where the file of the second episode's row should be is a folder.
  fs::create_directories(path + "/meta/episodes/chunk-000/file-001.parquet/x");
  EXPECT_FALSE(set->Append(Episode("b", 3)).ok());
  EXPECT_EQ(*ReadFile(path + "/meta/info.json"), info);
  EXPECT_FALSE(fs::exists(path + "/data/chunk-000/file-001.parquet"));
  fs::remove_all(path + "/meta/episodes/chunk-000/file-001.parquet");
  EXPECT_TRUE(set->Append(Episode("b", 3)).ok());
}

TEST(ParquetTableTest, RefusesColumnsOfDifferentLength) {
  const auto table = ParquetTable({{"a", "", std::vector<int64_t>{1, 2}},
                                   {"b", "", std::vector<float>{1, 2, 3, 4, 5}, false, 2}});
  EXPECT_THAT(std::string(table.status().message()), HasSubstr("column b has 5 values for 2 rows"));
}

TEST(FeatureStatisticsTest, JoinedAreThoseOfAllRows) {
  const std::vector<double> a = {1, 10, 2, 20, 4, 10}, b = {-3, 5, 8, 6};
  std::vector<double> both = a;
  both.insert(both.end(), b.begin(), b.end());
  const auto joined = JoinStatistics(VectorStatistics(a, 2), VectorStatistics(b, 2));
  const auto whole = VectorStatistics(both, 2);
  for (const char* key : {"min", "max", "mean", "std"}) {
    for (int i = 0; i < 2; ++i)
      EXPECT_NEAR(joined[key][i].get<double>(), whole[key][i].get<double>(), 1e-12) << key;
  }
  EXPECT_EQ(joined["count"][0], 5);
}

}  // namespace
}  // namespace robostress
