#include "calibration/data/log_faults.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calibration/data/measured_log.h"
#include "calibration/data/row_clock.h"
#include "common/random.h"

namespace robostress::calibration {
namespace {

constexpr double kDt = 0.005;
constexpr int kRows = 4000;

double Motion(double t) { return 0.6 * std::sin(3 * t) + 0.2 * std::sin(7.3 * t); }
double Speed(double t) { return 1.8 * std::cos(3 * t) + 1.46 * std::cos(7.3 * t); }

// Readings of a motion with noise [rad], at moments that are off by `jitter` [s].
std::vector<double> Readings(double noise, double jitter) {
  RandomStream random(StreamKey("readings"));
  std::vector<double> q;
  for (int i = 0; i < kRows; ++i)
    q.push_back(Motion(i * kDt + jitter * random.Normal()) + noise * random.Normal());
  return q;
}

std::vector<double> Speeds() {
  std::vector<double> dq;
  for (int i = 0; i < kRows; ++i) dq.push_back(Speed(i * kDt));
  return dq;
}

TEST(NoiseBySpeed, FindsHowFarReadingsAreOffTheirTimes) {
  const ReadingNoise noise = NoiseBySpeed(Readings(1e-4, 3e-4), Speeds());
  EXPECT_NEAR(noise.timing, 3e-4, 0.15 * 3e-4);
  EXPECT_LT(noise.still, 2.5e-4);
}

TEST(NoiseBySpeed, FindsNothingInNoiseThatIsTheSameAtEverySpeed) {
  EXPECT_EQ(NoiseBySpeed(Readings(1e-4, 0), Speeds()).timing, 0);
}

TEST(NoiseBySpeed, TakesNoMotionThatIsKickedEveryFewRowsForNoise) {
  std::vector<double> q = Readings(1e-7, 0), dq = Speeds();
  double v = 0, moved = 0;
  for (int i = 0; i < kRows; ++i) {  // a velocity that is put right every fourth row
    if (i % 4 == 0) v = 0.02 * Speed(i * kDt) * ((i / 4) % 2 == 0 ? 1 : -1);
    moved += v * kDt;
    q[i] += moved;
  }
  EXPECT_EQ(NoiseBySpeed(q, dq).timing, 0);
}

TEST(BetweenSteps, FollowsASlowReadingThroughTheMiddlesOfItsSteps) {
  std::vector<double> steps, wanted;
  for (int i = 0; i < 1000; ++i) {
    wanted.push_back(20 + 0.004 * i);
    steps.push_back(0.5 * std::round(wanted.back() / 0.5));
  }
  const std::vector<double> lines = BetweenSteps(steps);
  for (int i = 100; i < 900; ++i) EXPECT_NEAR(lines[i], wanted[i], 0.01) << i;
  EXPECT_EQ(lines.front(), steps.front());
  const std::vector<double> constant(100, 3.0), fast = {0, 1, 0, 1, 2, 1, 0, 3, 1, 2, 3, 4};
  EXPECT_EQ(BetweenSteps(constant), constant);
  EXPECT_EQ(BetweenSteps(fast), fast);
  EXPECT_TRUE(BetweenSteps({}).empty());
}

TEST(RowsBetweenBends, AreThoseOfLinesBetweenSteps) {
  std::vector<double> lines, smooth, ramps;
  for (int i = 0; i < 1000; ++i) {
    const int at = (i - 2) / 4 * 4 + 2;
    const double share = (i - at) / 4.0;
    lines.push_back((1 - share) * Motion(at * kDt) + share * Motion((at + 4) * kDt));
    smooth.push_back(Motion(i * kDt));
    ramps.push_back(std::abs(i % 200 - 100) * 0.01);  // slow ramps bend too, but rarely
  }
  EXPECT_EQ(RowsBetweenBends(lines), 4);
  EXPECT_EQ(RowsBetweenBends(smooth), 0);
  EXPECT_EQ(RowsBetweenBends(ramps), 0);
  EXPECT_TRUE(BendsEvery(lines, 4));
  EXPECT_TRUE(BendsEvery(ramps, 4));
  EXPECT_FALSE(BendsEvery(ramps, 7));
  EXPECT_FALSE(BendsEvery(smooth, 4));
  EXPECT_FALSE(BendsEvery(std::vector<double>(1000, 0.3), 4));
  const std::vector<double> steps = StepsOfLines(lines, 4);
  for (int i = 2; i < 1000; ++i) {
    const int bend = (i - 2) / 4 * 4 + 2;
    EXPECT_NEAR(steps[i], Motion(bend * kDt), 1e-12) << i;
  }
}

// What holds over four rows, drawn through by lines and read every 1.25 rows.
class DrawnSteps : public testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 1000; ++i) {
      const int sent = i / 4 * 4;
      sharp_.push_back(Motion(sent * kDt));
    }
    for (int k = 0; k < 790; ++k) {
      const double at = PlaceOf(k);
      const int row = static_cast<int>(at);
      drawn_.push_back(sharp_[row] + (at - row) * (sharp_[row + 1] - sharp_[row]));
    }
  }
  static double PlaceOf(int k) { return 0.37 + k * 1.25; }
  // From one reading to the next, of the command that held.
  double MeanFrom(int k) const {
    double sum = 0;
    constexpr int kParts = 1000;
    for (int i = 0; i < kParts; ++i)
      sum += sharp_[static_cast<int>(PlaceOf(k) + (i + 0.5) / kParts * 1.25)] / kParts;
    return sum;
  }
  std::vector<double> sharp_, drawn_;
};

TEST_F(DrawnSteps, PassThroughARowBetweenAsOftenAsRowsWereShorter) {
  std::vector<double> smooth;
  for (int i = 0; i < 1000; ++i) smooth.push_back(Motion(i * kDt));
  EXPECT_NEAR(calibration::DrawnSteps(drawn_), 0.8, 0.03);
  EXPECT_EQ(calibration::DrawnSteps(sharp_), 0);
  EXPECT_EQ(calibration::DrawnSteps(smooth), 0);
}

TEST_F(DrawnSteps, AreReplacedByWhatHeldOnTheMean) {
  const std::vector<double> means = MeansOfDrawnSteps(drawn_, 0.8);
  double left = 0, of_lines = 0, of_sharp = 0;
  for (int k = 4; k + 4 < static_cast<int>(drawn_.size()); ++k) {
    const double off = std::abs(means[k] - MeanFrom(k));
    const bool between = means[k] != drawn_[k] && drawn_[k] != drawn_[k - 1];
    left += off;
    of_lines += std::abs(drawn_[k] - MeanFrom(k));
    if (between) {
      EXPECT_LT(off, 1e-4) << k;
    }
    of_sharp = std::max(of_sharp, off);
  }
  EXPECT_LT(left, 0.25 * of_lines);
  EXPECT_LT(of_sharp, 0.011);  // a tenth of a row at the largest step, where no row lies between
}

TEST(Resampling, FillsLostRowsWithCurvesAndSaysWhich) {
  std::vector<double> t, values;
  for (int i = 0; i < 200; ++i) {
    if (i == 50 || i == 120 || i == 121) continue;
    t.push_back(i * kDt);
    values.push_back(Motion(i * kDt));
  }
  const Resampling resampling(t, {kDt, 0, 3});
  const std::vector<double> filled = resampling.Curves(values), lines = resampling.Lines(values);
  ASSERT_EQ(filled.size(), 200u);
  for (int i = 0; i < 200; ++i) {
    const bool lost = i == 50 || i == 120 || i == 121;
    EXPECT_EQ(resampling.absent()[i] != 0, lost) << i;
    EXPECT_NEAR(filled[i], Motion(i * kDt), lost ? 2e-6 : 1e-9) << i;
  }
  EXPECT_GT(std::abs(lines[50] - Motion(50 * kDt)), 1e-5);
}

TEST(MarkGuesses, AreGapsOverWhichCurvesAreOffByMoreThanTheNoise) {
  std::vector<double> channel;
  for (int i = 0; i < 400; ++i) channel.push_back(Motion(i * kDt));
  std::vector<char> absent(400, 0);
  absent[100] = MeasuredLog::kFilled;
  absent[200] = absent[201] = absent[202] = MeasuredLog::kFilled;
  std::vector<char> one = absent;
  MarkGuesses(channel, 1e-3, one);
  EXPECT_EQ(one, absent);
  MarkGuesses(channel, 5e-7, one);  // three rows are off by more, one is not
  EXPECT_EQ(one[100], MeasuredLog::kFilled);
  EXPECT_EQ(one[201], MeasuredLog::kGuessed);
}

}  // namespace
}  // namespace robostress::calibration
