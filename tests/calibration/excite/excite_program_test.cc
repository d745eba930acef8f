// robostress excite as a user runs it: motions, films, what a verdict left open, and refusals.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"
#include "tests/calibration/generator/generated_rig.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
using Json = nlohmann::json;

class ExciteProgram : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = absl::StrCat(::testing::TempDir(), "robostress_excite_",
                           ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    generator::RigOptions options;
    options.effects = {"payload"};
    options.seed = 3;
    options.family = generator::Family::kServo;
    options.richness = generator::Richness::kBrief;
    const auto rig = generator::GenerateRig(options);
    ASSERT_TRUE(rig.ok()) << rig.status();
    ASSERT_TRUE(generator::WriteGeneratedRig(*rig, options, folder_).ok());
  }
  std::pair<std::string, int> Excite(const std::string& arguments) const {
    return RunProgram(EXCITE,
                      absl::StrCat("--rig '", folder_, "/rig.yaml' --out '", folder_,
                                   "/motion.csv' --seconds 5 --without-shapes ", arguments));
  }
  // With a verdict on the joint.
  std::string After(const std::string& verdict, const Json& effects,
                    const std::string& joint = "hinge") const {
    const Json report = {
        {"joints", {{{"joint", joint}, {"verdict", verdict}, {"effects_added", effects}}}}};
    EXPECT_TRUE(WriteFileAtomically(folder_ + "/report.json", report.dump()).ok());
    return absl::StrCat("--after '", folder_, "'");
  }
  std::string folder_;
};

TEST_F(ExciteProgram, WritesMotionReportAndFilmOfARigWithoutLogs) {
  std::string rig = *ReadFile(folder_ + "/rig.yaml");
  const size_t logs = rig.find("logs:"), metric = rig.find("metric:");
  rig.erase(logs, metric - logs);
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/rig.yaml", rig).ok());
  const auto [output, code] = Excite(
      absl::StrCat("--report '", folder_, "/motion.json' --film '", folder_, "/motion.webp'"));
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("hardest: "));
  const std::vector<std::string> rows = absl::StrSplit(*ReadFile(folder_ + "/motion.csv"), '\n');
  EXPECT_EQ(rows[0], "t,q_cmd_hinge");
  EXPECT_NEAR(static_cast<double>(rows.size()), 1002, 2);  // 5 s of 200 rows
  const Json report = Json::parse(*ReadFile(folder_ + "/motion.json"));
  EXPECT_NEAR(report["seconds"].get<double>(), 5, 0.01);
  EXPECT_EQ(report["joints"][0]["pieces"].size(), 3u);
  EXPECT_GT(report["joints"][0]["effects"].size(), 20u);
  EXPECT_THAT(*ReadFile(folder_ + "/motion.webp"), StartsWith("RIFF"));
}

TEST_F(ExciteProgram, AsksForWhatAVerdictLeftOpen) {
  const Json effects = {
      {{"type", "payload"}, {"parameters", {{"mass", 0.05}}}, {"ambiguous_with", {"motor_gain"}}}};
  const auto [output, code] =
      Excite(absl::StrCat(After("ambiguous", effects), " --report '", folder_, "/motion.json'"));
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("--add-log RECORDED.csv"));
  const Json report = Json::parse(*ReadFile(folder_ + "/motion.json"));
  EXPECT_EQ(report["joints"][0]["effects"].size(), 2u);
  // What was asked to differ is what calibrate is told.
  for (const auto& [key, value] : report["overrides"].items())
    EXPECT_THAT(output, HasSubstr(absl::StrCat(",", key, "=")));
  const auto [none, done] = Excite(After("attributed", effects));
  EXPECT_EQ(done, 1);
  EXPECT_THAT(none, HasSubstr("nothing is left to ask"));
  const auto [unknown, refused] = Excite(After("unattributed", Json::array(), "elbow"));
  EXPECT_EQ(refused, 2);
  EXPECT_THAT(unknown, HasSubstr("joint 'elbow' is none of"));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/report.json", R"({"joints": [{}]})").ok());
  EXPECT_EQ(Excite(absl::StrCat("--after '", folder_, "'")).second, 2);
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/report.json", "{").ok());
  EXPECT_THAT(Excite(absl::StrCat("--after '", folder_, "'")).first, HasSubstr("is no report"));
}

TEST_F(ExciteProgram, RefusesWrongLimits) {
  for (const auto& [flags, remedy] : std::vector<std::pair<std::string, std::string>>{
           {"--velocity fast", "--velocity fast: must be a number above 0, or JOINT=NUMBER"},
           {"--velocity hinge=0", "must be a number above 0"},
           {"--acceleration nan", "must be a number above 0"},
           {"--centre 0.3", "JOINT=NUMBER"},
           {"--swing elbow=1", "has no joint 'elbow'"},
           {"--effects banana", "banana"},
           {"--box 0 0 0 1 1 0", "no range"},
           {"--fastest 30", "at 200 rows per second at most 20 Hz"}}) {
    const auto [output, code] = Excite(flags);
    EXPECT_EQ(code, 2) << flags << output;
    EXPECT_THAT(output, HasSubstr(remedy)) << flags;
  }
}

TEST_F(ExciteProgram, CalibrateSaysWhatItDidNotSearch) {
  const auto calibrate = [&](const std::string& more) {
    const auto [output, code] =
        RunProgram(CALIBRATE, absl::StrCat("--rig '", folder_, "/rig.yaml' --quiet --out '",
                                           folder_, "/out' --surrogates 99 ", more));
    EXPECT_EQ(code, 0) << output;
    EXPECT_THAT(output, Not(HasSubstr("nothing came near")));
    EXPECT_THAT(output, Not(HasSubstr("surrogates")));
    return output;
  };
  EXPECT_THAT(calibrate("--max-effects 0"),
              HasSubstr("next: run without --max-effects 0: nothing was searched"));
  std::string rig = *ReadFile(folder_ + "/rig.yaml");
  const size_t window = rig.find("window_s: ");
  rig.replace(window, rig.find(',', window) - window, "window_s: 500");
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/rig.yaml", rig).ok());
  const std::string output = calibrate("--max-effects 0");
  EXPECT_THAT(output, HasSubstr("not_testable"));
  EXPECT_THAT(output, HasSubstr("next: set metric.window_s to at most "));
}

TEST_F(ExciteProgram, CalibrateRefusesALogThatIsNone) {
  for (const auto& [log, remedy] : std::vector<std::pair<std::string, std::string>>{
           {"log_0.csv", "lists this file already"},
           {"new.csv,elbow.known_mass=1", "with a joint of"},
           {"new.csv,hinge.known_mass=-1", "hinge.known_mass: is -1, must be at least 0"},
           {"new.csv,hinge.known_mass", "JOINT.PARAMETER=NUMBER"},
           {"new.csv", "cannot open"}}) {
    const auto [output, code] =
        RunProgram(CALIBRATE, absl::StrCat("--rig '", folder_, "/rig.yaml' --quiet --out '",
                                           folder_, "/out' --add-log '", folder_, "/", log, "'"));
    EXPECT_NE(code, 0) << log;
    EXPECT_THAT(output, HasSubstr(remedy)) << log;
  }
}

}  // namespace
}  // namespace robostress
