#pragma once

#include "robot_client/arm_model.h"
#include "robot_client/bridge/arm_chain.h"

namespace robostress::bridge {

// What a chain says of its arm: torques by a recursive Newton-Euler scheme in the base frame
// (Craig, Introduction to Robotics, sec. 6.5), without rotors and friction; distances of the links'
// shapes to table and box. The arm against itself is not known: that distance is infinite.
class ChainModel : public ArmModel {
 public:
  ChainModel(ArmChain chain, const WorkspaceOptions& workspace);

  ArmVector Torque(const ArmVector& position, const ArmVector& velocity,
                   const ArmVector& acceleration, double payload_kg) const override;
  // Every part beyond the first link.
  Clearance ClearanceAt(const ArmVector& position) const override;
  // Of the tool, in the base frame [m].
  Eigen::Vector3d ToolAt(const ArmVector& position) const;

 private:
  using Poses = std::array<Eigen::Isometry3d, kMostJoints>;
  void Place(const ArmVector& position, Poses& poses) const;  // of the links, in the base frame

  const ArmChain chain_;
  const double table_z_, margin_;
  const Eigen::Vector3d lower_, upper_;
};

}  // namespace robostress::bridge
