#include "robot_client/emulator/guiding_hand.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

constexpr char kHeader[] = "t,J1,J2,J3,J4,J5,J6,opening";
// Of an arm that pulls at the joints [Nm/rad], [Nm s/rad], and the most it gives [Nm].
constexpr JointVector kStiffness = {200, 200, 200, 60, 60, 60};
constexpr JointVector kDamping = {12, 12, 8, 1.2, 1.2, 1};
constexpr JointVector kMost = {20, 20, 20, 5, 5, 5};
// Of two fingers on the gripper [N/m], [N s/m], [N].
constexpr double kFingerStiffness = 2000, kFingerDamping = 60, kMostFinger = 20;

}  // namespace

absl::StatusOr<GuidingHand> GuidingHand::Create(std::vector<HandPoint> points) {
  for (size_t i = 0; i < points.size(); ++i) {
    const bool finite = std::all_of(points[i].position.begin(), points[i].position.end(),
                                    [](double x) { return std::isfinite(x); });
    if (!finite || !(points[i].t >= 0) || !(i == 0 || points[i].t > points[i - 1].t)) {
      return absl::InvalidArgumentError(
          absl::StrCat("point ", i, " of the hand's path, t = ", points[i].t,
                       " s: times must grow from 0 on and positions be finite"));
    }
  }
  GuidingHand hand;
  hand.points_ = std::move(points);
  return hand;
}

absl::StatusOr<GuidingHand> GuidingHand::Load(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  std::vector<HandPoint> points;
  int number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    line = absl::StripAsciiWhitespace(line);
    ++number;
    if (number == 1) {
      if (line == kHeader) continue;
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": the first line is '", line, "', must be '", kHeader, "'"));
    }
    if (line.empty()) continue;
    const std::vector<absl::string_view> fields = absl::StrSplit(line, ',');
    HandPoint point;
    bool good = fields.size() == 1 + kAxes && absl::SimpleAtod(fields[0], &point.t);
    for (int i = 0; good && i < kAxes; ++i)
      good = absl::SimpleAtod(fields[static_cast<size_t>(i) + 1], &point.position[i]);
    if (!good) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": line ", number, " is '", line, "', must be eight numbers"));
    }
    points.push_back(point);
  }
  absl::StatusOr<GuidingHand> hand = Create(std::move(points));
  if (!hand.ok())
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", hand.status().message()));
  return hand;
}

HandPoint GuidingHand::At(double t, ArmVector* velocity) const {
  if (velocity != nullptr) velocity->fill(0);
  const auto next = std::find_if(points_.begin(), points_.end(),
                                 [&](const HandPoint& point) { return point.t > t; });
  if (next == points_.begin()) return points_.front();
  if (next == points_.end()) return points_.back();
  const auto after = static_cast<size_t>(next - points_.begin()), before = after - 1;
  const double h = next->t - points_[before].t, s = (t - points_[before].t) / h;
  HandPoint now{t, {}};
  for (int i = 0; i < kAxes; ++i) {
    const double x0 = points_[before].position[i], x1 = next->position[i];
    const double v0 = h * Slope(before, i), v1 = h * Slope(after, i);
    const double a = 2 * (x0 - x1) + v0 + v1, b = 3 * (x1 - x0) - 2 * v0 - v1;
    now.position[i] = x0 + s * (v0 + s * (b + s * a));
    if (velocity != nullptr) (*velocity)[i] = (v0 + s * (2 * b + 3 * s * a)) / h;
  }
  return now;
}

double GuidingHand::Slope(size_t point, int axis) const {
  if (point == 0 || point + 1 == points_.size()) return 0;
  const auto slope = [&](size_t i) {
    return (points_[i + 1].position[axis] - points_[i].position[axis]) /
           (points_[i + 1].t - points_[i].t);
  };
  const double left = slope(point - 1), right = slope(point);
  return left * right <= 0 ? 0 : 2 * left * right / (left + right);
}

GuidingHand::Push GuidingHand::PushAt(double t, const PlantReading& reading) const {
  Push push;
  if (points_.empty()) return push;
  ArmVector velocity;
  const HandPoint now = At(t, &velocity);
  for (int j = 0; j < kJoints; ++j) {
    push.torque[j] = std::clamp(kStiffness[j] * (now.position[j] - reading.q[j]) +
                                    kDamping[j] * (velocity[j] - reading.dq[j]),
                                -kMost[j], kMost[j]);
  }
  push.finger_force =
      std::clamp(kFingerStiffness * 0.5 * (now.position[kJoints] - reading.opening) +
                     kFingerDamping * 0.5 * (velocity[kJoints] - reading.opening_speed),
                 -kMostFinger, kMostFinger);
  return push;
}

absl::StatusOr<TeachPlan> ParseTeachPlan(const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, absl::MaxSplits('+', 1));
  TeachPlan plan;
  const bool good =
      absl::SimpleAtod(parts[0], &plan.from_s) && plan.from_s >= 0 && plan.from_s < 1e9 &&
      (parts.size() == 1 ||
       (absl::SimpleAtod(parts[1], &plan.for_s) && plan.for_s > 0 && plan.for_s < 1e9));
  if (good) return plan;
  return absl::InvalidArgumentError(absl::StrCat(
      "--teach '", text, "': expected FROM[+DURATION] in seconds of the arm's time, as 0 or 2+20"));
}

}  // namespace robostress::piper
