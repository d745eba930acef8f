#pragma once

#include <cstdint>

#include "robot_client/robot_arm.h"

namespace robostress {

// Where somebody wants the arm to be in this tick.
struct LiveRow {
  ArmVector wanted{};   // what the person asks for: joints [rad], opening [m]; a record's action
  ArmVector target{};   // where the command goes now: on the way to `wanted`, or the same
  bool joining = true;  // the command has not come to `wanted` since the motion began
};

// Targets that come in while the arm moves: a leader arm's, a keyboard's, a gamepad's. The control
// loop plays them in MOVE, under the same limits and guards as everything else; whatever delivers
// them does so from a thread of its own through a SnapshotCell. Every function is called in the
// control thread, never waits and never allocates.
class LiveTarget {
 public:
  virtual ~LiveTarget() = default;

  // A motion begins; the last command is `command`.
  virtual void Begin(const ArmVector& command) = 0;
  // Nobody is there: the source has not been heard for too long, or is unplugged. The loop goes to
  // HOLD (input_silent), or does not begin.
  virtual bool Silent(int64_t now_ns) const = 0;
  // The row of this tick; `command` is the last one.
  virtual LiveRow Next(int64_t now_ns, const ArmVector& command) = 0;
};

}  // namespace robostress
