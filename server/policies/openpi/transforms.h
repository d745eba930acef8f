#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"

namespace robostress::openpi {

// openpi's image slots, in the order of their tokens.
inline constexpr std::array<const char*, 3> kImageSlots = {"base_0_rgb", "left_wrist_0_rgb",
                                                           "right_wrist_0_rgb"};

// How a picture of another size becomes the network's square. Both keep the aspect ratio, centre
// and pad with black.
enum class ResizeFilter {
  kPillow,       // openpi's clients and servers: antialiased, on 8 bits (common/image_resize.h)
  kInterpolate,  // LeRobot, and openpi inside the network: torch's bilinear, not antialiased
};

// How one robot's observations and actions become the network's. States and actions stand in the
// first entries, the rest is zero.
struct RobotTransform {
  std::string name;
  std::string meaning;     // of state and actions, for people
  int64_t state_dim = 0;   // entries of proprioception; 0: as many as the statistics have
  int64_t action_dim = 0;  // entries of an environment action; 0: likewise
  int64_t delta_dims = 0;  // leading action entries that delta actions are relative in; 0: all but
                           // the last. The others (gripper) are absolute
  bool pi0_delta = false, pi05_delta = false;  // as openpi's checkpoints for it were trained
  bool pi05_state_in_prompt = true;            // likewise
  ControlSpace control_space = ControlSpace::kUnspecified;  // of an environment action
  std::array<std::string, 3> cameras;  // the environment's camera per slot; empty: absent, masked
};

// The list: a robot is one entry in transforms.cc.
const std::vector<RobotTransform>& RobotTransforms();
// NOT_FOUND names the known ones.
absl::StatusOr<RobotTransform> FindRobotTransform(const std::string& name);

// Delta actions: entry j < dims of each row minus (AbsoluteToDelta) or plus (DeltaToAbsolute) entry
// j of the state at the chunk's start. actions [n, >= dims], state [>= dims], same units.
void AbsoluteToDelta(const Eigen::VectorXd& state, int64_t dims, Eigen::MatrixXd& actions);
void DeltaToAbsolute(const Eigen::VectorXd& state, int64_t dims, Eigen::MatrixXd& actions);

}  // namespace robostress::openpi
