#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/piper/arm_state.h"
#include "robot_client/piper/command_guard.h"
#include "robot_client/piper/firmware.h"
#include "robot_client/robot_arm.h"
#include "robot_client/snapshot_cell.h"

namespace robostress::piper {

struct PiperArmOptions {
  // Of the joints' maximal speed, in every 0x151: the arm's own bound on how fast it goes to a
  // target, which holds whatever the target is. PercentOf a limit.
  int speed_percent = 100;
  // The same while it is enabled: an arm that lies beyond its limits is led back slowly.
  int enable_percent = 5;
  Follow follow = Follow::kPlanned;  // kDirect is faster and weaker
  double limit_margin = 0.005;       // [rad] between limits() and what the arm allows
  Firmware oldest_firmware = kOldestFirmware;
  int64_t max_skew_ns = 3'000'000;    // between the frames of a joint sample
  int64_t listen_ns = 500'000'000;    // Connect listens this long for other senders' commands
  int64_t reply_ns = 300'000'000;     // waits this long for an answer, then asks again
  int attempts = 4;                   // questions per answer
  int64_t enable_ns = 4'000'000'000;  // Enable gives up after this
  // Before Enable sends anything it listens this long for another sender. Where two clients could
  // be enabled at once the time must differ between them, so that one hears the other.
  int64_t enable_listen_ns = 150'000'000;
  int64_t fresh_ns = 50'000'000;       // Enable takes no older pose
  double still = 0.05;                 // [rad/s] nor one that moves faster
  int64_t foreign_ns = 1'000'000'000;  // Acknowledge forgets a sender that was silent so long
};

// The speed percentage at which the arm can follow commands of this speed [rad/s] and catch up with
// a tenth more, never more than 100.
int PercentOf(double joint_velocity);

// A Piper behind a CAN bus, driven by absolute joint targets in move mode J (follow as configured).
// It has no thread: Poll takes in what the kernel stamped on arrival. Connect, Enable and Disable
// wait on the clock, and so let simulated time pass; the others never wait and never allocate,
// their errors carry a code only:
//   Send: kFailedPrecondition before Connect or after QuickStop; kInvalidArgument for a target that
//   is not finite or beyond limits(); else what the bus answered.
class PiperArm : public RobotArm {
 public:
  PiperArm(std::unique_ptr<CanBus> bus, Clock& clock, PiperArmOptions options = {});

  absl::Status Connect() override;
  // Joints only: the gripper is enabled by the first Send. Holds the measured pose before and
  // after. Refuses an arm that reports an emergency stop.
  using RobotArm::Enable;
  absl::Status Enable(const std::function<bool()>& cancelled) override;
  // Lets the arm fall. Also ends an emergency stop, which the vendor's reset does by taking the
  // power off.
  absl::Status Disable() override;
  void Poll() override;
  void Acknowledge() override;
  void AddSampleReader(SpscRing<ArmSnapshot>* ring) override { sample_reader_ = ring; }
  ArmSnapshot Latest() const override { return snapshot_.Load(); }
  absl::Status Send(const ArmCommand& command) override;
  absl::Status QuickStop() override;
  ArmLimits limits() const override { return limits_; }
  std::string description() const override;

  // Known after Connect.
  const Firmware& firmware() const { return firmware_; }
  uint64_t torn_samples() const { return state_.torn_samples(); }
  uint64_t foreign_commands() const { return state_.foreign_commands(); }
  CanHealth bus_health() const { return bus_->health(); }
  const ArmState& state() const { return state_; }
  // Asks for collision_levels. An arm of an older firmware may not answer: no error.
  absl::Status AskCollisionLevels();
  // The arm's own collision protection of each joint, 0 (off) to 8; nothing: not asked, or no
  // answer.
  const std::optional<std::array<int, kJoints>>& collision_levels() const {
    return state_.collision_levels();
  }
  // Writes it and reads it back.
  absl::Status SetCollisionLevel(int level);

 private:
  absl::Status TryConnect();
  absl::Status TryEnable(const std::function<bool()>& cancelled);
  absl::Status Explained(const absl::Status& status) const;
  absl::Status Listen();
  absl::Status AskFirmware();
  absl::Status AskLimits();
  absl::Status CheckStands(double still);  // [rad/s]
  absl::Status SendAllowed(const CanFrame& frame, Consent consent);
  absl::Status SendTargets(const JointVector& q, int speed_percent);
  absl::Status HoldMeasuredPose();
  // Polls until `done` or for `duration_ns`; what `done` said last.
  template <class Done>
  bool WaitFor(int64_t duration_ns, const Done& done);
  std::string Named(const std::string& text) const;  // with the bus in front

  const std::unique_ptr<CanBus> bus_;
  Clock& clock_;
  const PiperArmOptions options_;
  ArmState state_;
  SnapshotCell<ArmSnapshot> snapshot_;
  ArmSnapshot published_;
  SpscRing<ArmSnapshot>* sample_reader_ = nullptr;
  Firmware firmware_;
  ArmLimits limits_;
  bool connected_ = false;
  bool stopped_ = false;     // by QuickStop, until Disable
  bool commanding_ = false;  // since Enable: the arm must stay in the mode it was put in
};

}  // namespace robostress::piper
