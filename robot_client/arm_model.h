#pragma once

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// Where an arm may be, in its base frame: x forwards, z up from the plane it is mounted on.
struct WorkspaceOptions {
  double table_z = 0;                                // [m] no part of the arm goes below
  std::vector<double> lower = {-0.75, -0.75, -0.1};  // [m] nor out of this box
  std::vector<double> upper = {0.75, 0.75, 1.1};     // [m]
  double margin = 0;                                 // [m] kept from table, box and itself
  bool guard = true;                                 // false: none of this is watched

  bool operator==(const WorkspaceOptions&) const = default;

  template <class V>
  void Visit(V& v) {
    v.Field("table_z", table_z, "height of the table in the base frame [m]; nothing goes below");
    v.Field("lower", lower, "corner of the box that the whole arm stays in, base frame [m]");
    v.Field("upper", upper, "the opposite corner [m]");
    v.Field("margin", margin, "distance kept from table, box and the arm itself [m]");
    v.Field("guard", guard, "false: the arm may press into the table and into itself");
  }
};

// INVALID_ARGUMENT names `section`, key, value and range.
absl::Status CheckWorkspace(const WorkspaceOptions& options, const std::string& section);

// What is known of an arm's mechanics, as the control thread asks it. Allocates nothing.
class ArmModel {
 public:
  virtual ~ArmModel() = default;

  // Torques of the joints' motors [Nm] for a motion without contact and friction; gripper 0.
  virtual ArmVector Torque(const ArmVector& position, const ArmVector& velocity,
                           const ArmVector& acceleration, double payload_kg) const = 0;

  // Distances [m] that the nearest part of the arm keeps; negative: inside. Each face of the box is
  // a bound, so that an elbow that rests out of one does not open the others: kBox and on, lower
  // x, y, z, then upper.
  enum Bound { kTable, kBox, kItself = kBox + 6, kBounds };
  using Clearance = std::array<double, kBounds>;
  virtual Clearance ClearanceAt(const ArmVector& position) const = 0;
  // For people, which parts are nearest to each other there: "J5 and J7"; empty: not said. Not for
  // the control thread.
  virtual std::string NearestParts(const ArmVector& /*position*/) const { return ""; }
};

// "the table", "the workspace box", "the arm itself".
const char* BoundName(ArmModel::Bound bound);

// The first bound that a way from `now` to `next` must not cross: one that is met and gets worse.
// kBounds: none.
ArmModel::Bound CrossedBound(const ArmModel::Clearance& now, const ArmModel::Clearance& next);

// The first bound that is not kept there; kBounds: all are.
ArmModel::Bound BrokenBound(const ArmModel::Clearance& clearance);

}  // namespace robostress
