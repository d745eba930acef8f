#include "tests/calibration/study/threshold_rates.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress::generator {
namespace {

using Json = nlohmann::json;
using testing::HasSubstr;

Json Joint(double bulk, double all, double left, double explained, bool added) {
  Json joint = {{"times_noise", {{"worst_log_bulk", bulk}, {"worst_log", all}, {"after", left}}},
                {"excess_explained", explained},
                {"effects_added", Json::array()}};
  if (added) joint["effects_added"].push_back({{"type", "backlash"}});
  return joint;
}

Json Truth(const std::vector<std::string>& types, bool in_library = true) {
  Json truth = {{"effects", Json::array()}};
  for (const std::string& type : types)
    truth["effects"].push_back({{"type", type}, {"in_library", in_library}});
  return truth;
}

TEST(ThresholdRates, ReadsTheJointWhereMostIsLeftAndOnlyWhatWasAdded) {
  const Json added = {{"type", "backlash"}, {"ambiguous_with", {"deadzone"}}};
  const Json report = {
      {"effects_added", Json::array({added})},
      {"joints", Json::array({Joint(20, 30, 1.2, 0.98, true), Joint(1.1, 40, 9, 0.1, false)})}};
  const Traced rig = ReadTraced(report, Truth({"backlash", "payload"}));
  EXPECT_TRUE(rig.hidden && rig.added && rig.right && !rig.outside);
  EXPECT_EQ(rig.bulk, 20);
  EXPECT_EQ(rig.all, 40);
  EXPECT_EQ(rig.left, 1.2);
  EXPECT_EQ(rig.explained, 0.98);
  EXPECT_TRUE(ReadTraced(report, Truth({"deadzone"})).right);
  EXPECT_FALSE(ReadTraced(report, Truth({"payload"})).right);
  EXPECT_FALSE(ReadTraced(report, Truth({})).hidden);
  const Traced outsider = ReadTraced(report, Truth({"dahl"}, false));
  EXPECT_TRUE(outsider.outside && !outsider.hidden && !outsider.right);
}

TEST(ThresholdRates, CountsAlarmsAboveALimitAndMissesBelow) {
  Traced quiet, loud, found, faint, wrong;
  quiet.bulk = quiet.all = 1.2;
  loud.bulk = loud.all = 1.6;
  found.hidden = found.added = found.right = true;
  found.bulk = found.all = 100;
  found.left = 2.5;
  found.explained = 0.98;
  faint.hidden = true;
  faint.bulk = faint.all = 1.4;
  wrong.outside = wrong.added = true;
  wrong.left = 4;
  wrong.explained = 0.95;
  const std::string text = ThresholdRates({quiet, loud, found, faint, wrong});
  EXPECT_THAT(text, HasSubstr("nothing hidden and yet above, of 2 | hidden and not above, of 2"));
  EXPECT_THAT(text, HasSubstr("bulk [noise] | 1.3 | 1 | 0 |"));
  EXPECT_THAT(text, HasSubstr("bulk [noise] | 1.5, as it is | 1 | 1 |"));
  EXPECT_THAT(text, HasSubstr("all right and yet above: no name, of 1"));
  EXPECT_THAT(text, HasSubstr("left under a name [noise] | 2 | 1 | 0 |"));
  EXPECT_THAT(text, HasSubstr("left under a name [noise] | 5 | 0 | 1 |"));
  EXPECT_THAT(text, HasSubstr("excess not explained [%] | 3, as it is | 0 | 0 |"));
  EXPECT_THAT(text, HasSubstr("excess not explained [%] | 1 | 1 | 0 |"));
  EXPECT_THAT(text, HasSubstr("excess not explained [%] | 10 | 0 | 1 |"));
}

}  // namespace
}  // namespace robostress::generator
