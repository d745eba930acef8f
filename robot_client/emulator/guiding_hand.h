#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/emulator/piper_plant.h"
#include "robot_client/robot_arm.h"

namespace robostress::piper {

// Where a person who guides the arm wants it at a time.
struct HandPoint {
  double t = 0;          // of the arm's time [s]
  ArmVector position{};  // joints [rad], opening [m]
};

// A person's hand that moves a limp arm, an arm that is taught or a leader, along a path: smoothly
// through the points, held before the first and after the last. Between two points a cubic whose
// slopes are the harmonic means of the neighbours' and 0 where a joint turns (Fritsch and Butland,
// SIAM J. Sci. Stat. Comput. 5, 1984): nowhere beyond the points. Its force is a spring's, so it
// yields to what is in the way.
class GuidingHand {
 public:
  // INVALID_ARGUMENT for times that do not grow, and numbers that are none.
  static absl::StatusOr<GuidingHand> Create(std::vector<HandPoint> points);
  // From a CSV file with the header t,J1,J2,J3,J4,J5,J6,opening. The error names file, line and
  // value.
  static absl::StatusOr<GuidingHand> Load(const std::string& path);
  GuidingHand() = default;  // touches nothing

  bool empty() const { return points_.empty(); }
  // The point and its speed at time t [s].
  HandPoint At(double t, ArmVector* velocity = nullptr) const;
  // What the hand does to the joints [Nm] and to each finger [N].
  struct Push {
    JointVector torque{};
    double finger_force = 0;
  };
  Push PushAt(double t, const PlantReading& reading) const;

 private:
  double Slope(size_t point, int axis) const;

  std::vector<HandPoint> points_;
};

// When a person presses the arm's teaching button, and presses it again.
struct TeachPlan {
  double from_s = -1;  // of the arm's time; negative: never
  double for_s = 0;    // 0: to the end
};
// "2" or "2+20". INVALID_ARGUMENT otherwise.
absl::StatusOr<TeachPlan> ParseTeachPlan(const std::string& text);

}  // namespace robostress::piper
