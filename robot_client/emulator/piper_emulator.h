#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/emulator/arm_firmware.h"
#include "robot_client/emulator/fault_plan.h"
#include "robot_client/emulator/guiding_hand.h"
#include "robot_client/emulator/piper_mjcf.h"
#include "robot_client/emulator/piper_plant.h"

namespace robostress::piper {

struct EmulatorOptions {
  std::string profile = "new";  // see MakeWearProfile
  PiperScene scene;             // with the payload
  Firmware version = {1, 8, 9};
  double command_lag_s = -1;               // negative: the profile's
  bool motor_encoders = false;             // see WearProfile
  double gripper_range = kGripperOpening;  // [m], as configured; 0: never was
  JointVector start{};                     // [rad], joints at power-on: the arm lies on its rest
  double opening = 0;                      // [m], of the gripper at power-on
  std::vector<PlannedFault> faults;
  TeachPlan teach;      // when it is in teaching mode
  bool leader = false;  // a leader from the start, as after 0x470 0xFA
  GuidingHand hand;     // moves it while it is taught or leads
};

// A Piper in software: its frames on a bus, its firmware, its mechanics with a profile's execution
// errors. Time passes in RunUntil only, in steps of 1 ms.
class PiperEmulator {
 public:
  static absl::StatusOr<std::unique_ptr<PiperEmulator>> Create(const EmulatorOptions& options,
                                                               std::unique_ptr<CanBus> bus,
                                                               const Clock& clock);

  // Takes in what has arrived, and lets the arm live until `now_ns` of the clock. A gap of more
  // than kMaxGap_ns is skipped and counted: the machine was busy, and a real arm would not have run
  // faster afterwards.
  static constexpr int64_t kMaxGap_ns = 100'000'000;
  void RunUntil(int64_t now_ns);

  ArmFirmware& firmware() { return *firmware_; }
  PiperPlant& plant() { return *plant_; }
  const WearProfile& profile() const { return profile_; }
  uint64_t steps() const { return steps_; }
  uint64_t skipped_steps() const { return skipped_steps_; }
  uint64_t frames_sent() const { return frames_sent_; }
  uint64_t send_failures() const { return send_failures_; }
  CanHealth bus_health() const { return bus_->health(); }

 private:
  PiperEmulator() = default;
  void Step();
  void Guide(double now_s);
  void SendReports();

  std::unique_ptr<CanBus> bus_;
  WearProfile profile_;
  std::unique_ptr<PiperPlant> plant_;
  std::unique_ptr<ArmFirmware> firmware_;
  FaultSchedule faults_;
  TeachPlan teach_;
  GuidingHand hand_;
  bool parked_ = true;  // on its rest until a joint is enabled for the first time
  std::deque<std::pair<uint64_t, CanFrame>> on_the_way_;  // the step at which each is sent
  std::vector<CanFrame> reports_;
  int64_t next_step_ns_ = 0;
  uint64_t steps_ = 0, skipped_steps_ = 0, frames_sent_ = 0, send_failures_ = 0;
};

// Simulated time in which emulators live: whoever sleeps on this clock lets them run, in steps of
// 1 ms, so that client, policy and arms share one thread and one time.
class EmulatedTime : public ManualClock {
 public:
  void Add(PiperEmulator* emulator) { emulators_.push_back(emulator); }  // not owned
  void SleepUntil(int64_t deadline_ns) override;

 private:
  std::vector<PiperEmulator*> emulators_;
};

}  // namespace robostress::piper
