#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "sim_worker/record/expert_demonstration.h"

namespace robostress {

// A batch of episodes of one task as a safetensors file, the training input:
//   images  U8  [F, 2, H, W, 3]  agentview, robot0_eye_in_hand; top row first
//   state   F32 [F, 8]           proprioception
//   actions F32 [F, 50, 7]       the expert's next commands
//   aux     F32 [F, 8]           target 3, destination 3 (base frame [m]), holding, progress
//   episode I64 [F]              index of the draw; all frames of an episode are consecutive
// metadata: suite, task, instruction, version, settings (JSON: of the recorder). With domain
// randomisation also
//   execution_sigma F32 [F]      of the frame's episode [command units]
// and metadata execution_noise, the largest sigma that could be drawn.
class Shard {
 public:
  Shard(std::string suite, int task, std::string instruction, std::string settings,
        double execution_noise)
      : suite_(std::move(suite)),
        task_(task),
        instruction_(std::move(instruction)),
        settings_(std::move(settings)),
        execution_noise_(execution_noise) {}

  void Add(int64_t episode, const Demonstration& demonstration);
  int frames() const { return static_cast<int>(episode_.size()); }
  int episodes() const { return episodes_; }
  absl::Status Write(const std::string& path) const;

 private:
  std::string suite_;
  int task_;
  std::string instruction_, settings_;
  double execution_noise_;
  int episodes_ = 0;
  int height_ = 0, width_ = 0;
  std::vector<uint8_t> images_;
  std::vector<float> state_, actions_, aux_, execution_sigma_;
  std::vector<int64_t> episode_;
};

}  // namespace robostress
