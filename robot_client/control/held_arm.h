#pragma once

#include <optional>

#include "absl/status/status.h"
#include "robot_client/control/press_watch.h"
#include "robot_client/control/tick_record.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// A joint that is slower stands [rad/s].
inline constexpr double kStill = 0.05;
// A held joint further off its command [rad] is let go.
inline constexpr double kRelax = 0.03;

// An arm at rest stands on its limits, and what it measures may lie a little beyond them: moves
// `position` to the nearest one that the arm takes. FAILED_PRECONDITION where it lies further
// outside than an arm without power hangs in its mechanical stops.
absl::Status MoveInside(const ArmLimits& limits, ArmVector& position);

// Where the command of an arm goes that stands, or is held: nowhere, unless the arm presses or was
// kept from its command. Then it goes to where the arm is, and on, away from what it presses
// against: a servo's integral part goes on pressing on the spot. Allocates nothing. One thread.
class HeldArm {
 public:
  // The arm stands anew, or does something else from now on. `measured`: joints [rad].
  void Begin(const ArmVector& measured);

  // One tick of an arm that has nothing to do, with a fresh sample. `held`: in HOLD. `command` is
  // the last one, `at_rest` whether it has come to rest.
  void Take(const TickRecord& record, const PressWatch& press, bool held, const ArmVector& command,
            bool at_rest);
  // Where the command goes; nothing: it brakes and stands.
  const std::optional<ArmVector>& target() const { return target_; }

  // The arm was held because it presses, is blocked or does not follow. Its command is ahead of it
  // by what it lags and by all that it was held back since; led back under the limits it would go
  // on pressing for as long as that takes. So it becomes where the arm stands, which is returned
  // and is no motion that anybody could ask for. A gripper keeps its command, or it would drop what
  // it holds. Nothing: it stands outside of its limits.
  std::optional<ArmVector> LetGo(const ArmLimits& limits, const ArmVector& measured,
                                 const ArmVector& command);

 private:
  std::optional<ArmVector> target_;
  bool relaxed_ = false;  // since Begin
  ArmVector stood_at_{};  // measured at Begin
  ArmVector pushed_{};    // which way joints pressed when the arm was held: -1, 0, 1
};

}  // namespace robostress
