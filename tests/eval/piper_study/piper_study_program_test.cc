// The experiments on emulated arms from the scene to the table, as one command; thin, so that its
// numbers mean nothing.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

const std::string kOurs = "units/piper_1_next_to_plate-new-L5-piper-base-ours-s0";

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
  for (const std::string& file : std::vector<std::string>{
           "study.yaml", "demos/new_bowl_next_to_plate.safetensors", "train/base/nano.safetensors",
           "train/robust/nano.safetensors", "train/piper-robust.safetensors", kOurs + "/DONE",
           "report.json", "report.md", "report.html", "tables/real-arm.csv", "sweep.yaml",
           "timings.csv"})
    EXPECT_TRUE(fs::exists(out + "/" + file)) << file;
  const auto csv = ReadFile(out + "/episodes.csv");
  ASSERT_TRUE(csv.ok()) << csv.status();
  for (const char* cell : {",base,0,0,0,0,", ",ours,0,0,0,0,"})
    EXPECT_THAT(*csv, HasSubstr(absl::StrCat("/train/piper-base.safetensors", cell)));
  EXPECT_THAT(*csv, HasSubstr("/train/piper-robust.safetensors,base,0,0,0,0,"));

  // What is done is not done again; what is lost comes back, to the byte.
  const auto [again, second] = RunProgram(PIPER_STUDY, arguments);
  EXPECT_EQ(second, 0) << again;
  EXPECT_THAT(again, AllOf(Not(HasSubstr("train_")), HasSubstr("1 of 1 units were already done")));
  fs::remove_all(out + "/" + kOurs);
  const auto [repaired, third] = RunProgram(PIPER_STUDY, arguments);
  EXPECT_EQ(third, 0) << repaired;
  EXPECT_THAT(repaired, Not(HasSubstr("train_")));
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
