#pragma once

#include <array>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "robot_client/arm_model.h"
#include "robot_client/bridge/arm_chain.h"

namespace robostress::bridge {

// Chooses what of the arm is watched against itself: pairs of parts of links that no joint
// connects, but those that are nearer than `margin` [m] at `home` (a number per joint [rad]; empty:
// none) or in more than half of all poses within the limits, and those whose distance never
// changes. They are neighbours, or their shapes are too coarse; MoveIt's setup assistant leaves out
// the like. 1,000 poses of a fixed stream. `ignored` are left out. None are chosen where the links
// are more than 256 parts. Says too how often what is chosen touches in those poses.
void ChooseLinkPairs(const ArmLimits& limits, const std::vector<double>& home, double margin,
                     const std::vector<LinkPair>& ignored, ArmChain* chain);

// Leaves out of a link's shape against the table what keeps it below in nearly all of those poses:
// a shoulder that turns where it is, below the table's top, would be its lowest part for ever, and
// hide how near the tool is. The same against the box, by its floor. The first link is not watched
// at all. INVALID_ARGUMENT where the last link would be left out: the height is wrong.
absl::Status LeaveLowPartsOut(const ArmLimits& limits, const WorkspaceOptions& workspace,
                              ArmChain* chain);

// A ball that holds a part, in its link's frame.
struct Reach {
  Eigen::Vector3d centre;
  double radius;  // [m]
};

// What a chain says of its arm: torques by a recursive Newton-Euler scheme in the base frame
// (Craig, Introduction to Robotics, sec. 6.5), without rotors and friction; distances of the links'
// shapes to table and box, and of its chosen pairs from each other. Fingers stand as at 0.
class ChainModel : public ArmModel {
 public:
  ChainModel(ArmChain chain, const WorkspaceOptions& workspace);

  ArmVector Torque(const ArmVector& position, const ArmVector& velocity,
                   const ArmVector& acceleration, double payload_kg) const override;
  // Table and box: every part beyond the first link. Itself: infinite where no pairs are chosen.
  Clearance ClearanceAt(const ArmVector& position) const override;
  std::string NearestParts(const ArmVector& position) const override;
  // Of the tool, in the base frame [m].
  Eigen::Vector3d ToolAt(const ArmVector& position) const;

 private:
  // Of its watched pairs [m]; which one, unless null.
  double Nearest(const std::array<Eigen::Isometry3d, kMostJoints>& poses,
                 std::pair<int, int>* pair) const;

  const ArmChain chain_;
  std::vector<Reach> reaches_;  // of the chain's body
  const double table_z_, margin_;
  const Eigen::Vector3d lower_, upper_;
};

}  // namespace robostress::bridge
