#include <algorithm>
#include <cmath>
#include <deque>

#include "common/joint_errors/effects/effect_makers.h"

namespace robostress::effects {
namespace {

// command(t - delay), linear between the samples that a sub-step's command stands for. Before the
// first one: the first one.
class TransportDelayEffect : public CopyableEffect<TransportDelayEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { delay_ = std::max(0.0, p[0]); }
  void Reset(const JointMoment&) override { history_.clear(); }
  double Command(double command, const JointMoment& m) override {
    history_.push_front(command);
    const double steps = std::min(delay_ / m.h, kMostSteps);
    const size_t whole = static_cast<size_t>(steps);
    while (history_.size() > whole + 2) history_.pop_back();
    const double newer = history_[std::min(whole, history_.size() - 1)];
    const double older = history_[std::min(whole + 1, history_.size() - 1)];
    return newer + (steps - static_cast<double>(whole)) * (older - newer);
  }

 private:
  static constexpr double kMostSteps = 1e7;  // what a count of samples holds, for steps near 0
  double delay_ = 0;                         // [s]
  std::deque<double> history_;               // newest first
};

// First order, exact for a command that is constant over a sub-step.
class ServoLagEffect : public CopyableEffect<ServoLagEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { tau_ = std::max(0.0, p[0]); }
  void Reset(const JointMoment&) override { started_ = false; }
  double Command(double command, const JointMoment& m) override {
    if (!started_ || tau_ == 0) {
      started_ = true;
      value_ = command;
    } else {
      value_ += (1 - std::exp(-m.h / tau_)) * (command - value_);
    }
    return value_;
  }
  bool CommandSlides() const override { return true; }

 private:
  double tau_ = 0;  // [s]
  double value_ = 0;
  bool started_ = false;
};

class RateLimitEffect : public CopyableEffect<RateLimitEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { rate_ = p[0]; }
  void Reset(const JointMoment&) override { started_ = false; }
  double Command(double command, const JointMoment& m) override {
    if (!started_) {
      started_ = true;
      value_ = command;
    }
    value_ += std::clamp(command - value_, -rate_ * m.h, rate_ * m.h);
    return value_;
  }
  bool CommandSlides() const override { return true; }
  bool CommandLimits() const override { return true; }

 private:
  double rate_ = 0;  // of the command per second: [rad/s], of a joint that logs torques [Nm/s]
  double value_ = 0;
  bool started_ = false;
};

}  // namespace

std::unique_ptr<JointEffect> TransportDelay() { return std::make_unique<TransportDelayEffect>(); }
std::unique_ptr<JointEffect> ServoLag() { return std::make_unique<ServoLagEffect>(); }
std::unique_ptr<JointEffect> RateLimit() { return std::make_unique<RateLimitEffect>(); }

}  // namespace robostress::effects
