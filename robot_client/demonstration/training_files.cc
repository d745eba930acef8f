#include "robot_client/demonstration/training_files.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/types/span.h"
#include "common/image.h"
#include "common/libero/demonstrations.h"
#include "common/safetensors.h"
#include "common/so3.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int kLiberoNumbers = 7;  // of an action

// Of the arm's own axes.
absl::Span<const double> Of(const ArmAxes& axes, const ArmVector& values) {
  return absl::MakeConstSpan(values).first(static_cast<size_t>(axes.count()));
}

template <class Range>
void Append(const Range& values, std::vector<double>* to) {
  to->insert(to->end(), values.begin(), values.end());
}

}  // namespace

absl::Status WriteLiberoEpisode(const DemonstrationEpisode& episode, const ToolPoseOf& tool,
                                const std::string& path) {
  if (episode.cameras.size() != 2) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": LIBERO's form has two cameras, not ",
                                                   episode.cameras.size(), "; leave libero out"));
  }
  if (episode.axes.count() != kLiberoNumbers) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": LIBERO's form has ", kLiberoNumbers,
                                                   " numbers in an action, this arm ",
                                                   episode.axes.text(), "; leave libero out"));
  }
  RS_ASSIGN_OR_RETURN(LiberoDemonstrationWriter writer,
                      LiberoDemonstrationWriter::Create(
                          path, {"piper_joint_targets", "demonstration", episode.instruction,
                                 static_cast<int>(episode.rate_hz), /*absolute_actions=*/true}));
  LiberoDemonstration demonstration;
  demonstration.agentview = episode.small[0];
  demonstration.eye_in_hand = episode.small[1];
  LiberoColumns& columns = demonstration.columns;
  columns.steps = static_cast<int64_t>(episode.ticks.size());
  for (size_t i = 0; i < episode.ticks.size(); ++i) {
    const DemonstrationTick& tick = episode.ticks[i];
    const Pose pose = tool(tick.state);
    const Eigen::AngleAxisd turn(pose.q_base_tool);
    const Eigen::Vector3d orientation = turn.angle() * turn.axis();
    const Eigen::Vector4d quaternion = pose.q_base_tool.coeffs();  // x y z w
    const double finger = tick.state[episode.axes.opening()] / 2;
    Append(Of(episode.axes, tick.action), &columns.actions);
    columns.states.push_back(static_cast<double>(i) / episode.rate_hz);
    Append(Of(episode.axes, tick.state), &columns.states);
    Append(std::array{finger, -finger}, &columns.robot_states);
    Append(pose.p_base_tool, &columns.robot_states);
    Append(quaternion, &columns.robot_states);
    Append(pose.p_base_tool, &columns.ee_pos);
    Append(orientation, &columns.ee_ori);
    Append(std::array{finger, -finger}, &columns.gripper_states);
    Append(Of(episode.axes, tick.state), &columns.joint_states);
    Append(Of(episode.axes, tick.state), &columns.proprioception);
    columns.proprioception.push_back(0);
  }
  RS_RETURN_IF_ERROR(writer.Add(demonstration));
  return writer.Publish();
}

absl::Status WriteShard(const DemonstrationEpisode& episode, int64_t index, int side, int stride,
                        int horizon, const std::string& path) {
  std::vector<uint8_t> images;
  std::vector<float> state, actions;
  std::vector<int64_t> number;
  for (size_t t = 0; t < episode.ticks.size(); t += static_cast<size_t>(stride)) {
    for (const std::vector<Image>& views : episode.small) {
      const Image view = ResizeArea(views[t], side, side);
      images.insert(images.end(), view.data.begin(), view.data.end());
    }
    for (const double value : Of(episode.axes, episode.ticks[t].state))
      state.push_back(static_cast<float>(value));
    for (size_t k = 0; k < static_cast<size_t>(horizon); ++k) {
      const DemonstrationTick& tick = episode.ticks[std::min(t + k, episode.ticks.size() - 1)];
      for (const double value : Of(episode.axes, tick.action))
        actions.push_back(static_cast<float>(value));
    }
    number.push_back(index);
  }
  const auto n = static_cast<int64_t>(number.size());
  const int64_t axes = episode.axes.count();
  const auto views = static_cast<int64_t>(episode.cameras.size());
  SafetensorsWriter writer;
  writer.SetMetadata("suite", "piper");
  writer.SetMetadata("task", "demonstration");
  writer.SetMetadata("instruction", episode.instruction);
  writer.SetMetadata("version", "1");
  writer.Add("images", DType::kU8, {n, views, side, side, 3}, images.data(), images.size());
  writer.AddFloats("state", {n, axes}, state);
  writer.AddFloats("actions", {n, horizon, axes}, actions);
  writer.AddInts("episode", {n}, number);
  return writer.Write(path);
}

}  // namespace robostress
