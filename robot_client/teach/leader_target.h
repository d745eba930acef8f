#pragma once

#include "robot_client/control/live_target.h"
#include "robot_client/snapshot_cell.h"

namespace robostress {

// Where a leader arm stands.
struct LeaderSample {
  ArmVector position{};   // joints [rad], opening [m]
  int64_t stamp_ns = 0;   // of its oldest frame, on the client's clock
  uint64_t sequence = 0;  // 0: nothing was heard yet
};

struct LeaderOptions {
  double silent_s = 0.1;           // a leader that was not heard for so long is gone
  double joint_velocity = 0.6;     // [rad/s] of the fastest joint on the way to the leader
  double acceleration = 1.5;       // [rad/s^2] the same
  double gripper_velocity = 0.05;  // [m/s] the same
  double joined = 0.03;            // [rad] of the fastest joint from the leader: it is reached
  double lost = 0.4;               // [rad] a command further from the leader joins it anew
  double period_s = 1.0 / 30;
};

// A follower's targets. First the command goes straight from where it stands to where the leader is
// at that moment, no faster than the options; from there on it is the leader's. The same again
// after a jump of the leader, which is no motion that a hand can make. Targets are moved inside of
// the follower's limits; `wanted` stays what the leader said. Control thread.
class LeaderTarget : public LiveTarget {
 public:
  // `leader` outlives it. `limits`: of the follower.
  LeaderTarget(const SnapshotCell<LeaderSample>* leader, const ArmLimits& limits,
               const LeaderOptions& options)
      : leader_(leader), limits_(limits), options_(options) {}

  void Begin(const ArmVector& command) override;
  bool Silent(int64_t now_ns) const override;
  LiveRow Next(int64_t now_ns, const ArmVector& command) override;

 private:
  const SnapshotCell<LeaderSample>* const leader_;
  const ArmLimits limits_;
  const LeaderOptions options_;
  ArmVector at_{};  // the target on its way to the leader
  double speed_ = 0;
  bool joined_ = false;
};

}  // namespace robostress
