#include "eval/report/training_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

// A folder as `robostress train` leaves it, with this log.
std::string WriteRun(const std::string& name, const std::string& log) {
  const std::string dir = ::testing::TempDir() + "/training_report/" + name;
  EXPECT_TRUE(MakeDirectories(dir).ok());
  EXPECT_TRUE(WriteFileAtomically(dir + "/train.jsonl", log).ok());
  EXPECT_TRUE(WriteFileAtomically(dir + "/config.yaml", "objective: bc\nbatch: 64\n").ok());
  return dir;
}

constexpr char kLog[] =
    R"({"step":0,"validation_flow":0.40,"action_error":0.06,"target_error_mm":14.0}
{"step":0,"successes":3,"episodes":10}
{"step":50,"flow":0.5,"aux":0.1,"samples_per_s":100,"cpu_ms_per_sample":5,"data_share":0.02,"elapsed_s":32}
{"step":100,"flow":0.3,"aux":0.1,"samples_per_s":100,"cpu_ms_per_sample":7,"data_share":0.04,"elapsed_s":64}
{"step":100,"successes":9,"episodes":10}
)";

TEST(TrainingReport, ReadsTheColumnsOfALog) {
  const auto run = LoadTrainingRun(WriteRun("base", kLog));
  ASSERT_TRUE(run.ok()) << run.status();
  EXPECT_EQ(run->name, "base");
  ASSERT_NE(run->Find("flow"), nullptr);
  EXPECT_THAT(run->Find("flow")->step, ElementsAre(50, 100));
  EXPECT_THAT(run->Find("flow")->value, ElementsAre(0.5, 0.3));
  EXPECT_THAT(run->Find("successes")->value, ElementsAre(3, 9));
  EXPECT_EQ(run->Find("clean_flow"), nullptr);
  EXPECT_TRUE(std::isnan(run->Last("clean_flow")));
}

TEST(TrainingReport, StepsThatARunDidTwiceCountOnceAsDoneLast) {
  const auto run =
      LoadTrainingRun(WriteRun("resumed",
                               "{\"step\":50,\"flow\":1}\n{\"step\":100,\"flow\":2}\n"
                               "{\"step\":50,\"flow\":3}\n{\"step\":75,\"flow\":4}\n"));
  ASSERT_TRUE(run.ok()) << run.status();
  EXPECT_THAT(run->Find("flow")->step, ElementsAre(50, 75, 100));
  EXPECT_THAT(run->Find("flow")->value, ElementsAre(3, 4, 2));
}

TEST(TrainingReport, ShowsCurvesCostAndSuccessOnAPageThatNeedsNothingElse) {
  const auto run = LoadTrainingRun(WriteRun("base", kLog));
  ASSERT_TRUE(run.ok()) << run.status();
  const std::string page = TrainingPage({*run});
  EXPECT_THAT(page, AllOf(HasSubstr("<svg"), HasSubstr("Training loss (flow matching)"),
                          HasSubstr("Held-out flow loss"), HasSubstr("Success during training"),
                          Not(HasSubstr("before PGD")), Not(HasSubstr("<script"))));
  // 6400 frames at 5 and 7 ms: 0.64 minutes of CPU, 6 ms a frame; data share of the two windows.
  EXPECT_THAT(page, AllOf(HasSubstr("<td>6.00</td>"), HasSubstr("<td>0.6</td>"),
                          HasSubstr("<td>3.0</td>")));
  // Wilson's interval of 9 of 10.
  EXPECT_THAT(page, AllOf(HasSubstr("9/10"), HasSubstr("[60, 98] %")));
  EXPECT_THAT(page, HasSubstr("objective: bc"));
}

TEST(TrainingReport, NamesFileAndLineOfWhatIsNoLog) {
  EXPECT_THAT(
      std::string(
          LoadTrainingRun(WriteRun("bad", "{\"step\":1,\"flow\":1}\nhello\n")).status().message()),
      AllOf(HasSubstr("train.jsonl:2"), HasSubstr("hello")));
  EXPECT_THAT(std::string(LoadTrainingRun(WriteRun("empty", "")).status().message()),
              HasSubstr("no step is logged yet"));
  EXPECT_FALSE(LoadTrainingRun("/nowhere").ok());
  const std::string dir = WriteRun("unbatched", kLog);
  ASSERT_TRUE(WriteFileAtomically(dir + "/config.yaml", "objective: bc\n").ok());
  EXPECT_THAT(std::string(LoadTrainingRun(dir).status().message()),
              HasSubstr("config.yaml: batch is missing"));
}

}  // namespace
}  // namespace robostress
