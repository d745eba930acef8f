#pragma once

#include <cmath>

namespace robostress::calibration {

// Cosine and sine of an angle that changes little from one call to the next: by the angle's sum
// with one that is known, with series that are exact to rounding.
class Posture {
 public:
  // q [rad]
  void Turn(double q) {
    const double d = q - reference_;
    if (!(std::abs(d) < kNear)) {
      reference_ = q;
      cos_ref_ = cosine = std::cos(q);
      sin_ref_ = sine = std::sin(q);
      return;
    }
    const double d2 = d * d;
    const double c = 1 - d2 * (1.0 / 2 - d2 * (1.0 / 24 - d2 * (1.0 / 720 - d2 / 40320)));
    const double s = d * (1 - d2 * (1.0 / 6 - d2 * (1.0 / 120 - d2 / 5040)));
    cosine = cos_ref_ * c - sin_ref_ * s;
    sine = sin_ref_ * c + cos_ref_ * s;
  }

  double cosine = 1, sine = 0;

 private:
  static constexpr double kNear = 0.05;  // [rad]
  double reference_ = 0, cos_ref_ = 1, sin_ref_ = 0;
};

}  // namespace robostress::calibration
