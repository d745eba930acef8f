#include "calibration/fidelity/fidelity_study.h"

#include <filesystem>
#include <string>

#include "absl/strings/str_replace.h"
#include "calibration/fidelity/fidelity_output.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

FidelityOptions Quick() {
  FidelityOptions options;
  options.demonstration_layout = 40;
  options.first_layout = 41;
  options.layouts = 1;
  options.replays = 2;
  options.noise_draws = 1;
  options.replicates = 100;
  return options;
}

// One run for all that follows: it simulates some eighty replays.
const FidelityResult& QuickResult() {
  static const FidelityResult& result = *new FidelityResult(RunFidelity(Quick()).value());
  return result;
}

TEST(RunFidelity, FitsThePayloadOfTheDemonstration) {
  const FidelityResult& result = QuickResult();
  EXPECT_GT(Rise(result.measured_mean), 2e-3);
  EXPECT_GT(result.fit.gravity, 1);
  EXPECT_LT(result.fit.rms, 0.5 * result.fit.rms_nominal);
  EXPECT_LT(result.measured_vertical, 0);
  EXPECT_LT(result.model_vertical, 0);
  ASSERT_EQ(result.contenders.size(), 3u);
  EXPECT_GT(result.contenders[0].rise.value, 0);
}

TEST(RunFidelity, PayloadFreeReplaysOfTheModelDeviateOnlyAfterTheGrasp) {
  const FidelityResult& result = QuickResult();
  for (int i = 0; i < kPhasesBefore - 5; ++i)
    EXPECT_LT(result.contenders[0].mean[i], 1e-6) << PhaseAt(i);
}

TEST(WriteFidelity, LeavesFilesThatAgree) {
  const std::string dir = ::testing::TempDir() + "/fidelity_out";
  ASSERT_TRUE(WriteFidelity(dir, Quick(), QuickResult()).ok());
  const auto json = nlohmann::json::parse(ReadFile(dir + "/fidelity.json").value());
  EXPECT_DOUBLE_EQ(json["fit"]["w_g"].get<double>(), QuickResult().fit.gravity);
  EXPECT_EQ(json["contenders"].size(), 3u);
  const std::string csv = ReadFile(dir + "/profiles.csv").value();
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + kPhases);
  const std::string html = ReadFile(dir + "/fidelity.html").value();
  for (const char* text : {"Heavy Payload, fitted", "Gaussian noise, 0.03", "grasp", "true mass"})
    EXPECT_THAT(html, HasSubstr(text));
  EXPECT_THAT(html, Not(HasSubstr("nan")));
  // What the simulated arm did is in the form that a lab's own recordings have.
  const auto read = ReadMeasuredReplays(dir + "/measured");
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_NEAR(Rise(Mean(MeasureProfiles(*read)->loaded)), Rise(QuickResult().measured_mean), 1e-6);
}

TEST(RunFidelity, RefusesLayoutsThatDoNotExistOrWereFitted) {
  FidelityOptions options = Quick();
  options.layouts = 50;
  EXPECT_THAT(std::string(RunFidelity(options).status().message()), HasSubstr("has 0 to 49"));
  options = Quick();
  options.demonstration_layout = 41;
  EXPECT_THAT(std::string(RunFidelity(options).status().message()), HasSubstr("layout 41"));
  options = Quick();
  options.measured_dir = "nowhere";
  EXPECT_THAT(std::string(RunFidelity(options).status().message()), HasSubstr("nowhere"));
}

}  // namespace
}  // namespace robostress::calibration
