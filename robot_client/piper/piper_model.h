#pragma once

#include "robot_client/arm_model.h"
#include "robot_client/piper/kinematics.h"

namespace robostress::piper {

// A Piper with its gripper, standing upright. Masses are those of link_inertia.h; a recursive
// Newton-Euler scheme in the base frame (Craig, Introduction to Robotics, sec. 6.5). The arm's
// shape for distances is a capsule per link: one that covers the part up to 8 mm at its edges.
class PiperModel : public ArmModel {
 public:
  PiperModel(Zero zero, const WorkspaceOptions& workspace);

  ArmVector Torque(const ArmVector& position, const ArmVector& velocity,
                   const ArmVector& acceleration, double payload_kg) const override;
  // Table and box: every part beyond the first link. Itself: parts with two links between them.
  Clearance ClearanceAt(const ArmVector& position) const override;

 private:
  const Zero zero_;
  const double table_z_, margin_;
  const Eigen::Vector3d lower_, upper_;
};

}  // namespace robostress::piper
