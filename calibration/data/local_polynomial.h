#pragma once

#include <vector>

namespace robostress::calibration {

// Standard deviation of the noise of a reading, from its differences and its resolution.
double NoiseOfReading(const std::vector<double>& signal);

// A signal with its first and second derivative per row, and the standard deviation of each: what
// the noise of the readings leaves and, from SmoothMotion, what smoothing bends.
struct SmoothSignal {
  std::vector<double> value, first, second;
  double value_noise = 0, first_noise = 0, second_noise = 0;
};

// Least-squares polynomials of `order` over `half` rows each side of every row (Savitzky and Golay
// 1964), one-sided at the ends of pieces: rows pieces[i] ... pieces[i + 1] - 1. noise: of the
// signal.
SmoothSignal FitLocalPolynomials(const std::vector<double>& signal, double dt, int half, int order,
                                 double noise, const std::vector<int>& pieces);

// Order 2 or 4 and the width, up to `most` rows each side, that leave the least error: noise, which
// a wide polynomial averages out, and bias, which is what two more orders of the same width change
// beyond their own noise. The second derivative has a width of its own. No pieces: one.
SmoothSignal SmoothMotion(const std::vector<double>& signal, double dt, int most,
                          std::vector<int> pieces = {});

}  // namespace robostress::calibration
