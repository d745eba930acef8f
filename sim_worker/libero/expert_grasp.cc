#include "sim_worker/libero/expert_grasp.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

namespace robostress::libero {
namespace {

using Eigen::Vector3d;

constexpr double kWidest = 0.072;     // [m] between the fingers that fits
constexpr double kTip = 0.012;        // [m] of the fingers below the grip site
constexpr double kDepth = 0.03;       // [m] below the top at which a grasp begins to be looked for
constexpr double kSlice = 0.012;      // [m] half the height that the pads touch
constexpr double kFingers = 0.035;    // [m] from the palm to the grip site
constexpr double kPad = 0.010;        // [m] half a pad's breadth
constexpr double kStep = 0.01;        // [m] from one height or place to the next
constexpr int kTurns = 6;             // of 15 degrees, to either side
constexpr double kTurn = M_PI / 12;   // [rad]
constexpr double kFingerOut = 0.048;  // [m] from the tool to the middle of an open finger
const Vector3d kFinger(0.008, 0.008, 0.02);    // half a finger [m]
const Vector3d kBetween(0.010, 0.010, 0.010);  // half a fourth of the gap [m]
constexpr double kPalm = 0.065;                // [m] of the hand's middle above the tool
const Vector3d kPalmPart(0.03, 0.03, 0.032);   // half a fifth of the hand [m]
constexpr double kWrist = 0.2;                 // [m] of the wrist's middle above the tool
const Vector3d kWristPart(0.075, 0.075, 0.1);  // half of it [m]
// What a candidate is worth less for.
constexpr double kPerRadian = 0.4, kPerDepth = 4.0, kIfBlocked = 3.0, kIfBlockedThere = 0.08,
                 kPerMetre = 1.0, kPerMetreBeyond = 6.0, kPerAside = 8.0, kPerInwards = 30.0;
constexpr double kComfortable = 0.72;  // [m] of the tool from the base

// An object that is held by its wall: the ring on which the tool stands, above the origin.
struct Rim {
  std::string_view category;
  double radius, height;  // [m]
};
constexpr Rim kRims[] = {
    {"akita_black_bowl", 0.049, 0.043},
    {"black_bowl", 0.049, 0.043},
    {"bigger_akita_black_bowl", 0.0735, 0.068},
    {"white_bowl", 0.037, 0.026},
    {"porcelain_mug", 0.040, 0.090},
    {"white_yellow_mug", 0.046, 0.085},
    {"red_coffee_mug", 0.040, 0.110},
};

struct Candidate {
  Grasp grasp;
  double cost = std::numeric_limits<double>::infinity();
};

Vector3d Closing(double yaw) { return Vector3d(std::sin(yaw), -std::cos(yaw), 0); }

// How much of the open hand would stand in something: the fingers count most.
double Blockage(const ExpertView& view, const Grasp& grasp, int body) {
  const Vector3d across = Closing(grasp.yaw);
  double blocked = 0;
  for (const double side : {-1.0, 1.0}) {
    const Vector3d finger =
        grasp.p + side * kFingerOut * across + Vector3d(0, 0, kFinger.z() - kTip);
    if (view.Blocked(finger, kFinger, body)) blocked += 3;
  }
  // What else lies between the fingers would be held, too.
  for (const double along : {-0.03, -0.01, 0.01, 0.03}) {
    if (view.Blocked(grasp.p + along * across, kBetween, body)) blocked += 2;
  }
  for (const double along : {-0.08, -0.04, 0.0, 0.04, 0.08}) {
    if (view.Blocked(grasp.p + along * across + Vector3d(0, 0, kPalm), kPalmPart, body))
      blocked += 2;
  }
  if (view.Blocked(grasp.p + Vector3d(0, 0, kWrist), kWristPart, body)) blocked += 3;
  return blocked;
}

// What is asked for: `place` is where the origin goes.
struct Wanted {
  const ExpertView& view;
  int body;
  Vector3d place;
};

// Far out the arm is stretched, and the tool hardly moves.
double FarOut(const Wanted& wanted, const Vector3d& p) {
  const double reach = (p - wanted.view.Base()).head<2>().norm();
  return kPerMetre * reach + kPerMetreBeyond * std::max(0.0, reach - kComfortable);
}

void Keep(const Wanted& wanted, const Grasp& grasp, double cost, Candidate& best) {
  const ExpertView& view = wanted.view;
  const int body = wanted.body;
  const Vector3d there = grasp.p + wanted.place - view.Body(body);
  cost += kPerRadian * std::abs(grasp.yaw) + FarOut(wanted, grasp.p) + FarOut(wanted, there);
  if (cost >= best.cost) return;
  cost += kIfBlocked * Blockage(view, grasp, body);
  if (cost < best.cost) cost += kIfBlockedThere * Blockage(view, {there, grasp.yaw}, body);
  if (cost < best.cost) best = {grasp, cost};
}

Grasp AtRim(const Wanted& wanted, const Rim& rim) {
  const Vector3d origin = wanted.view.Body(wanted.body);
  Candidate best;
  for (int k = -kTurns; k <= kTurns; ++k) {
    const double yaw = k * kTurn;
    for (const double side : {-1.0, 1.0}) {
      for (const double inwards : {0.0, 0.009, -0.009}) {
        const Vector3d p =
            origin + side * (rim.radius - inwards) * Closing(yaw) + Vector3d(0, 0, rim.height);
        Keep(wanted, {p, yaw}, kPerInwards * std::abs(inwards), best);
      }
    }
  }
  return best.grasp;
}

// An interval of a line [m].
struct Span {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  bool empty() const { return low > high; }
  double middle() const { return (low + high) / 2; }
  double width() const { return high - low; }
  void Add(double from, double to) {
    low = std::min(low, from);
    high = std::max(high, to);
  }
};

// What open fingers must clear on their way down to `z`, `at` along the line `along`: the width
// across it of everything higher up. Empty where nothing is between the pads.
Span Between(const ExpertView& view, const std::vector<int>& geoms, double z, double at,
             const Vector3d& along, const Vector3d& across) {
  Span span;
  bool touched = false;
  for (const int geom : geoms) {
    const Vector3d centre = view.Geom(geom);
    const double past = std::abs(centre.dot(along) - at) - view.Support(geom, along);
    const double half = view.Support(geom, Vector3d::UnitZ());
    if (past > kPad || centre.z() + half < z - kSlice) continue;
    touched = touched || (past < 0 && centre.z() - half < z + kSlice);
    const double middle = centre.dot(across), size = view.Support(geom, across);
    span.Add(middle - size, middle + size);
  }
  return touched ? span : Span();
}

// The top of what the palm would come down on.
double TopAt(const ExpertView& view, const std::vector<int>& geoms, double at,
             const Vector3d& along) {
  double top = -std::numeric_limits<double>::infinity();
  for (const int geom : geoms) {
    if (std::abs(view.Geom(geom).dot(along) - at) < view.Support(geom, along) + kPalmPart.x())
      top = std::max(top, view.Geom(geom).z() + view.Support(geom, Vector3d::UnitZ()));
  }
  return top;
}

Grasp AroundIt(const Wanted& wanted) {
  const ExpertView& view = wanted.view;
  const std::vector<int> geoms = view.Geoms(wanted.body);
  const Extent extent = view.ExtentOf(geoms);
  const double lowest = extent.low.z() + kTip;
  const double first = std::max(lowest, extent.high.z() - kDepth);
  Candidate best;
  best.grasp = {Vector3d(extent.Centre().x(), extent.Centre().y(), first), 0};
  for (int k = -kTurns; k < kTurns; ++k) {
    const double yaw = k * kTurn;
    const Vector3d across = Closing(yaw), along(-across.y(), across.x(), 0);
    Span length;
    for (const int geom : geoms) {
      const double middle = view.Geom(geom).dot(along), size = view.Support(geom, along);
      length.Add(middle - size, middle + size);
    }
    for (double aside = -length.width() / 2; aside < length.width() / 2; aside += kStep) {
      const double at = length.middle() + aside;
      const double under = std::max(lowest, TopAt(view, geoms, at, along) - kFingers);
      for (double z = std::max(first, under); z >= under - 1e-9; z -= kStep) {
        const Span span = Between(view, geoms, z, at, along, across);
        if (span.empty() || span.width() > kWidest) continue;
        const Vector3d p = span.middle() * across + at * along + Vector3d(0, 0, z);
        const double cost =
            kPerDepth * (first - z) + kPerMetre * span.width() + kPerAside * std::abs(aside);
        Keep(wanted, {p, yaw, span.width()}, cost, best);
      }
    }
  }
  return best.grasp;
}

// A mug's handle: its middle in the body's frame, held across the body's y axis.
struct Handle {
  std::string_view category;
  double x, height;  // [m]
};
constexpr Handle kHandles[] = {{"white_yellow_mug", 0.062, 0.072}};

}  // namespace

std::optional<Grasp> HandleGrasp(const ExpertView& view, const LiberoObject& object) {
  for (const Handle& handle : kHandles) {
    if (handle.category != object.category) continue;
    const Eigen::Quaterniond frame = view.BodyQuat(object.body);
    const Vector3d across = frame * Vector3d::UnitY();
    const double yaw = std::remainder(std::atan2(across.x(), -across.y()), M_PI);
    return Grasp{view.Body(object.body) + frame * Vector3d(handle.x, 0, handle.height), yaw};
  }
  return std::nullopt;
}

Grasp FindGrasp(const ExpertView& view, const LiberoObject& object, const Vector3d& place) {
  const Wanted wanted{view, object.body, place};
  for (const Rim& rim : kRims) {
    if (rim.category == object.category) return AtRim(wanted, rim);
  }
  return AroundIt(wanted);
}

}  // namespace robostress::libero
