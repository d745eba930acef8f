#pragma once

#include <vector>

namespace robostress::calibration {

// When the rows of a log were taken.
struct RowClock {
  static constexpr double kJitter = 0.02;  // of dt; more is resampled
  double dt = 0;                           // [s]
  double jitter = 0;                       // [rows] largest; 0: rows stand where they should
  int lost = 0;                            // rows that are missing between others
  bool resampled() const { return jitter > 0 || lost > 0; }
};

// The places of a clock's rows among those that were logged, at times `t` [s].
class Resampling {
 public:
  Resampling(const std::vector<double>& t, const RowClock& clock);
  // Of a channel with a value per logged row: by lines, for what steps; by polynomials through the
  // four rows around.
  std::vector<double> Lines(const std::vector<double>& values) const;
  std::vector<double> Curves(const std::vector<double>& values) const;
  // [rows] MeasuredLog::kFilled where there was none.
  const std::vector<char>& absent() const { return absent_; }

 private:
  const std::vector<double>& t_;
  std::vector<size_t> before_;
  std::vector<double> at_;
  std::vector<char> absent_;
};

// Marks in `absent` as MeasuredLog::kGuessed the gaps for which a channel's curves are off by more
// than `noise`: so far are they off, three times the root mean square, where nothing is missing.
void MarkGuesses(const std::vector<double>& channel, double noise, std::vector<char>& absent);

}  // namespace robostress::calibration
