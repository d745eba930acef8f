#include "server/policies/openpi/transforms.h"

#include "absl/strings/str_cat.h"
#include "common/check.h"

namespace robostress::openpi {

const std::vector<RobotTransform>& RobotTransforms() {
  static const auto& transforms = *new std::vector<RobotTransform>{
      {.name = "plain",
       .meaning = "state and actions as the statistics count them; views named as openpi's slots",
       .cameras = {kImageSlots[0], kImageSlots[1], kImageSlots[2]}},
      // Views arrive as LIBERO's policies know them: the simulator rotates by 180 degrees
      // (sim_worker/libero/preprocess.h), nothing is rotated here. pi0_libero was trained with one
      // delta transform too many (its data holds deltas already), so the state is added to its
      // output; pi05_libero was not, and has no state in its prompt.
      {.name = "libero",
       .meaning = "state: gripper site [m], axis-angle [rad], two finger positions [m]; actions: "
                  "OSC translation, rotation, gripper -1 open, 1 close",
       .state_dim = 8,
       .action_dim = 7,
       .delta_dims = 6,
       .pi0_delta = true,
       .pi05_state_in_prompt = false,
       .control_space = ControlSpace::kEndEffector,
       .cameras = {"agentview", "robot0_eye_in_hand", ""}},
      {.name = "piper",
       .meaning = "state: six joint angles [rad], gripper 0..1; actions: the same, absolute",
       .state_dim = 7,
       .action_dim = 7,
       .delta_dims = 6,
       .pi0_delta = true,
       .pi05_delta = true,
       .control_space = ControlSpace::kJoint,
       .cameras = {"base", "wrist", ""}},
  };
  return transforms;
}

absl::StatusOr<RobotTransform> FindRobotTransform(const std::string& name) {
  std::string known;
  for (const RobotTransform& transform : RobotTransforms()) {
    if (transform.name == name) return transform;
    absl::StrAppend(&known, known.empty() ? "" : ", ", transform.name);
  }
  return absl::NotFoundError(
      absl::StrCat("transform '", name, "' is unknown; known: auto, ", known));
}

void AbsoluteToDelta(const Eigen::VectorXd& state, int64_t dims, Eigen::MatrixXd& actions) {
  RS_CHECK(state.size() >= dims && actions.cols() >= dims);
  actions.leftCols(dims).rowwise() -= state.head(dims).transpose();
}

void DeltaToAbsolute(const Eigen::VectorXd& state, int64_t dims, Eigen::MatrixXd& actions) {
  RS_CHECK(state.size() >= dims && actions.cols() >= dims);
  actions.leftCols(dims).rowwise() += state.head(dims).transpose();
}

}  // namespace robostress::openpi
