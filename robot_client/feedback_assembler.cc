#include "robot_client/feedback_assembler.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace robostress {
namespace {

Eigen::VectorXd Joints(const ArmVector& v, const ArmAxes& axes) {
  return Eigen::Map<const Eigen::VectorXd>(v.data(), axes.joints);
}

double LargestDifference(const ArmVector& a, const ArmVector& b, int joints) {
  double largest = 0;
  for (int j = 0; j < joints; ++j) largest = std::max(largest, std::abs(a[j] - b[j]));
  return largest;
}

}  // namespace

FeedbackAssembler::FeedbackAssembler(const FeedbackOptions& options, double period_s,
                                     ForwardKinematics forward, const ArmAxes& axes)
    : options_(options), period_s_(period_s), forward_(std::move(forward)), axes_(axes) {}

Eigen::VectorXf FeedbackAssembler::Command(const ArmVector& v) const {
  Eigen::VectorXf command(axes_.count());
  for (int i = 0; i < axes_.count(); ++i) command[i] = static_cast<float>(v[i]);
  return command;
}

RobotState FeedbackAssembler::StateOf(const TickRecord& record) const {
  RobotState state;
  state.stamp_s = static_cast<double>(record.stamp_ns - episode_start_ns_) * 1e-9;
  state.q = Joints(record.position, axes_);
  state.dq = Joints(record.velocity, axes_);
  if (forward_) state.tool = forward_(record.position);
  state.gripper = record.position[axes_.opening()];
  return state;
}

void FeedbackAssembler::Complete(const TickRecord& next) {
  Step step{*open_, false, StateOf(next)};
  const TickRecord& r = step.record;
  const double interval = static_cast<double>(next.start_ns - r.start_ns) * 1e-9;
  step.masked = LargestDifference(r.blended, r.requested, axes_.joints) > options_.moved_bound ||
                LargestDifference(r.sent, r.corrected, axes_.joints) > options_.moved_bound ||
                !(r.flags & kTickSent) || !(next.flags & kTickFresh) || (next.flags & kTickLost) ||
                std::abs(interval - period_s_) > 0.5 * period_s_;
  ++counters_.steps;
  if (step.masked) ++counters_.steps_masked;
  steps_.push_back(std::move(step));
  open_.reset();
}

std::optional<ExecutedChunk> FeedbackAssembler::Close(bool last_of_episode) {
  if (steps_.empty()) return std::nullopt;
  const auto masked = static_cast<size_t>(
      std::count_if(steps_.begin(), steps_.end(), [](const Step& step) { return step.masked; }));
  std::optional<ExecutedChunk> chunk;
  if (masked == steps_.size()) {
    ++counters_.chunks_empty;
  } else {
    ++counters_.chunks;
    chunk.emplace();
    const TickRecord& head = steps_.front().record;
    chunk->episode = head.episode;
    chunk->chunk = head.chunk;
    chunk->prediction_id = head.prediction_id;
    chunk->first_step = head.row;
    for (const Step& played : steps_) {
      const TickRecord& r = played.record;
      ExecutedStep& step = chunk->steps.emplace_back();
      step.before = StateOf(r);
      step.policy_command = Command(r.policy);
      step.sent_command = Command(r.sent);
      if (masked > 0) chunk->masked.push_back(played.masked);
    }
    chunk->final_state = steps_.back().after;
    chunk->last_of_episode = last_of_episode;
  }
  steps_.clear();
  return chunk;
}

std::optional<ExecutedChunk> FeedbackAssembler::Add(const TickRecord& record) {
  if (open_) Complete(record);
  const bool played = (record.flags & kTickPlayed) != 0;
  std::optional<ExecutedChunk> closed;
  const bool continues =
      played && !steps_.empty() && steps_.back().record.episode == record.episode &&
      steps_.back().record.chunk == record.chunk && steps_.back().record.row + 1 == record.row;
  if (!continues) closed = Close(record.state == ClientState::kEnabled);
  if (record.episode != episode_) {
    episode_ = record.episode;
    episode_start_ns_ = record.stamp_ns;
  }
  if (played) open_ = record;
  return closed;
}

}  // namespace robostress
