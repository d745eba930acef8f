#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"
#include "tests/run_program.h"

// Public recordings (the rigs' headers say whose), end to end through the program. Development
// figures: the tracer was built with these recordings in sight.
namespace robostress::calibration {
namespace {

using Json = nlohmann::json;

// The folder of the recordings, or empty.
std::string Recordings() {
  const char* given = std::getenv("ROBOSTRESS_MEASURED_DATA");
  const std::filesystem::path folder = given != nullptr ? given : "../shared/data/measured";
  return std::filesystem::exists(folder / "emps") ? std::filesystem::absolute(folder).string() : "";
}

class RealRig : public testing::Test {
 protected:
  void SetUp() override {
    if (Recordings().empty())
      GTEST_SKIP() << "no recordings: set ROBOSTRESS_MEASURED_DATA to a folder with emps, kr300 "
                      "and bam_xl330";
    setenv("ROBOSTRESS_MEASURED_DATA", Recordings().c_str(), 1);
  }
  // The report of `calibrate` on calibration/rigs/<name>.
  Json Calibrate(const std::string& name, const std::string& options = "") {
    const std::string out = absl::StrCat(testing::TempDir(), "/real_", name);
    const auto [output, code] =
        RunProgram(ROBOSTRESS_CALIBRATE,
                   absl::StrCat("--rig ", ROBOSTRESS_SOURCE_DIR, "/calibration/rigs/", name,
                                "/rig.yaml --quiet --surrogates 199 --out ", out, " ", options));
    EXPECT_EQ(code, 0) << output;
    std::printf("%s", output.c_str());
    const auto text = ReadFile(out + "/report.json");
    EXPECT_TRUE(text.ok()) << text.status();
    std::filesystem::remove_all(out);
    return Json::parse(text.value_or("{}"), nullptr, false);
  }
};

std::vector<std::string> TypesOf(const Json& effects) {
  std::vector<std::string> types;
  for (const Json& effect : effects) types.push_back(effect["type"]);
  return types;
}

TEST_F(RealRig, Kr300HasADelayBetweenItsChannelsAndNoBacklash) {
  const Json report = Calibrate("kr300");
  const double limit[] = {3.3, 5.5, 6.5};  // [mdeg]
  ASSERT_EQ(report["joints"].size(), 3u);
  for (int axis = 0; axis < 3; ++axis) {
    const Json& joint = report["joints"][axis];
    SCOPED_TRACE(joint["joint"].get<std::string>());
    const Json& error = joint["errors"]["cross_validated"];
    EXPECT_NEAR(error["declared"].get<double>(), 35, 1.5);
    EXPECT_LE(error["after"].get<double>(), limit[axis]);
    const std::vector<std::string> types = TypesOf(joint["effects_added"]);
    ASSERT_FALSE(types.empty());
    EXPECT_EQ(std::count(types.begin(), types.end(), "backlash"), 0);
    EXPECT_EQ(types.front(), "transport_delay");
    const Json& parameters = joint["effects_added"][0]["parameters"];
    EXPECT_GE(parameters.value("delay_s", 0.0), 2.5e-3);
    EXPECT_LE(parameters.value("delay_s", 0.0), 3.2e-3);
  }
}

TEST_F(RealRig, EmpsLacksViscousFrictionThatDependsOnDirection) {
  const Json report = Calibrate("emps");
  const Json& joint = report["joints"][0];
  const Json& error = joint["errors"]["held_out"];
  const std::vector<std::string> types = TypesOf(joint["effects_added"]);
  ASSERT_FALSE(types.empty());
  EXPECT_EQ(types.front(), "asymmetric_viscous");
  EXPECT_LE(error["after"].get<double>(), 0.50);  // [mm]
  ASSERT_FALSE(joint["mimics_exposed"].empty()) << "the constant offset stood in for it";
  EXPECT_NE(joint["mimics_exposed"][0].get<std::string>().find("torque_offset"), std::string::npos);
}

// The mechanism does not carry over to torque-off falls, so that no name may be claimed.
TEST_F(RealRig, BamIsReducedButNotAttributed) {
  const Json report = Calibrate("bam");
  const Json& error = report["joints"][0]["errors"]["left_out"];  // mean absolute, a gain at a time
  EXPECT_NEAR(error["declared"].get<double>(), 0.079, 0.003);
  EXPECT_LE(error["after"].get<double>(), 0.040);
  EXPECT_EQ(report["verdict"], "reduced_not_attributed");
}

}  // namespace
}  // namespace robostress::calibration
