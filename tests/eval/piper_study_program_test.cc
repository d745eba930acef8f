// The experiments on emulated arms from the scene to the table, as one command; thin, so that its
// numbers mean nothing.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "common/atomic_file.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(PiperStudyProgram, GoesFromDemonstrationsToTheTableAndRepeatsNothing) {
  const std::string out = ::testing::TempDir() + "/piper_study_program";
  fs::remove_all(out);
  const std::string arguments =
      "--quick --experiments main --episodes 1 --demonstrations 1 --set train_steps=2 --set "
      "tune_steps=1 --set episode_s=0.5 --out " +
      out;
  const auto [text, code] = RunProgram(PIPER_STUDY, arguments);
  if (text.find("EGL") != std::string::npos) GTEST_SKIP() << text;
  ASSERT_EQ(code, 0) << text;
  for (const char* file :
       {"study.yaml", "demos/new_bowl_next_to_plate.safetensors", "train/base/nano.safetensors",
        "train/robust/nano.safetensors", "units/main_new_1_ours/DONE", "report.json", "report.md"})
    EXPECT_TRUE(fs::exists(out + "/" + file)) << file;
  const auto csv = ReadFile(out + "/episodes.csv");
  ASSERT_TRUE(csv.ok()) << csv.status();
  EXPECT_THAT(*csv, AllOf(HasSubstr("new,nano,base,1,0,0,"), HasSubstr("new,nano,robust,1,0,0,"),
                          HasSubstr("new,nano,ours,1,0,0,")));

  // What is done is not done again; what is lost comes back, to the byte.
  const auto [again, second] = RunProgram(PIPER_STUDY, arguments);
  EXPECT_EQ(second, 0) << again;
  EXPECT_THAT(again, Not(HasSubstr("done (")));
  fs::remove_all(out + "/units/main_new_1_ours");
  const auto [repaired, third] = RunProgram(PIPER_STUDY, arguments);
  EXPECT_EQ(third, 0) << repaired;
  EXPECT_THAT(repaired, AllOf(HasSubstr("main_new_1_ours done"), Not(HasSubstr("train_"))));
  EXPECT_EQ(*ReadFile(out + "/episodes.csv"), *csv);
}

TEST(PiperStudyProgram, RefusesBadInput) {
  const std::string out = " --out " + ::testing::TempDir() + "/piper_study_refused";
  auto [text, code] = RunProgram(PIPER_STUDY, "--tasks 9" + out);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("1 to 4"));
  std::tie(text, code) = RunProgram(PIPER_STUDY, "--set arm=new" + out);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("arms"));
  std::tie(text, code) = RunProgram(PIPER_STUDY, "--dry-run" + out);
  EXPECT_EQ(code, 0);
  EXPECT_THAT(text, HasSubstr("29 units of 25 episodes"));
  EXPECT_EQ(RunProgram(PIPER_STUDY, "--help").second, 0);
}

}  // namespace
}  // namespace robostress
