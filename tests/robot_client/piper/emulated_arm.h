#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <utility>

#include "robot_client/can/in_process_bus.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/piper/piper_arm.h"

namespace robostress::piper {

// A client's arm and an emulator on one bus in one simulated time, and a third node that listens
// and can speak as a foreigner.
struct EmulatedArm {
  explicit EmulatedArm(const EmulatorOptions& options = {}, const PiperArmOptions& client = {})
      : bus(time), third(bus.Attach()) {
    emulator = std::move(PiperEmulator::Create(options, bus.Attach(), time).value());
    time.Add(emulator.get());
    arm = std::make_unique<PiperArm>(bus.Attach(), time, client);
    (void)third->Open();
  }
  // The client polls as often as it should, at least.
  void Run(double seconds) {
    const int64_t end_ns = time.now_ns() + static_cast<int64_t>(1e9 * seconds);
    while (time.now_ns() < end_ns) {
      time.SleepUntil(std::min(end_ns, time.now_ns() + 20'000'000));
      arm->Poll();
    }
  }
  // Commands at 30 Hz for a while, as a client does.
  absl::Status Stream(const ArmCommand& command, double seconds) {
    for (int tick = 0; tick < static_cast<int>(30 * seconds); ++tick) {
      if (absl::Status sent = arm->Send(command); !sent.ok()) return sent;
      Run(1.0 / 30);
    }
    return absl::OkStatus();
  }

  EmulatedTime time;
  InProcessBus bus;
  std::unique_ptr<CanBus> third;
  std::unique_ptr<PiperEmulator> emulator;
  std::unique_ptr<PiperArm> arm;
};

inline ::testing::AssertionResult Enabled(EmulatedArm& world) {
  const absl::Status status = world.arm->Enable();
  if (status.ok()) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << status;
}

inline ArmCommand Command(const JointVector& q, double opening = 0.03) {
  ArmCommand command;
  for (int j = 0; j < kJoints; ++j) command.position[j] = q[j];
  command.position[kJoints] = opening;
  return command;
}

}  // namespace robostress::piper
