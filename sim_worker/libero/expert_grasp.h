#pragma once

#include <Eigen/Core>
#include <optional>

#include "sim_worker/libero/expert_view.h"

namespace robostress::libero {

// Where the tool is when its fingers close around something from above.
struct Grasp {
  Eigen::Vector3d p;  // of the grip site [m]
  double yaw;         // of the hand (DownTurned) [rad]
  double width = 0;   // between the fingers [m]; 0: of a wall
};

// The way to hold an object where it is now, to bring its origin to `place`: bowls and mugs by the
// rim, others around the height at which they are narrow enough; turned as little as possible,
// clear of what stands beside, within the arm's reach there and here.
Grasp FindGrasp(const ExpertView& view, const LiberoObject& object, const Eigen::Vector3d& place);
// By its handle, if it has one that is known.
std::optional<Grasp> HandleGrasp(const ExpertView& view, const LiberoObject& object);

}  // namespace robostress::libero
