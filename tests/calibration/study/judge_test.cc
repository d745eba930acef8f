#include "tests/calibration/study/judge.h"

#include <gtest/gtest.h>

#include <cmath>

namespace robostress::generator {
namespace {

using Json = nlohmann::json;

Json Truth(const std::vector<std::string>& types, bool in_library = true,
           const std::vector<std::string>& near = {}) {
  Json truth = {{"effects", Json::array()}};
  for (const std::string& type : types)
    truth["effects"].push_back(
        {{"type", type}, {"joint", "hinge"}, {"in_library", in_library}, {"near", near}});
  return truth;
}

Json Report(const std::string& verdict, const std::vector<std::string>& added = {},
            const std::vector<std::string>& rivals = {}) {
  Json report = {{"verdict", verdict},
                 {"effects_added", Json::array()},
                 {"groups", Json::array()},
                 {"joints", Json::array({{{"times_noise", {{"after", 1.3}}}}})}};
  for (const std::string& type : added)
    report["effects_added"].push_back(
        {{"type", type}, {"joint", "hinge"}, {"ambiguous_with", rivals}});
  return report;
}

Outcome OutcomeOf(const Json& report, const Json& truth) { return Judge(report, truth).outcome; }

TEST(Judge, OnlyExactlyWhatIsThereIsNamed) {
  const Json truth = Truth({"backlash"});
  EXPECT_EQ(OutcomeOf(Report("attributed", {"backlash"}), truth), Outcome::kNamed);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"backlash", "payload"}), truth), Outcome::kWrong);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"compliance"}), truth), Outcome::kWrong);
  const Json two = Truth({"backlash", "payload"});
  EXPECT_EQ(OutcomeOf(Report("attributed", {"payload", "backlash"}), two), Outcome::kNamed);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"payload"}), two), Outcome::kWrong);
}

TEST(Judge, OneOfTwoIsNoMistakeWhereTheDataHoldNoMore) {
  const Json two = Truth({"backlash", "payload"});
  Json one = Report("attributed", {"payload"}),
       group = Report("ambiguous", {"payload"}, {"deadzone"}),
       other = Report("attributed", {"deadzone"}),
       more = Report("attributed", {"payload", "deadzone"});
  EXPECT_EQ(OutcomeOf(group, two), Outcome::kWrongGroup);
  for (Json* report : {&one, &group, &other, &more})
    (*report)["joints"][0]["times_noise"]["after"] = 1.1;
  EXPECT_EQ(OutcomeOf(one, two), Outcome::kOneOfTwo);
  EXPECT_EQ(OutcomeOf(group, two), Outcome::kOneOfTwo);
  EXPECT_EQ(OutcomeOf(other, two), Outcome::kWrong);
  EXPECT_EQ(OutcomeOf(more, two), Outcome::kWrong);
  EXPECT_EQ(OutcomeOf(one, Truth({"backlash"})), Outcome::kWrong);
}

TEST(Judge, TheJointCountsButForWhatTheWholeArmFeels) {
  Json friction = Truth({"backlash"}), load = Truth({"payload"});
  friction["effects"][0]["joint"] = load["effects"][0]["joint"] = "elbow";
  EXPECT_EQ(OutcomeOf(Report("attributed", {"backlash"}), friction), Outcome::kWrong);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"payload"}), load), Outcome::kNamed);
}

TEST(Judge, AGroupCountsWhereItHoldsWhatIsThere) {
  const Json truth = Truth({"servo_lag"});
  EXPECT_EQ(OutcomeOf(Report("ambiguous", {"transport_delay"}, {"servo_lag"}), truth),
            Outcome::kGrouped);
  EXPECT_EQ(OutcomeOf(Report("ambiguous", {"transport_delay"}, {"compliance"}), truth),
            Outcome::kWrongGroup);
  Json listed = Report("ambiguous", {"transport_delay"});
  listed["groups"] = Json::array({Json::array({"transport_delay", "servo_lag"})});
  EXPECT_EQ(OutcomeOf(listed, truth), Outcome::kGrouped);
}

TEST(Judge, HedgesAreNeitherRightNorWrong) {
  const Json truth = Truth({"backlash"});
  EXPECT_EQ(OutcomeOf(Report("reduced_not_attributed", {"backlash"}), truth), Outcome::kListed);
  EXPECT_EQ(OutcomeOf(Report("reduced_not_attributed", {"compliance"}), truth), Outcome::kHedged);
  EXPECT_EQ(OutcomeOf(Report("unattributed"), truth), Outcome::kHedged);
  EXPECT_EQ(OutcomeOf(Report("declared_sufficient"), truth), Outcome::kMissed);
  EXPECT_EQ(OutcomeOf(Report("not_testable"), truth), Outcome::kMissed);
}

TEST(Judge, AnythingThatIsClaimedOfAWholeRigIsAFalseAlarm) {
  const Json none = Truth({});
  EXPECT_EQ(OutcomeOf(Report("declared_sufficient"), none), Outcome::kNothing);
  EXPECT_EQ(OutcomeOf(Report("not_testable"), none), Outcome::kNothing);
  for (const char* verdict : {"attributed", "ambiguous", "reduced_not_attributed", "unattributed"})
    EXPECT_EQ(OutcomeOf(Report(verdict), none), Outcome::kFalseAlarm) << verdict;
}

TEST(Judge, NoNameIsRightForWhatTheLibraryDoesNotHave) {
  const Json outside = Truth({"dwell_hot_spot"}, false);
  EXPECT_EQ(OutcomeOf(Report("unattributed"), outside), Outcome::kHedged);
  EXPECT_EQ(OutcomeOf(Report("reduced_not_attributed", {"backlash"}), outside), Outcome::kHedged);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"backlash"}), outside), Outcome::kWrong);
  EXPECT_EQ(OutcomeOf(Report("ambiguous", {"backlash"}), outside), Outcome::kWrongGroup);
  const Json near = Truth({"second_mass"}, false, {"compliance"});
  EXPECT_EQ(OutcomeOf(Report("attributed", {"compliance"}), near), Outcome::kListed);
  EXPECT_EQ(OutcomeOf(Report("attributed", {"backlash"}), near), Outcome::kWrong);
}

TEST(Judge, ClopperPearsonFollowsItsClosedFormsAtTheEnds) {
  const auto [low, high] = ClopperPearson(0, 300);
  EXPECT_EQ(low, 0);
  EXPECT_NEAR(high, 1 - std::pow(0.025, 1.0 / 300), 1e-9);
  EXPECT_NEAR(ClopperPearson(300, 300).first, std::pow(0.025, 1.0 / 300), 1e-9);
  // Table of Clopper and Pearson: 3 of 10.
  EXPECT_NEAR(ClopperPearson(3, 10).first, 0.0667, 1e-4);
  EXPECT_NEAR(ClopperPearson(3, 10).second, 0.6525, 1e-4);
}

}  // namespace
}  // namespace robostress::generator
