#pragma once

#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/arm_path.h"
#include "robot_client/client_config.h"
#include "robot_client/motion/motion.h"
#include "robot_client/pending_answer.h"

namespace robostress {

// Ways that the client plans itself and the control loop plays: home, jog, and a given motion. Each
// is checked as a whole before its first command, and braked by a hold like everything else. The
// console's thread; everything it is given outlives it, and it outlives the control thread.
class OwnWays {
 public:
  // `model` may be null where the workspace is not guarded; `say` prints a line.
  OwnWays(const ClientConfig& config, const RobotArm& arm, const ArmModel* model, ControlLoop* loop,
          const Clock* clock, std::function<void(std::string)> say)
      : config_(config),
        arm_(arm),
        model_(model),
        loop_(loop),
        clock_(clock),
        say_(std::move(say)) {}

  // What `play` plays; refused where the arm cannot.
  absl::Status Take(Motion motion);
  const std::optional<Motion>& motion() const { return motion_; }

  absl::StatusOr<PendingAnswer> Home();
  // One axis, or kGripperAxis, by so much [rad, m].
  absl::StatusOr<PendingAnswer> Jog(int axis, double amount);
  // The motion at that share of its speed. Its way is made and checked in a thread of its own, so
  // that the console goes on obeying; then TakeNext has what waits for its end.
  absl::StatusOr<PendingAnswer> Play(double speed);
  std::optional<PendingAnswer> TakeNext() { return std::exchange(next_, std::nullopt); }
  // A person stopped everything: a way that is still being made is not begun.
  void Stop() { stopped_ = true; }
  // The fastest that the motion was played to its end; 0: not yet.
  double fastest_played() const { return fastest_played_; }

 private:
  // The answer once the arm stands at the way's end, from how far off it is [mrad].
  using Arrived = std::function<std::string(double off_mrad)>;

  absl::Status MayMove() const;
  bool guarded() const { return model_ != nullptr && config_.control.workspace.guard; }
  // Where a way begins. Of the gripper it is what was commanded, or it would drop what it holds.
  ArmVector Stands() const;
  PathLimits Limits(double velocity) const;
  absl::StatusOr<PendingAnswer> Move(const std::string& what, const std::string& there,
                                     const ArmVector& to, double velocity);
  PendingAnswer Begin(const std::string& what, ArmPath path, Arrived arrived);

  const ClientConfig& config_;
  const RobotArm& arm_;
  const ArmModel* const model_;
  ControlLoop* const loop_;
  const Clock* const clock_;
  const std::function<void(std::string)> say_;
  std::vector<std::unique_ptr<const ArmPath>> paths_;  // the loop may play the last one
  std::optional<Motion> motion_;
  std::optional<PendingAnswer> next_;
  double fastest_played_ = 0;
  std::future<absl::StatusOr<ArmPath>> making_;
  bool stopped_ = false;  // since it was asked to play
};

// The configured starting pose, which must be there.
ArmVector HomeOf(const ClientConfig& config);

}  // namespace robostress
