#include "calibration/search/verdict.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace robostress::calibration {
namespace {

using testing::HasSubstr;

// One added effect that explains all but the noise.
Evidence Explained() {
  Evidence e;
  e.declared = e.declared_bulk = 0.1;
  e.after = 0.01;
  e.after_bulk = 0.0151;
  e.floor = 0.01;
  e.effects = 1;
  e.windows = 20;
  return e;
}

Verdict VerdictOf(const Evidence& e) { return Judge(e).verdict; }

TEST(Verdict, NamesWhatExplainsAllButTheNoise) {
  const Judgement judgement = Judge(Explained());
  EXPECT_EQ(judgement.verdict, Verdict::kAttributed);
  EXPECT_NEAR(judgement.excess_explained, 1, 1e-12);
  Evidence rivals = Explained();
  rivals.ambiguous = true;
  EXPECT_EQ(VerdictOf(rivals), Verdict::kAmbiguous);
}

TEST(Verdict, NamesNoMechanismThatMakesTheTransferLogsMoreThanATwentiethWorse) {
  Evidence e = Explained();
  e.transfer_declared = 0.1;
  e.transfer_after = 0.1049;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.transfer_after = 0.1051;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("makes the transfer logs worse"));
  e.transfer_declared = 0;  // there is no such log
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
}

TEST(Verdict, NamesNoMechanismThatLeavesAThirtiethOfTheExcess) {
  // Excess before: 0.1^2 - 0.01^2; `share` of it remains. 1.15 times the floor is noise.
  const auto with = [](double share) {
    Evidence e = Explained();
    e.after = std::sqrt(1e-4 + share * (1e-2 - 1e-4));
    return e;
  };
  EXPECT_EQ(VerdictOf(with(0.029)), Verdict::kAttributed);
  EXPECT_EQ(VerdictOf(with(0.031)), Verdict::kReducedNotAttributed);
  EXPECT_NEAR(Judge(with(0.031)).excess_explained, 0.969, 1e-9);
  // Where the declared model is near the noise already, what is left is measured against the noise.
  Evidence small = Explained();
  small.declared = 0.013;
  small.after = 0.0114;
  EXPECT_EQ(VerdictOf(small), Verdict::kAttributed);
  small.after = 0.0116;
  EXPECT_EQ(VerdictOf(small), Verdict::kReducedNotAttributed);
  small.after_is_white = true;
  small.after = 0.0149;
  EXPECT_EQ(VerdictOf(small), Verdict::kAttributed);
  small.after = 0.0151;
  EXPECT_EQ(VerdictOf(small), Verdict::kReducedNotAttributed);
  small.after = 0.0114;
  small.inverse = true;  // whose floor says too little
  EXPECT_EQ(VerdictOf(small), Verdict::kReducedNotAttributed);
}

TEST(Verdict, SaysThatNothingWasSearched) {
  Evidence e = Explained();
  e.effects = 0;
  e.searched = false;
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("nothing was searched"));
}

TEST(Verdict, ClaimsNothingOfLessThanHalfAsMuchAgainAsTheNoise) {
  Evidence e = Explained();
  e.effects = 0;
  e.declared = 0.039;
  e.declared_bulk = 0.0149;
  EXPECT_EQ(VerdictOf(e), Verdict::kDeclaredSufficient);
  e.declared_bulk = 0.0151;
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  e.declared_bulk = 0.0149;
  e.declared = 0.041;  // a few runs are far off
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
}

TEST(Verdict, IsSufficientOnlyWhereEveryLogIs) {
  Evidence e = Explained();
  e.effects = 0;
  e.declared = e.declared_bulk = 0.01;
  e.regimes = {{"slow.csv", 0.01, 0.01, 0.01}, {"fast.csv", 0.014, 0.014, 0.01}};
  EXPECT_EQ(VerdictOf(e), Verdict::kDeclaredSufficient);
  e.regimes[1] = {"fast.csv", 0.07, 0.07, 0.01};
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("most in fast.csv, 7.00 times (7.00)"));
}

TEST(Verdict, NamesNoMechanismThatCanNotBeTheMachine) {
  Evidence e = Explained();
  e.doubts = {"vs is on a bound", "friction would be -1 Nm"};
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("vs is on a bound; friction would be -1 Nm"));
  EXPECT_NEAR(Judge(e).excess_explained, 1, 1e-12);
}

TEST(Verdict, NamesNoMechanismThatLeavesThreeTimesTheNoise) {
  Evidence e = Explained();
  e.declared = e.declared_bulk = 1;
  e.after = 0.0299;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.after = 0.0301;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("3.0 times the noise"));
  e.declared = 5;  // a hundredth of which may be left, up to five times the noise
  e.after = 0.0499;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.after = 0.0501;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  e.declared = 4.9;
  e.after = 0.0499;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  e.declared = 1;
  e.after = 0.0301;
  e.after_bulk = 0.0149;  // a few runs stick where the machine slipped
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.after_bulk = 0.0151;
  e.inverse = true;  // whose floor says too little
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
}

TEST(Verdict, AsksLessWhereADeclaredModelWouldBeSufficient) {
  Evidence e = Explained();
  e.declared = 0.05;  // seven tenths of its excess go
  e.after = 0.0286, e.after_bulk = 0.0149;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.after_bulk = 0.0151;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  e.after_bulk = 0.0149;
  e.after = 0.0288;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
  e.after = 0.0286;
  e.inverse = true;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
}

TEST(Verdict, MoreRunsOfAJointThatOthersPushMayBeFarOff) {
  Evidence e = Explained();
  e.effects = 0;
  e.declared = 0.119, e.declared_bulk = 0.0149;
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  e.pushed = true;
  EXPECT_EQ(VerdictOf(e), Verdict::kDeclaredSufficient);
  e.declared = 0.121;
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  e.declared = 0.119, e.declared_bulk = 0.0151;
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
}

TEST(Verdict, NamesWhatLeavesNoMoreThanTheSimulationsOwnError) {
  Evidence e = Explained();
  e.declared = e.declared_bulk = 30;
  e.after = e.after_bulk = 0.059;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.after = e.after_bulk = 0.061;
  EXPECT_EQ(VerdictOf(e), Verdict::kReducedNotAttributed);
}

TEST(Verdict, NamesTheLogThatIsFartherOffThanNoise) {
  Evidence e = Explained();
  e.effects = 0;
  e.declared = e.declared_bulk = 0.01;
  e.regimes = {{"few.csv", 0.05, 0.01, 0.01}, {"all.csv", 0.014, 0.014, 0.01}};
  EXPECT_EQ(VerdictOf(e), Verdict::kUnattributed);
  EXPECT_THAT(Judge(e).because, HasSubstr("most in few.csv, 5.00 times (1.00)"));
}

TEST(Verdict, SaysNothingOfFewerThanEightRuns) {
  Evidence e = Explained();
  e.windows = 8;
  EXPECT_EQ(VerdictOf(e), Verdict::kAttributed);
  e.windows = 7;
  EXPECT_EQ(VerdictOf(e), Verdict::kNotTestable);
}

TEST(Verdict, OfARigIsThatOfItsLeastExplainedJoint) {
  const auto combine = [](std::vector<Verdict> verdicts) {
    std::vector<JointReport> joints(verdicts.size());
    for (size_t i = 0; i < joints.size(); ++i) joints[i].verdict = verdicts[i];
    return Combine(joints);
  };
  using enum Verdict;
  EXPECT_EQ(combine({kAttributed, kDeclaredSufficient}), kAttributed);
  EXPECT_EQ(combine({kAttributed, kAmbiguous}), kAmbiguous);
  EXPECT_EQ(combine({kAttributed, kUnattributed}), kReducedNotAttributed);
  EXPECT_EQ(combine({kDeclaredSufficient, kUnattributed}), kUnattributed);
  EXPECT_EQ(combine({kDeclaredSufficient, kNotTestable}), kDeclaredSufficient);
  EXPECT_EQ(combine({kNotTestable, kNotTestable}), kNotTestable);
}

}  // namespace
}  // namespace robostress::calibration
