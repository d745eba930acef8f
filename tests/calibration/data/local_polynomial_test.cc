#include "calibration/data/local_polynomial.h"

#include <gtest/gtest.h>

#include <cmath>

namespace robostress::calibration {
namespace {

TEST(LocalPolynomial, AParabolaHasItsOwnDerivativesAtEveryRow) {
  constexpr double kStep = 0.01;  // [s]
  std::vector<double> signal;
  for (int i = 0; i < 200; ++i)
    signal.push_back(0.3 + 0.5 * i * kStep + 0.7 * i * i * kStep * kStep);
  for (const int order : {2, 4}) {
    const SmoothSignal fit = FitLocalPolynomials(signal, kStep, 6, order, 1e-4, {0, 90, 200});
    for (int i = 0; i < 200; ++i) {
      EXPECT_NEAR(fit.value[i], signal[i], 1e-9);
      EXPECT_NEAR(fit.first[i], 0.5 + 1.4 * i * kStep, 1e-6);
      EXPECT_NEAR(fit.second[i], 1.4, 1e-4);
    }
  }
}

// A ramp that moves far less than a step of the encoder a row has no differences to speak of.
TEST(LocalPolynomial, TheNoiseOfAReadingIsNoLessThanThatOfItsResolution) {
  constexpr double kResolution = 2e-3;  // [rad]
  std::vector<double> reading;
  for (int i = 0; i < 4000; ++i) reading.push_back(kResolution * std::floor(0.05 * i));
  EXPECT_GE(NoiseOfReading(reading), 0.99 * kResolution / std::sqrt(12.0));
}

}  // namespace
}  // namespace robostress::calibration
