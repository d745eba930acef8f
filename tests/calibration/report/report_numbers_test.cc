#include "calibration/report/report_numbers.h"

#include <limits>

#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

TEST(NumberText, HasThreeSignificantDigitsAndATrueMinus) {
  EXPECT_EQ(NumberText(0), "0");
  EXPECT_EQ(NumberText(0.49312), "0.493");
  EXPECT_EQ(NumberText(-3.1699), "\u22123.17");
  EXPECT_EQ(NumberText(203.97), "204");
  EXPECT_EQ(NumberText(24841), "24841");
  EXPECT_EQ(NumberText(0.000123456), "0.000123");
  EXPECT_EQ(NumberText(5.4e6), "5.40\u00b710\u2076");
  EXPECT_EQ(NumberText(-3.21e-7), "\u22123.21\u00b710\u207b\u2077");
}

TEST(NumberText, IsADashWhereThereIsNoNumber) {
  EXPECT_EQ(NumberText(std::numeric_limits<double>::quiet_NaN()), "\u2013");
  EXPECT_EQ(NumberText(std::numeric_limits<double>::infinity()), "\u2013");
}

TEST(ValueText, GoesToTheSecondDigitOfItsDeviation) {
  EXPECT_EQ(ValueText(-37.0213, 0.8391), "\u221237.02 \u00b1 0.84");
  EXPECT_EQ(ValueText(0.0200041, 0.000312), "0.02000 \u00b1 0.00031");
  EXPECT_EQ(ValueText(1234.5, 67.8), "1234 \u00b1 68");  // rounds half to even, as printf does
  EXPECT_EQ(ValueText(4.6e6, 2.1e4), "(4.600 \u00b1 0.021)\u00b710\u2076");
  EXPECT_EQ(ValueText(0, 0.012), "0.000 \u00b1 0.012");
  EXPECT_EQ(ValueText(160.18, 0), "160");
}

TEST(PercentText, HasADecimalOnlyWhereItIsSmall) {
  EXPECT_EQ(PercentText(0.276), "28 %");
  EXPECT_EQ(PercentText(-0.319), "\u221232 %");
  EXPECT_EQ(PercentText(0.0312), "3.1 %");
}

TEST(PValueText, NeverSaysLessThanTheSurrogatesCanTell) {
  EXPECT_EQ(PValueText(0.001, 999), "p \u2264 0.001");
  EXPECT_EQ(PValueText(0.004, 999), "p = 0.004");
  EXPECT_EQ(PValueText(0.42, 999), "p = 0.42");
}

TEST(DisplayUnitFor, MakesSmallAnglesAndLengthsHandy) {
  EXPECT_EQ(DisplayUnitFor("m", 0.724e-3).name, "mm");
  EXPECT_EQ(DisplayUnitFor("rad", 0.068).factor, 1e3);
  EXPECT_EQ(DisplayUnitFor("rad", 2e-5).name, "\u00b5rad");
  EXPECT_EQ(DisplayUnitFor("mdeg", 0.003).name, "mdeg");
  EXPECT_EQ(DisplayUnitFor("rad", 0.3).name, "rad");
}

}  // namespace
}  // namespace robostress::calibration
