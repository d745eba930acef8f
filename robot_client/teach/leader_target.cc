#include "robot_client/teach/leader_target.h"

#include <algorithm>
#include <cmath>

#include "robot_client/piper/protocol.h"

namespace robostress {

void LeaderTarget::Begin(const ArmVector& command) {
  at_ = command;
  speed_ = 0;
  joined_ = false;
}

bool LeaderTarget::Silent(int64_t now_ns) const {
  const LeaderSample sample = leader_->Load();
  return sample.sequence == 0 ||
         static_cast<double>(now_ns - sample.stamp_ns) * 1e-9 > options_.silent_s;
}

LiveRow LeaderTarget::Next(int64_t, const ArmVector& command) {
  LiveRow row;
  row.wanted = leader_->Load().position;
  ArmVector goal{};
  for (int i = 0; i < piper::kAxes; ++i)
    goal[i] = std::clamp(row.wanted[i], limits_.lower[i], limits_.upper[i]);
  const auto farthest = [&](const ArmVector& from) {
    double gap = 0;
    for (int j = 0; j < piper::kJoints; ++j) gap = std::max(gap, std::abs(goal[j] - from[j]));
    return gap;
  };
  if (joined_ && farthest(command) > options_.lost) Begin(command);
  if (!joined_) {
    const double opening = options_.gripper_velocity * options_.period_s;
    const double gap = farthest(at_);
    speed_ = std::min({speed_ + options_.acceleration * options_.period_s, options_.joint_velocity,
                       std::sqrt(2 * options_.acceleration * gap)});
    const double share = std::min(1.0, speed_ * options_.period_s / std::max(gap, 1e-9));
    const double gripper_gap = std::abs(goal[piper::kJoints] - at_[piper::kJoints]);
    joined_ = gap <= options_.joined && gripper_gap <= opening;
    for (int j = 0; j < piper::kJoints; ++j) at_[j] += share * (goal[j] - at_[j]);
    at_[piper::kJoints] +=
        std::clamp(goal[piper::kJoints] - at_[piper::kJoints], -opening, opening);
  }
  if (joined_) at_ = goal;
  row.target = at_;
  row.joining = !joined_;
  return row;
}

}  // namespace robostress
