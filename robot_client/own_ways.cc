#include "robot_client/own_ways.h"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"
#include "robot_client/operator_console.h"

namespace robostress {
namespace {

constexpr double kMakes_s = 60;
constexpr double kStands = 0.04;  // [rad/s] below what the next order asks for
constexpr double kRests = 0.04;   // [rad] that a joint on its rest may be led inside its limits

}  // namespace

ArmVector HomeOf(const ClientConfig& config) {
  ArmVector home{};
  std::copy_n(config.home.begin(), std::min(config.home.size(), home.size()), home.begin());
  return home;
}

absl::Status OwnWays::Take(Motion motion) {
  RS_RETURN_IF_ERROR(CheckMotion(motion, arm_.limits()));
  motion_ = std::move(motion);
  return absl::OkStatus();
}

absl::Status OwnWays::MayMove() const {
  if (loop_->state() == ClientState::kEnabled) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("the client is ", StateName(loop_->state()), "; the arm is moved from ENABLED"));
}

ArmVector OwnWays::Stands() const {
  ArmVector position = loop_->seen().position;
  position[arm_.axes().opening()] = loop_->opening();
  return position;
}

PathLimits OwnWays::Limits(double velocity) const {
  const LimiterOptions& most = config_.control.limits;
  PathLimits limits;
  limits.joint_velocity = std::min(velocity, most.joint_velocity);
  limits.joint_acceleration = std::min(limits.joint_acceleration, 0.8 * most.joint_acceleration);
  limits.joint_jerk = std::min(limits.joint_jerk, 0.8 * most.joint_jerk);
  return limits;
}

PendingAnswer OwnWays::Begin(const std::string& what, ArmPath path, Arrived arrived) {
  const double seconds = static_cast<double>(path.rows.size()) / config_.control.rate_hz;
  const ArmVector to = path.rows.back();
  paths_.push_back(std::make_unique<const ArmPath>(std::move(path)));
  const uint64_t before = loop_->decided();
  PendingAnswer pending;
  pending.what = what;
  pending.until_ns = clock_->now_ns() + static_cast<int64_t>((seconds + 5) * 1e9);
  pending.late = absl::DeadlineExceededError(what + " has not arrived; type hold");
  pending.answer = [this, before, what, arrived = std::move(arrived),
                    to]() -> std::optional<absl::StatusOr<std::string>> {
    if (loop_->decided() == before || loop_->state() == ClientState::kMove) return std::nullopt;
    if (loop_->refusal() == Refusal::kNone && loop_->cause() == StateCause::kOperator &&
        loop_->state() == ClientState::kEnabled)
      return what + " was stopped";
    if (loop_->cause() != StateCause::kArrived) return Refused(*loop_, what + " did not arrive");
    const ArmSnapshot arm = loop_->seen();
    double off = 0, fastest = 0;
    for (int j = 0; j < arm_.axes().joints; ++j) {
      off = std::max(off, std::abs(arm.position[j] - to[j]));
      fastest = std::max(fastest, std::abs(arm.velocity[j]));
    }
    if (fastest > kStands) return std::nullopt;
    return arrived(1000 * off);
  };
  loop_->Play(paths_.back().get());
  say_(absl::StrFormat("%s: %.1f s; Enter stops", what, seconds));
  return pending;
}

absl::StatusOr<PendingAnswer> OwnWays::Move(const std::string& what, const std::string& there,
                                            const ArmVector& to, double velocity) {
  RS_RETURN_IF_ERROR(MayMove());
  ArmPath path =
      StraightPath(arm_.axes(), Stands(), to, Limits(velocity), 1 / config_.control.rate_hz);
  if (guarded()) RS_RETURN_IF_ERROR(CheckPath(*model_, path));
  return Begin(what, std::move(path), [there](double off) {
    return absl::StrFormat("the arm is %s, %.1f mrad off", there, off);
  });
}

absl::StatusOr<PendingAnswer> OwnWays::Home() {
  if (config_.home.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("no starting pose is configured; give home: ", arm_.axes().count(),
                     " numbers, of ", arm_.axes().text(), " [rad, m]"));
  }
  return Move("home", "home", HomeOf(config_), config_.home_velocity);
}

absl::StatusOr<PendingAnswer> OwnWays::Jog(int axis, double amount) {
  const ArmLimits limits = arm_.limits();
  const ArmAxes& axes = limits.axes;
  const bool gripper = axis == kGripperAxis;
  if (gripper ? !axes.gripper : axis >= axes.joints)
    return absl::InvalidArgumentError(absl::StrCat("this arm has ", axes.text()));
  if (gripper) axis = axes.opening();
  ArmVector to = Stands();
  to[axis] = loop_->seen().position[axis] + amount;  // also of the gripper: as a person sees it
  // An arm on its rest has joints at the end of what it allows, where the limiter lets none stay.
  const double margin = config_.control.limits.joint_margin;
  for (int j = 0; j < axes.joints; ++j) {
    const double inside = std::clamp(to[j], limits.lower[j] + margin, limits.upper[j] - margin);
    if (j != axis && std::abs(to[j] - inside) <= kRests) to[j] = inside;
  }
  if (!gripper) RS_RETURN_IF_ERROR(CheckPose("the way's end", to, limits, nullptr));
  if (axes.gripper) {
    const int opening = axes.opening();
    to[opening] = std::clamp(to[opening], limits.lower[opening], limits.upper[opening]);
  }
  return Move("jog", "there", to, config_.jog_velocity);
}

absl::StatusOr<PendingAnswer> OwnWays::Play(double speed) {
  if (!motion_)
    return absl::FailedPreconditionError(
        "this run has no motion; quit, and start `robot_client replay` or `robot_client excite`");
  RS_RETURN_IF_ERROR(MayMove());
  if (config_.slow_first && speed > kSlowly && fastest_played_ == 0)
    return absl::FailedPreconditionError(
        "the motion was not played slowly yet; type play slow and watch its way, then play");
  const ArmVector from = Stands();
  making_ = std::async(std::launch::async, [this, speed, from]() -> absl::StatusOr<ArmPath> {
    pthread_setname_np(pthread_self(), "motion");
    const double period_s = 1 / config_.control.rate_hz;
    PlayedMotion played =
        PlayMotion(*motion_, speed, from, Limits(config_.home_velocity), period_s);
    RS_RETURN_IF_ERROR(CheckSpeed(played, speed, config_.control.limits.joint_velocity, period_s));
    if (guarded()) RS_RETURN_IF_ERROR(CheckPath(*model_, played.path));
    return std::move(played.path);
  });
  stopped_ = false;
  const std::string what = absl::StrFormat("play %.2g", speed);
  return PendingAnswer{what, clock_->now_ns() + static_cast<int64_t>(kMakes_s * 1e9),
                       [this, speed, what]() -> std::optional<absl::StatusOr<std::string>> {
                         if (making_.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
                           return std::nullopt;
                         absl::StatusOr<ArmPath> path = making_.get();
                         if (stopped_)
                           return absl::CancelledError(what + " was stopped before it began");
                         if (!path.ok()) return path.status();
                         next_ = Begin(what, *std::move(path), [this, speed](double off) {
                           fastest_played_ = std::max(fastest_played_, speed);
                           return absl::StrFormat("the motion is over, %.1f mrad off its end; %s",
                                                  off,
                                                  speed < 1 ? "type play, or quit" : "type quit");
                         });
                         return "";
                       },
                       absl::DeadlineExceededError(what + " could not be made in time")};
}

}  // namespace robostress
