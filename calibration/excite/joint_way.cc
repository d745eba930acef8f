#include "calibration/excite/joint_way.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "common/random.h"

namespace robostress::calibration {
namespace {

constexpr int kHarmonics = 5;
constexpr double kFade = 0.1;      // of a piece's length, at either end of its sines
constexpr double kSlack = 1e-6;    // of the limits, that rounding may take
constexpr double kSlowest = 0.05;  // of the most speed, of a walk
constexpr int kMostMoves = 100;
constexpr double kSlowest_hz = 0.1;  // of a sweep

double SmoothStep(double s) {
  s = std::clamp(s, 0.0, 1.0);
  return s * s * s * (10 - 15 * s + 6 * s * s);
}

// A move from rest to rest that speeds up, goes on and brakes.
class Move {
 public:
  Move(double from, double to, double velocity, double acceleration)
      : from_(from), sign_(to < from ? -1 : 1), way_(std::abs(to - from)) {
    velocity_ = std::min(velocity, std::sqrt(way_ * acceleration));
    acceleration_ = acceleration;
    rise_ = velocity_ / acceleration;
    seconds_ = velocity_ > 0 ? way_ / velocity_ + rise_ : 0;
  }
  double seconds() const { return seconds_; }
  double At(double t) const {
    if (t >= seconds_) return from_ + sign_ * way_;
    const double late = seconds_ - t;
    if (t < rise_) return from_ + sign_ * acceleration_ * t * t / 2;
    if (late < rise_) return from_ + sign_ * (way_ - acceleration_ * late * late / 2);
    return from_ + sign_ * velocity_ * (t - rise_ / 2);
  }

 private:
  double from_, sign_, way_, velocity_ = 0, acceleration_ = 0, rise_ = 0, seconds_ = 0;
};

// Goes from one place to the next as long as there is time to come back to the centre.
class Walk {
 public:
  Walk(const JointRoom& room, double velocity, double dt, int rows)
      : room_(room), velocity_(velocity), dt_(dt), rows_(rows), q_{room.centre} {}

  void SetSpeed(double velocity) { velocity_ = velocity; }
  double Left() const { return (rows_ - static_cast<int>(q_.size())) * dt_; }
  double Seconds(double from, double to) const {
    return Move(from, to, velocity_, room_.acceleration).seconds();
  }
  bool HasTimeFor(double to, double rest) const {
    return Seconds(q_.back(), to) + rest + Seconds(to, room_.centre) + 3 * dt_ <= Left();
  }
  void Go(double to) {
    const Move move(q_.back(), to, velocity_, room_.acceleration);
    const int count = static_cast<int>(std::ceil(move.seconds() / dt_ - 1e-9));
    for (int i = 1; i <= count && static_cast<int>(q_.size()) < rows_; ++i)
      q_.push_back(move.At(i * dt_));
  }
  void Rest(double seconds) {
    for (double t = dt_; t <= seconds && static_cast<int>(q_.size()) < rows_; t += dt_)
      q_.push_back(q_.back());
  }
  std::vector<double> End() {
    Go(room_.centre);
    q_.resize(rows_, room_.centre);
    return std::move(q_);
  }

 private:
  const JointRoom& room_;
  double velocity_, dt_;
  int rows_;
  std::vector<double> q_;
};

// The end of the way on a side, at most as far as there is time for there and back.
double EndOf(const JointRoom& room, const Walk& walk, int side, double size, double share) {
  double way = size * (side > 0 ? room.upper - room.centre : room.centre - room.lower);
  while (way > 0 && 2 * walk.Seconds(room.centre, room.centre + way) > share * walk.Left())
    way *= 0.9;
  return room.centre + side * way;
}

// Scales a wave about 0 until place, speed and acceleration fit the room.
std::vector<double> Fitted(const std::vector<double>& wave, const JointRoom& room, double size,
                           double speed, double dt) {
  double scale = 1e300;
  const auto fit = [&](double most, double value) {
    if (std::abs(value) > 1e-12) scale = std::min(scale, most / std::abs(value));
  };
  for (size_t i = 0; i < wave.size(); ++i) {
    fit(size * (wave[i] > 0 ? room.upper - room.centre : room.centre - room.lower), wave[i]);
    if (i == 0) continue;
    fit(speed * room.velocity, (wave[i] - wave[i - 1]) / dt);
    if (i + 1 < wave.size())
      fit(room.acceleration, (wave[i + 1] - 2 * wave[i] + wave[i - 1]) / (dt * dt));
  }
  std::vector<double> q;
  for (const double value : wave)
    q.push_back(room.centre + (scale < 1e300 ? (1 - kSlack) * scale * value : 0));
  return q;
}

std::vector<double> RandomWalk(const JointPiece& piece, const JointRoom& room, double dt,
                               int rows) {
  RandomStream random(StreamKey("walk").With(static_cast<int64_t>(piece.seed)));
  Walk walk(room, room.velocity, dt, rows);
  for (int i = 0; i < kMostMoves; ++i) {
    const double share = random.Uniform(-1, 1);
    const double way = share > 0 ? room.upper - room.centre : room.centre - room.lower;
    const double to = room.centre + piece.size * share * way;
    walk.SetSpeed((1 - kSlack) * room.velocity * std::pow(kSlowest, random.Uniform()));
    const double rest = random.Uniform() < 0.3 ? random.Uniform(0, 0.4) : 0;
    if (!walk.HasTimeFor(to, rest)) continue;
    walk.Go(to);
    walk.Rest(rest);
  }
  walk.SetSpeed((1 - kSlack) * room.velocity);
  return walk.End();
}

std::vector<double> Sines(const JointPiece& piece, const JointRoom& room, double dt, int rows) {
  RandomStream random(StreamKey("excite").With(static_cast<int64_t>(piece.seed)));
  const double length = (rows - 1) * dt;
  std::vector<double> wave(rows);
  for (int k = 1; k <= kHarmonics; ++k) {
    const double frequency = piece.frequency * k / kHarmonics, phase = random.Uniform(0, 2 * M_PI),
                 weight = random.Uniform(0.3, 1) / k;
    for (int i = 0; i < rows; ++i)
      wave[i] += weight * std::sin(2 * M_PI * frequency * i * dt + phase);
  }
  for (int i = 0; i < rows; ++i) {
    const double edge = std::min(i * dt, length - i * dt) / (kFade * length);
    wave[i] *= SmoothStep(edge);
  }
  return Fitted(wave, room, piece.size, piece.speed, dt);
}

// A sine from `from` to `to` [Hz] on a logarithmic scale, at every moment as large as the room
// allows.
std::vector<double> Chirp(const JointRoom& room, double size, double from, double to, double phase,
                          double dt, int rows) {
  const double length = (rows - 1) * dt, rate = std::log(to / from) / length,
               most = size * std::min(room.upper - room.centre, room.centre - room.lower);
  std::vector<double> wave(rows);
  for (int i = 0; i < rows; ++i) {
    const double t = i * dt, omega = 2 * M_PI * from * std::exp(rate * t);
    const double largest =
        std::min({most, room.velocity / omega, room.acceleration / (omega * omega)});
    const double edge = std::min(t, length - t) / (kFade * length);
    wave[i] = largest * SmoothStep(edge) * std::sin((omega - 2 * M_PI * from) / rate + phase);
  }
  return Fitted(wave, room, size, 1, dt);
}

}  // namespace

std::string JointPiece::Name() const {
  switch (kind) {
    case Kind::kRamps:
      return absl::StrFormat("ramps at %.2g of the speed, %.2g of the way", speed, size);
    case Kind::kMoves:
      return absl::StrFormat("moves with stops, %.2g of the way", size);
    case Kind::kSines:
      return absl::StrFormat("five sines up to %.2g Hz", frequency);
    case Kind::kChirp:
      return absl::StrFormat("a chirp up to %.2g Hz", frequency);
    case Kind::kWalk:
      return absl::StrFormat("walk number %d, %.2g of the way", static_cast<int>(seed), size);
    case Kind::kRest:
      return absl::StrFormat("rest at %.2g of the way %s", size, side > 0 ? "up" : "down");
  }
  return "";
}

std::vector<JointPiece> PiecePool(double fastest) {
  using Kind = JointPiece::Kind;
  std::vector<JointPiece> pool;
  for (const double speed : {0.03, 0.08, 0.2, 0.5, 1.0})
    for (const int side : {1, -1})
      pool.push_back({.kind = Kind::kRamps, .speed = speed, .side = side});
  for (const double size : {0.02, 0.1})
    for (const double speed : {0.08, 0.3})
      pool.push_back({.kind = Kind::kRamps, .size = size, .speed = speed});
  for (const double size : {0.1, 0.3, 1.0})
    for (const int side : {1, -1})
      pool.push_back({.kind = Kind::kMoves, .size = size, .side = side});
  for (const double share : {0.25, 0.5, 1.0})
    for (uint64_t seed = 0; seed < 4; ++seed)
      pool.push_back({.kind = Kind::kSines, .frequency = share * fastest, .seed = seed});
  for (const double size : {0.2, 1.0})
    for (uint64_t seed = 0; seed < 12; ++seed)
      pool.push_back({.kind = Kind::kWalk, .size = size, .seed = seed});
  for (const double size : {0.3, 1.0})
    pool.push_back({.kind = Kind::kChirp, .size = size, .frequency = fastest});
  for (const int side : {1, -1}) pool.push_back({.kind = Kind::kRest, .side = side});
  return pool;
}

std::vector<double> SamplePiece(const JointPiece& piece, const JointRoom& room, double dt,
                                int rows) {
  using Kind = JointPiece::Kind;
  if (piece.kind == Kind::kSines) return Sines(piece, room, dt, rows);
  if (piece.kind == Kind::kChirp)
    return Chirp(room, piece.size, 0.1 * piece.frequency, piece.frequency, 0, dt, rows);
  if (piece.kind == Kind::kWalk) return RandomWalk(piece, room, dt, rows);
  // Between rows, too, a move keeps within its acceleration.
  Walk walk(room, (1 - kSlack) * piece.speed * room.velocity, dt, rows);
  if (piece.kind == Kind::kRest) {
    const double end = EndOf(room, walk, piece.side, piece.size, 0.6);
    walk.Go(end);
    walk.Rest(walk.Left() - walk.Seconds(end, room.centre) - 2 * dt);
    return walk.End();
  }
  const bool stops = piece.kind == Kind::kMoves;
  const double ends[] = {EndOf(room, walk, piece.side, piece.size, 0.5),
                         EndOf(room, walk, -piece.side, piece.size, 0.5)};
  constexpr double kShares[] = {1, 1, 0.4, 0.7};  // of moves
  for (int i = 0;; ++i) {
    const double share = stops ? kShares[i / 2 % 4] : 1;
    const double to = room.centre + share * (ends[i % 2] - room.centre), rest = stops ? 0.25 : 0;
    if (!walk.HasTimeFor(to, rest)) break;
    walk.Go(to);
    walk.Rest(rest);
  }
  return walk.End();
}

std::vector<double> SampleSweep(const JointRoom& room, double fastest, double phase, double dt,
                                int rows) {
  return Chirp(room, 1, std::min(kSlowest_hz, fastest / 2), fastest, phase, dt, rows);
}

}  // namespace robostress::calibration
