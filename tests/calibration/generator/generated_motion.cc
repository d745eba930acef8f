#include "tests/calibration/generator/generated_motion.h"

#include <algorithm>
#include <cmath>

namespace robostress::generator {
namespace {

// 10 s^3 - 15 s^4 + 6 s^5: rest to rest.
double MinimumJerk(double s) { return s * s * s * (10 + s * (6 * s - 15)); }

constexpr double kBlend = 0.2;  // [s] over which a segment fades in from its centre

}  // namespace

const char* MotionName(Motion motion) {
  constexpr const char* kNames[] = {"multi_sine", "chirp", "moves", "ramps", "mixed"};
  return kNames[static_cast<int>(motion)];
}

double Excitation::Segment::At(double t) const {
  const double s = t - begin, length = end - begin;
  double q = 0;
  for (const Sine& sine : sines)
    q += sine.amplitude * std::sin(2 * M_PI * sine.frequency * s + sine.phase);
  if (chirp_amplitude != 0)
    q += chirp_amplitude *
         std::sin(2 * M_PI * (chirp_from * s + (chirp_to - chirp_from) * s * s / (2 * length)));
  for (size_t i = 0; i + 1 < knots.size(); ++i) {
    if (t < knots[i].t || (t >= knots[i + 1].t && i + 2 < knots.size())) continue;
    const double share = std::clamp((t - knots[i].t) / (knots[i + 1].t - knots[i].t), 0.0, 1.0);
    q += knots[i].q +
         (knots[i + 1].q - knots[i].q) * (knots[i].straight ? share : MinimumJerk(share));
  }
  // Segments meet at their centre at rest.
  const double edge = std::min(s, length - s) / (2 * kBlend);
  return centre + q * (edge >= 1 ? 1 : MinimumJerk(std::max(0.0, edge)));
}

Excitation::Segment Excitation::DrawSegment(Motion motion, double amplitude, double centre,
                                            double fastest, double begin, double end,
                                            RandomStream& random) {
  Segment segment;
  segment.begin = begin, segment.end = end, segment.centre = centre;
  switch (motion) {
    case Motion::kMultiSine: {
      const int count = 3 + random.UniformInt(4);
      double sum = 0;
      for (int i = 0; i < count; ++i) {
        const double frequency = 0.1 * std::pow(fastest / 0.1, (i + random.Uniform()) / count);
        const double weight = 1 / std::sqrt(frequency);
        segment.sines.push_back({weight, frequency, random.Uniform(0, 2 * M_PI)});
        sum += weight;
      }
      for (Sine& sine : segment.sines) sine.amplitude *= 1.3 * amplitude / sum;
      break;
    }
    case Motion::kChirp:
      segment.chirp_from = 0.1;
      segment.chirp_to = 1.5 * fastest;
      segment.chirp_amplitude = 0.6 * amplitude;
      break;
    case Motion::kMoves:
    case Motion::kMixed: {
      segment.knots.push_back({begin, 0, false});
      for (double t = begin; t < end;) {
        const double target = random.Uniform(-amplitude, amplitude);
        const double way = std::abs(target - segment.knots.back().q) / amplitude;
        t += std::max(0.15, way * random.Uniform(0.4, 1.2) / fastest);
        segment.knots.push_back({t, target, false});
        t += random.Uniform(0.05, 0.4);
        segment.knots.push_back({t, target, false});
      }
      break;
    }
    case Motion::kRamps: {
      segment.knots.push_back({begin, 0, true});
      double side = random.Uniform() < 0.5 ? -1 : 1;
      for (double t = begin; t < end; side = -side) {
        const double target = side * random.Uniform(0.5, 1) * amplitude;
        t += std::abs(target - segment.knots.back().q) / amplitude / fastest *
             random.Uniform(0.5, 2.5);
        segment.knots.push_back({t, target, true});
      }
      break;
    }
  }
  return segment;
}

Excitation Excitation::Draw(Motion motion, double amplitude, double centre, double fastest,
                            double duration, RandomStream& random) {
  Excitation excitation;
  if (motion != Motion::kMixed) {
    excitation.segments_.push_back(
        DrawSegment(motion, amplitude, centre, fastest, 0, duration, random));
    return excitation;
  }
  constexpr Motion kParts[] = {Motion::kMultiSine, Motion::kRamps, Motion::kMoves, Motion::kChirp};
  const int first = random.UniformInt(4);
  for (int i = 0; i < 4; ++i)
    excitation.segments_.push_back(DrawSegment(kParts[(first + i) % 4], amplitude, centre, fastest,
                                               duration * i / 4, duration * (i + 1) / 4, random));
  return excitation;
}

Excitation Excitation::OfRows(const std::vector<double>& q, double dt) {
  Excitation excitation;
  excitation.rows_ = q;
  excitation.rows_dt_ = dt;
  return excitation;
}

double Excitation::At(double t) const {
  if (!rows_.empty()) {
    const double place = std::clamp(t / rows_dt_, 0.0, static_cast<double>(rows_.size() - 1));
    const auto row = std::min(static_cast<size_t>(place), rows_.size() - 2);
    return rows_[row] + (place - static_cast<double>(row)) * (rows_[row + 1] - rows_[row]);
  }
  const double at = std::max(0.0, t * speed_);
  const auto segment = std::find_if(segments_.begin(), segments_.end() - 1,
                                    [&](const Segment& one) { return at < one.end; });
  return middle_ + size_ * (segment->At(std::min(at, segment->end)) - middle_);
}

Excitation Excitation::Changed(double speed, double size, double middle) const {
  Excitation changed = *this;
  changed.speed_ = speed;
  changed.size_ = size;
  changed.middle_ = middle;
  return changed;
}

}  // namespace robostress::generator
