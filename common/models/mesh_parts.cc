#include "common/models/mesh_parts.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <unordered_set>
#include <utility>

namespace robostress {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

using Points = std::vector<Vector3d>;

constexpr double kCell = 0.0005;       // [m] of which one corner is enough
constexpr double kMiss = 0.001;        // [m] that a hull may leave out before it gets a corner more
constexpr size_t kMostCorners = 96;    // of a part
constexpr double kLeastGain = 0.02;    // of the volume, or a part is not cut
constexpr int kCuts = 12;              // of a piece's length, where it may be cut
constexpr size_t kCornersOfSome = 12;  // chosen before all points are looked at again
constexpr size_t kTriedPoints = 2000;  // of those that a hull leaves out
constexpr size_t kTried = 500;         // triangles that tell how good a cut is

// One point for each cell that has any: its centre.
Points Thinned(const Points& points) {
  std::unordered_set<uint64_t> seen;
  Points thinned;
  for (const Vector3d& p : points) {
    const Eigen::Array3d cell = (p / kCell).array().floor();
    uint64_t key = 0;  // 21 bits each: 500 m
    for (int i = 0; i < 3; ++i) {
      const auto at = static_cast<uint64_t>(static_cast<int64_t>(cell[i]) + (1 << 20));
      key = (key << 21) | (at & ((1 << 21) - 1));
    }
    if (seen.insert(key).second) thinned.push_back(kCell * (cell + 0.5).matrix());
  }
  return thinned;
}

Points SomeOf(const Points& points, size_t most) {
  const size_t stride = (points.size() + most - 1) / most;
  Points some;
  for (size_t i = 0; i < points.size(); i += stride) some.push_back(points[i]);
  return some;
}

// Leaves the points that the hull leaves out by more than may be; the furthest one's distance, not
// less than what may be, and place.
std::pair<double, Vector3d> KeepOutside(const Hull& hull, Points* points) {
  std::pair<double, Vector3d> furthest = {kMiss, Vector3d::Zero()};
  std::erase_if(*points, [&](const Vector3d& p) {
    const double distance = Distance(hull, {{p}, 0}, Eigen::Isometry3d::Identity());
    if (distance > furthest.first) furthest = {distance, p};
    return distance <= kMiss;
  });
  return furthest;
}

Hull HullOf(const Points& points) {
  const Points all = Thinned(points);
  Hull hull;
  for (int k = 0; k < 27; ++k) {
    const Vector3d direction(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
    const Vector3d& furthest = *std::max_element(
        all.begin(), all.end(),
        [&](const Vector3d& a, const Vector3d& b) { return direction.dot(a) < direction.dot(b); });
    if (std::find(hull.corners.begin(), hull.corners.end(), furthest) == hull.corners.end())
      hull.corners.push_back(furthest);
  }
  // Corners are chosen among some of the points, until a look at all finds none too far outside.
  Points outside = all;
  double left_out = KeepOutside(hull, &outside).first;
  while (!outside.empty() && hull.corners.size() < kMostCorners) {
    Points some = SomeOf(outside, kTriedPoints);
    const size_t most = std::min(kMostCorners, hull.corners.size() + kCornersOfSome);
    while (!some.empty() && hull.corners.size() < most) {
      const Vector3d furthest = KeepOutside(hull, &some).second;
      if (!some.empty()) hull.corners.push_back(furthest);
    }
    left_out = KeepOutside(hull, &outside).first;
  }
  hull.radius = left_out + std::sqrt(3.0) / 2 * kCell;
  return hull;
}

// Columns: along which points lie most, less, least.
Matrix3d AxesOf(const Points& points) {
  const Vector3d middle =
      std::accumulate(points.begin(), points.end(), Vector3d(Vector3d::Zero())) / points.size();
  Matrix3d spread = Matrix3d::Zero();
  for (const Vector3d& p : points) spread += (p - middle) * (p - middle).transpose();
  const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(spread);
  return solver.eigenvectors().rowwise().reverse();
}

// Of the box along the axes that holds the points, with a skin, so that a plate has one too [m^3].
double BoxVolume(const Points& points, const Matrix3d& axes) {
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  for (const Vector3d& p : points) {
    const Vector3d at = axes.transpose() * p;
    low = low.cwiseMin(at), high = high.cwiseMax(at);
  }
  return (high - low + Vector3d::Constant(2 * kMiss)).prod();
}

// Of the smallest of those along the mesh's axes, a whole's and the points' own.
double PieceVolume(const Points& points, const Matrix3d& axes) {
  return std::min({BoxVolume(points, Matrix3d::Identity()), BoxVolume(points, axes),
                   BoxVolume(points, AxesOf(points))});
}

// Triangles on either side of a plane, cut where it goes through them.
std::pair<Points, Points> Cut(const Points& corners, const Vector3d& along, double at) {
  std::pair<Points, Points> halves;
  for (size_t i = 0; i + 2 < corners.size(); i += 3) {
    for (const bool below : {true, false}) {
      Points inside;  // three corners or four, in a row
      for (size_t k = 0; k < 3; ++k) {
        const Vector3d &p = corners[i + k], &q = corners[i + (k + 1) % 3];
        const double dp = along.dot(p) - at, dq = along.dot(q) - at;
        if ((dp < 0) == below) inside.push_back(p);
        if ((dp < 0) != (dq < 0)) inside.push_back(p + dp / (dp - dq) * (q - p));
      }
      Points& half = below ? halves.first : halves.second;
      for (size_t k = 2; k < inside.size(); ++k)
        half.insert(half.end(), {inside[0], inside[k - 1], inside[k]});
    }
  }
  return halves;
}

// Triangles, and the best cut through them.
struct Piece {
  Points corners;
  double volume = 0;  // [m^3] of the box that holds it, by some of the triangles
  double gain = 0;    // of it
  Vector3d along = Vector3d::Zero();
  double at = 0;
};

Piece PieceOf(Points corners) {
  Piece piece{std::move(corners)};
  const size_t stride = std::max<size_t>(1, piece.corners.size() / (3 * kTried));
  Points some;
  for (size_t i = 0; i + 2 < piece.corners.size(); i += 3 * stride)
    some.insert(some.end(), &piece.corners[i], &piece.corners[i] + 3);
  const Matrix3d axes = AxesOf(some);
  piece.volume = PieceVolume(some, axes);
  for (int k = 0; k < 6; ++k) {
    const Vector3d along = k < 3 ? Vector3d(axes.col(k)) : Vector3d::Unit(k - 3);
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const Vector3d& p : some)
      low = std::min(low, along.dot(p)), high = std::max(high, along.dot(p));
    for (int i = 1; i < kCuts; ++i) {
      const double at = low + i * (high - low) / kCuts;
      const auto [below, above] = Cut(some, along, at);
      if (below.empty() || above.empty()) continue;
      const double gain = piece.volume - PieceVolume(below, axes) - PieceVolume(above, axes);
      if (gain > piece.gain) piece.gain = gain, piece.along = along, piece.at = at;
    }
  }
  return piece;
}

}  // namespace

std::vector<Hull> PartsOf(const Points& corners, size_t most) {
  if (corners.size() < 3) return {};
  std::vector<Piece> pieces;
  pieces.push_back(PieceOf(corners));
  while (pieces.size() < most) {
    const auto best =
        std::max_element(pieces.begin(), pieces.end(),
                         [](const Piece& a, const Piece& b) { return a.gain < b.gain; });
    double volume = 0;
    for (const Piece& piece : pieces) volume += piece.volume;
    if (!(best->gain > kLeastGain * volume)) break;
    auto [below, above] = Cut(best->corners, best->along, best->at);
    *best = PieceOf(std::move(below));
    pieces.push_back(PieceOf(std::move(above)));
  }
  std::vector<Hull> parts;
  for (const Piece& piece : pieces) parts.push_back(HullOf(piece.corners));
  return parts;
}

}  // namespace robostress
