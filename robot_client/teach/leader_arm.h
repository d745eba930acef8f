#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/piper/joint_assembler.h"
#include "robot_client/snapshot_cell.h"
#include "robot_client/teach/leader_target.h"

namespace robostress {

// Listens to a Piper in leader mode on a bus of its own: it sends 0x155 to 0x157 and 0x159, the
// targets that a follower on its bus would obey, and no feedback. Nothing is ever sent to it.
class LeaderArm {
 public:
  LeaderArm(std::unique_ptr<CanBus> bus, Clock* clock) : bus_(std::move(bus)), clock_(*clock) {}
  ~LeaderArm();

  // Opens the bus and waits up to a second for a whole sample. UNAVAILABLE says what was heard
  // instead, and what to do.
  absl::Status Connect();
  // Takes in what has come; one thread.
  void Poll();
  // Polls in a thread of its own, 500 times a second, until the end.
  void StartThread();

  const SnapshotCell<LeaderSample>& newest() const { return newest_; }
  std::string description() const;

 private:
  const std::unique_ptr<CanBus> bus_;
  Clock& clock_;
  piper::JointAssembler assembler_{3'000'000};
  LeaderSample sample_;
  uint64_t feedback_ = 0;  // frames of an arm that is no leader
  SnapshotCell<LeaderSample> newest_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace robostress
