#include "sim_worker/record/shard.h"

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/safetensors.h"

namespace robostress {

void Shard::Add(int64_t episode, const Demonstration& demonstration) {
  ++episodes_;
  for (const DemonstrationFrame& frame : demonstration.frames) {
    RS_CHECK(frame.views.size() == 2 && frame.actions.rows() == kLabelSteps);
    for (const Image& view : frame.views) {
      if (height_ == 0) {
        height_ = view.height;
        width_ = view.width;
      }
      RS_CHECK(view.height == height_ && view.width == width_);
      images_.insert(images_.end(), view.data.begin(), view.data.end());
    }
    state_.insert(state_.end(), frame.proprioception.data(), frame.proprioception.data() + 8);
    aux_.insert(aux_.end(), frame.aux.data(), frame.aux.data() + 8);
    for (int row = 0; row < kLabelSteps; ++row) {
      for (int column = 0; column < 7; ++column) actions_.push_back(frame.actions(row, column));
    }
    episode_.push_back(episode);
    execution_sigma_.push_back(static_cast<float>(demonstration.execution_sigma));
  }
}

absl::Status Shard::Write(const std::string& path) const {
  const int64_t n = frames();
  SafetensorsWriter writer;
  writer.SetMetadata("suite", suite_);
  writer.SetMetadata("task", absl::StrCat(task_));
  writer.SetMetadata("instruction", instruction_);
  writer.SetMetadata("version", "1");
  writer.SetMetadata("settings", settings_);
  writer.Add("images", DType::kU8, {n, 2, height_, width_, 3}, images_.data(), images_.size());
  writer.AddFloats("state", {n, 8}, state_);
  writer.AddFloats("actions", {n, kLabelSteps, 7}, actions_);
  writer.AddFloats("aux", {n, 8}, aux_);
  writer.AddInts("episode", {n}, episode_);
  if (execution_noise_ > 0) {
    writer.SetMetadata("execution_noise", absl::StrCat(execution_noise_));
    writer.AddFloats("execution_sigma", {n}, execution_sigma_);
  }
  return writer.Write(path);
}

}  // namespace robostress
