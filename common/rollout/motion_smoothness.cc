#include "common/rollout/motion_smoothness.h"

#include <cmath>

namespace robostress {
namespace {

struct Mean {
  double sum = 0;
  int count = 0;
  void Add(double value) {
    sum += value;
    ++count;
  }
  double value() const { return count == 0 ? 0 : sum / count; }
};

// Third differences of a stretch of positions.
class ThirdDifferences {
 public:
  void Begin() { known_ = 0; }
  void Add(const Eigen::Vector3d& p, Mean& mean) {
    if (known_ >= 3) mean.Add((p - 3 * last_[2] + 3 * last_[1] - last_[0]).norm());
    last_[0] = last_[1];
    last_[1] = last_[2];
    last_[2] = p;
    ++known_;
  }

 private:
  Eigen::Vector3d last_[3] = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(),
                              Eigen::Vector3d::Zero()};
  int known_ = 0;
};

}  // namespace

MotionSmoothness SmoothnessOf(const std::vector<ExecutedChunk>& chunks, double control_period_s) {
  ThirdDifferences differences;
  Mean third, jump;
  const ExecutedChunk* last = nullptr;
  for (const ExecutedChunk& chunk : chunks) {
    const ExecutedStep& first = chunk.steps.front();
    const bool follows = last != nullptr &&
                         first.before.stamp_s - last->final_state.stamp_s <= 0.5 * control_period_s;
    if (!follows) differences.Begin();
    if (follows) {
      const Eigen::VectorXf change = first.sent_command - last->steps.back().sent_command;
      jump.Add(change.head(change.size() - 1).norm());
    } else {
      differences.Add(first.before.tool.p_base_tool, third);
    }
    for (size_t i = 0; i < chunk.steps.size(); ++i) {
      const RobotState& after =
          i + 1 < chunk.steps.size() ? chunk.steps[i + 1].before : chunk.final_state;
      differences.Add(after.tool.p_base_tool, third);
    }
    last = &chunk;
  }
  return {third.value() / std::pow(control_period_s, 3), jump.value()};
}

}  // namespace robostress
