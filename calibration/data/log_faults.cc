#include "calibration/data/log_faults.h"

#include <algorithm>
#include <cmath>

#include "common/statistics.h"

namespace robostress::calibration {
namespace {

constexpr int kSpeedBins = 8;
constexpr int kMinBinRows = 40;
constexpr double kOrdersAgree = 1.3;  // ratio of the noise that two orders of differences tell
constexpr double kGrows = 1.6;        // variance of the fastest bin over that of the slowest
constexpr double kLine = 0.9;         // correlation of a bin's variance with its squared speed
constexpr size_t kLags = 30;
constexpr double kCorrelated = 0.2;
constexpr double kStraight = 1e-6;  // of a command's range: less is no bend
constexpr int kMinBends = 20;
constexpr size_t kRowsAStep = 10;  // at least, of a reading that is slow
constexpr int kMaxHeldRows = 100;
constexpr double kDrawn = 0.3;       // share of steps
constexpr double kOnTheGrid = 0.98;  // share of bends
constexpr double kBendsAtAll = 0.3;  // share of places where one may be

// Differences of white noise, scaled so that their deviation is the noise's.
std::vector<double> ScaledDifferences(std::vector<double> values, int order) {
  double variance = 1;
  for (int k = 1; k <= order; ++k) {
    for (size_t i = 0; i + 1 < values.size(); ++i) values[i] = values[i + 1] - values[i];
    values.pop_back();
    variance *= 2.0 * (2 * k - 1) / k;
  }
  for (double& value : values) value /= std::sqrt(variance);
  return values;
}

// Differences of order k of white noise know nothing of each other from k + 1 rows on. Those of a
// motion that a controller kicks every few rows do.
bool AreOfWhiteNoise(const std::vector<double>& signal) {
  const std::vector<double> differences = ScaledDifferences(signal, 6);
  std::vector<double> sizes;
  for (const double value : differences) sizes.push_back(std::abs(value));
  const double most = 4 * UpperMedian(std::move(sizes));
  const auto at = [&](size_t i) { return std::clamp(differences[i], -most, most); };
  double energy = 0;
  for (size_t i = 0; i < differences.size(); ++i) energy += at(i) * at(i);
  for (size_t lag = 7; lag <= kLags; ++lag) {
    double sum = 0;
    for (size_t i = 0; i + lag < differences.size(); ++i) sum += at(i) * at(i + lag);
    if (std::abs(sum) > kCorrelated * energy) return false;
  }
  return true;
}

struct SpeedBin {
  double speed2 = 0, variance = 0;
};

// Variances from medians, over bins of equal count by speed.
std::vector<SpeedBin> BinVariances(const std::vector<double>& signal, const std::vector<double>& dq,
                                   int order) {
  const std::vector<double> differences = ScaledDifferences(signal, order);
  std::vector<std::pair<double, double>> rows;  // speed^2, size
  for (size_t i = 0; i < differences.size(); ++i) {
    const double speed = dq[i + static_cast<size_t>(order) / 2];
    rows.emplace_back(speed * speed, std::abs(differences[i]));
  }
  std::sort(rows.begin(), rows.end());
  std::vector<SpeedBin> bins;
  const size_t count = rows.size() / kSpeedBins;
  if (count < kMinBinRows) return bins;
  for (int b = 0; b < kSpeedBins; ++b) {
    SpeedBin bin;
    std::vector<double> sizes;
    for (size_t i = b * count; i < (b + 1) * count; ++i) {
      bin.speed2 += rows[i].first / static_cast<double>(count);
      sizes.push_back(rows[i].second);
    }
    bin.variance = std::pow(UpperMedian(std::move(sizes)) / 0.6745, 2);
    bins.push_back(bin);
  }
  return bins;
}

struct Line {
  double offset = 0, slope = 0, correlation = 0;
};

Line FitLine(const std::vector<SpeedBin>& bins) {
  double x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  const double n = static_cast<double>(bins.size());
  for (const SpeedBin& bin : bins) x += bin.speed2 / n, y += bin.variance / n;
  for (const SpeedBin& bin : bins) {
    xx += (bin.speed2 - x) * (bin.speed2 - x);
    xy += (bin.speed2 - x) * (bin.variance - y);
    yy += (bin.variance - y) * (bin.variance - y);
  }
  if (xx == 0 || yy == 0) return {y, 0, 0};
  return {y - xy / xx * x, xy / xx, xy / std::sqrt(xx * yy)};
}

std::vector<size_t> BendsOf(const std::vector<double>& command) {
  std::vector<size_t> bends;
  if (command.size() < 4) return bends;
  const auto [low, high] = std::minmax_element(command.begin(), command.end());
  const double least = kStraight * (*high - *low);
  for (size_t i = 1; i + 1 < command.size(); ++i)
    if (std::abs(command[i + 1] - 2 * command[i] + command[i - 1]) > least) bends.push_back(i);
  return bends;
}

bool AreOnGrid(const std::vector<size_t>& bends, int rows) {
  const size_t phase = bends[bends.size() / 2] % rows;
  const auto on =
      std::count_if(bends.begin(), bends.end(), [&](size_t bend) { return bend % rows == phase; });
  return static_cast<double>(on) > kOnTheGrid * static_cast<double>(bends.size());
}

// From the last row of the command before to the first of the one after.
struct Step {
  size_t row = 0;
  bool between = false;  // a row of neither lies between
};

std::vector<Step> StepsOf(const std::vector<double>& command) {
  std::vector<Step> steps;
  if (command.size() < 6) return steps;
  const auto [low, high] = std::minmax_element(command.begin(), command.end());
  const double least = kStraight * (*high - *low);
  const auto same = [&](size_t a, size_t b) { return std::abs(command[a] - command[b]) <= least; };
  for (size_t i = 1; i + 3 < command.size(); ++i) {
    if (!same(i - 1, i) || same(i, i + 1)) continue;
    if (same(i + 1, i + 2)) steps.push_back({i, false});
    const double between = (command[i + 1] - command[i]) * (command[i + 2] - command[i + 1]);
    if (!same(i + 1, i + 2) && same(i + 2, i + 3) && between > 0) steps.push_back({i, true});
  }
  return steps;
}

}  // namespace

ReadingNoise NoiseBySpeed(const std::vector<double>& signal, const std::vector<double>& dq) {
  const std::vector<SpeedBin> fifth = BinVariances(signal, dq, 5),
                              sixth = BinVariances(signal, dq, 6);
  if (fifth.empty() || sixth.empty()) return {};
  const Line line = FitLine(sixth), other = FitLine(fifth);
  const double slowest = std::max(sixth.front().variance, 1e-300);
  if (line.slope <= 0 || line.correlation < kLine || sixth.back().variance < kGrows * slowest ||
      other.slope < line.slope / (kOrdersAgree * kOrdersAgree) ||
      other.slope > line.slope * kOrdersAgree * kOrdersAgree || !AreOfWhiteNoise(signal))
    return {};
  return {std::sqrt(std::max(0.0, line.offset)), std::sqrt(line.slope)};
}

std::vector<double> BetweenSteps(std::vector<double> reading) {
  struct Point {
    double row, value;
  };
  std::vector<Point> middles;
  for (size_t i = 1; i < reading.size(); ++i)
    if (reading[i] != reading[i - 1])
      middles.push_back({static_cast<double>(i) - 0.5, 0.5 * (reading[i] + reading[i - 1])});
  if (middles.empty() || middles.size() * kRowsAStep > reading.size()) return reading;
  middles.insert(middles.begin(), {0, reading.front()});
  middles.push_back({static_cast<double>(reading.size()), reading.back()});
  size_t next = 1;
  for (size_t i = 0; i < reading.size(); ++i) {
    const double row = static_cast<double>(i);
    while (row > middles[next].row) ++next;
    const Point &a = middles[next - 1], &b = middles[next];
    reading[i] = a.value + (row - a.row) / (b.row - a.row) * (b.value - a.value);
  }
  return reading;
}

int RowsBetweenBends(const std::vector<double>& command) {
  const std::vector<size_t> bends = BendsOf(command);
  if (bends.size() < kMinBends) return 0;
  for (int rows = kMaxHeldRows; rows >= 2; --rows) {
    const double places = static_cast<double>(command.size()) / rows;
    if (static_cast<double>(bends.size()) > kBendsAtAll * places && AreOnGrid(bends, rows))
      return rows;
  }
  return 0;
}

bool BendsEvery(const std::vector<double>& command, int rows) {
  const std::vector<size_t> bends = BendsOf(command);
  return bends.size() > 1 && AreOnGrid(bends, rows);
}

double DrawnSteps(const std::vector<double>& command) {
  int drawn = 0, sharp = 0;
  for (const Step& step : StepsOf(command)) (step.between ? drawn : sharp) += 1;
  const double share = static_cast<double>(drawn) / std::max(1, drawn + sharp);
  return drawn + sharp >= kMinBends && share > kDrawn ? share : 0;
}

std::vector<double> MeansOfDrawnSteps(const std::vector<double>& command, double share) {
  std::vector<double> means = command;
  for (const Step& step : StepsOf(command)) {
    const double before = command[step.row], after = command[step.row + (step.between ? 2 : 1)];
    if (step.between) {
      const double drawn = (command[step.row + 1] - before) / (after - before);
      means[step.row + 1] = after - (1 - drawn) * share * (after - before);
    } else {
      means[step.row] = before + 0.5 * (1 - share) * (after - before);
    }
  }
  return means;
}

std::vector<double> StepsOfLines(const std::vector<double>& command, int rows) {
  size_t phase = 0;
  double most = 0;
  for (size_t begin = 1; begin <= static_cast<size_t>(rows); ++begin) {
    double bent = 0;
    for (size_t i = begin; i + 1 < command.size(); i += rows)
      bent += std::abs(command[i + 1] - 2 * command[i] + command[i - 1]);
    if (bent > most) most = bent, phase = begin % rows;
  }
  std::vector<double> steps = command;
  for (size_t i = 1; i < steps.size(); ++i)
    if (i % rows != phase) steps[i] = steps[i - 1];
  return steps;
}

}  // namespace robostress::calibration
