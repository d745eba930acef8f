#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <string>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace fs = std::filesystem;

class RecordProgram : public ::testing::Test {
 protected:
  RecordProgram() : folder_(fs::path(::testing::TempDir()) / "record_program") {
    fs::remove_all(folder_);
  }
  ~RecordProgram() override { fs::remove_all(folder_); }

  std::string Command(const std::string& more) const {
    return absl::StrCat("--suite tabletop_goal --image-size 16 --out ", folder_.string(), " ",
                        more);
  }
  std::pair<std::string, int> Record(const std::string& more) const {
    return RunProgram(ROBOSTRESS_RECORD, Command(more));
  }
  fs::path File(int task, const char* ending) const {
    return folder_ / absl::StrCat("tabletop_goal_task0", task, "_expert_1000.", ending);
  }

  fs::path folder_;
};

TEST_F(RecordProgram, GoesOnWhereItWas) {
  for (const auto& [form, ending] :
       {std::pair("shards", "safetensors"), std::pair("hdf5", "hdf5")}) {
    const std::string format = absl::StrCat(" --format ", form);
    const auto [output, code] = Record("--tasks 0 --episodes 2" + format);
    if (absl::StrContains(output, "EGL")) GTEST_SKIP() << output;
    ASSERT_EQ(code, 0) << output;
    const auto written = fs::last_write_time(File(0, ending));
    const auto [again, same] = Record("--tasks 0,4 --episodes 2" + format);
    EXPECT_EQ(same, 0) << again;
    EXPECT_THAT(again, AllOf(HasSubstr("is recorded: " + File(0, ending).string()),
                             Not(HasSubstr("is recorded: " + File(4, ending).string()))));
    EXPECT_EQ(fs::last_write_time(File(0, ending)), written);
    EXPECT_TRUE(fs::exists(File(4, ending)));
    const auto [longer, more] = Record("--tasks 0 --episodes 3" + format);
    EXPECT_EQ(more, 0) << longer;
    EXPECT_NE(fs::last_write_time(File(0, ending)), written) << longer;
  }
}

TEST_F(RecordProgram, RefusesStatesThatAreNotThereBeforeItPlays) {
  const auto [output, code] = Record("--eval --tasks 0 --first-draw 998 --episodes 3");
  EXPECT_EQ(code, 2) << output;
  EXPECT_THAT(output,
              HasSubstr("--first-draw 998 --episodes 3: tabletop_goal task 0 has initial "));
  EXPECT_THAT(output, Not(HasSubstr("success")));
}

// Of the signals that a user or a scheduler sends, to one process and to one of workers.
TEST_F(RecordProgram, LeavesNothingHalfDoneWhereItIsInterrupted) {
  for (const std::string signal : {"INT", "TERM"}) {
    for (const std::string workers : {"1", "2"}) {
      const std::string log = (folder_ / "log").string();
      fs::create_directories(folder_);
      const std::string pid =
          RunProgram("sh", absl::StrCat("-c '", ROBOSTRESS_RECORD, " ",
                                        Command("--tasks 0,4 --episodes 100000 --format hdf5"),
                                        " --workers ", workers, " >", log, " 2>&1 & echo $!'"))
              .first;
      const auto writes = [&](int task) {
        for (const auto& entry : fs::directory_iterator(folder_))
          if (absl::StrContains(entry.path().string(), absl::StrCat("task0", task))) return true;
        return false;
      };
      const auto wait_for = [](const std::function<bool()>& done) {
        for (int i = 0; i < 600 && !done(); ++i)
          std::this_thread::sleep_for(std::chrono::milliseconds(50));
        return done();
      };
      const bool started = wait_for([&] {
        return (writes(0) && (workers == "1" || writes(4))) || ReadFile(log).value_or("") != "";
      });
      if (absl::StrContains(ReadFile(log).value_or(""), "EGL")) GTEST_SKIP() << *ReadFile(log);
      ASSERT_TRUE(started);
      RunProgram("kill", absl::StrCat("-", signal, " ", pid.substr(0, pid.find('\n'))));
      EXPECT_TRUE(wait_for([&] { return !writes(0) && !writes(4); })) << signal << workers;
      const std::string said = ReadFile(log).value_or("");
      EXPECT_THAT(said, HasSubstr("record: interrupted in tabletop_goal task 0, "));
      EXPECT_THAT(said, HasSubstr("the same command records it anew and goes on"));
    }
  }
}

}  // namespace
}  // namespace robostress
