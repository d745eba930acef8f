#include "robot_client/control/press_watch.h"

#include <algorithm>
#include <cmath>

namespace robostress {
namespace {

constexpr double kMostOfIt = 0.6;  // of a window
// A joint's acceleration is the change of its reported velocity over no less than this.
constexpr double kShortest_s = 0.02;
constexpr double kLongest_s = 0.2;

}  // namespace

void FitDefaults(int joints, PressOptions& options) {
  const PressOptions defaults;
  for (const auto values :
       {&PressOptions::excess, &PressOptions::friction, &PressOptions::viscous}) {
    std::vector<double>& given = options.*values;
    if (given == defaults.*values) given.resize(static_cast<size_t>(joints), given.back());
  }
}

PressWatch::PressWatch(const PressOptions& options, double period_s, const ArmModel* model,
                       int joints)
    : options_(options),
      period_s_(period_s),
      model_(model),
      joints_(joints),
      window_(static_cast<size_t>(
          std::clamp(std::lround(options.blocked_s / period_s), 2L, long{kMostTicks}))) {}

void PressWatch::Reset() {
  excess_.fill(0);
  strained_s_ = 0;
  pressing_ = blocked_ = false;
  last_stamp_ns_ = 0;
  seen_ = next_ = 0;
}

void PressWatch::Take(const ArmSnapshot& arm, const ArmVector& command) {
  WatchTorque(arm);
  WatchTravel(arm, command);
}

void PressWatch::WatchTorque(const ArmSnapshot& arm) {
  if (model_ == nullptr || !arm.has_effort) return;
  const double dt = static_cast<double>(arm.stamp_ns - last_stamp_ns_) * 1e-9;
  ArmVector acceleration{};
  if (last_stamp_ns_ != 0 && dt >= kShortest_s && dt <= kLongest_s) {
    for (int j = 0; j < joints_; ++j) acceleration[j] = (arm.velocity[j] - last_velocity_[j]) / dt;
  }
  if (last_stamp_ns_ == 0 || dt >= kShortest_s) {
    last_velocity_ = arm.velocity;
    last_stamp_ns_ = arm.stamp_ns;
  }
  const ArmVector empty = model_->Torque(arm.position, arm.velocity, acceleration, 0);
  const ArmVector loaded =
      model_->Torque(arm.position, arm.velocity, acceleration, options_.payload_kg);
  for (int j = 0; j < joints_; ++j) {
    const double friction = options_.friction[j] + options_.viscous[j] * std::abs(arm.velocity[j]);
    const double least = std::min(empty[j], loaded[j]) - friction;
    const double most = std::max(empty[j], loaded[j]) + friction;
    excess_[j] = arm.effort[j] - std::clamp(arm.effort[j], least, most);
  }
  double most = 0;
  for (int j = 0; j < joints_; ++j) most = std::max(most, std::abs(share(j)));
  strained_s_ = most > 1 ? strained_s_ + period_s_ : 0;
  pressing_ = strained_s_ >= options_.excess_s || most > 2;
}

// Where a policy predicts from what it sees, each chunk begins at the joint that does not move, and
// the error never grows: so it is counted how often the joint was off, and how far it came.
void PressWatch::WatchTravel(const ArmSnapshot& arm, const ArmVector& command) {
  Tick& tick = window_[next_];
  for (int j = 0; j < joints_; ++j) {
    tick.off[j] = std::abs(command[j] - arm.position[j]) > options_.blocked_error;
    tick.position[j] = arm.position[j];
  }
  const int size = static_cast<int>(window_.size());
  next_ = (next_ + 1) % size;
  seen_ = std::min(seen_ + 1, size);
  blocked_ = false;
  if (seen_ < size) return;
  for (int j = 0; j < joints_; ++j) {
    int off = 0;
    double lowest = window_[0].position[j], highest = lowest;
    for (const Tick& each : window_) {
      off += each.off[j] ? 1 : 0;
      lowest = std::min(lowest, each.position[j]);
      highest = std::max(highest, each.position[j]);
    }
    blocked_ = blocked_ || (off >= kMostOfIt * size && highest - lowest < options_.blocked_travel);
  }
}

}  // namespace robostress
