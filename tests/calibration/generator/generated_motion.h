#pragma once

#include <string>
#include <vector>

#include "common/random.h"

namespace robostress::generator {

enum class Motion { kMultiSine, kChirp, kMoves, kRamps, kMixed };

const char* MotionName(Motion motion);

// What a joint is asked to do over a log: a reference of position [rad], continuous in time,
// constant before 0.
class Excitation {
 public:
  // amplitude [rad] about `centre`; fastest [Hz] of its sines and chirps.
  static Excitation Draw(Motion motion, double amplitude, double centre, double fastest,
                         double duration, RandomStream& random);
  // Straight lines between positions [rad] at t = 0, dt, ...
  static Excitation OfRows(const std::vector<double>& q, double dt);
  double At(double t) const;
  // Faster by `speed`, and of `size` about `middle`.
  Excitation Changed(double speed, double size, double middle) const;

 private:
  struct Sine {
    double amplitude, frequency, phase;
  };
  struct Knot {
    double t, q;
    bool straight;  // to the next knot: a straight line, or a minimum-jerk move
  };
  struct Segment {
    double begin = 0, end = 0, centre = 0;
    std::vector<Sine> sines;
    double chirp_from = 0, chirp_to = 0, chirp_amplitude = 0;  // [Hz, Hz, rad]
    std::vector<Knot> knots;
    double At(double t) const;
  };
  static Segment DrawSegment(Motion motion, double amplitude, double centre, double fastest,
                             double begin, double end, RandomStream& random);
  std::vector<Segment> segments_;
  double speed_ = 1, size_ = 1, middle_ = 0;
  std::vector<double> rows_;  // of OfRows, in the place of segments
  double rows_dt_ = 0;
};

}  // namespace robostress::generator
