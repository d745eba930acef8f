#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "robot_client/arm_path.h"
#include "robot_client/can/in_process_bus.h"
#include "robot_client/control/control_loop.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/piper/piper_arm.h"
#include "robot_client/piper/piper_model.h"
#include "tests/robot_client/answer_to.h"

namespace robostress {

// The control loop of the client on an arm in software that stands on a table, in simulated time,
// and a third node that hears every frame.
struct ArmWorld {
  static constexpr double kPeriod_s = 1.0 / 30;

  struct Options {
    ControlOptions control;
    std::string profile = "new";
    std::vector<std::string> faults;
    piper::JointVector start{0, 1.2, -1.0, 0, 0.5, 0};
    bool guards_torque_and_space = true;  // the loop knows the arm's model
    std::string world_xml;                // beside the table
    piper::EmulatorOptions emulated;      // for what is not above: teaching, a hand
  };

  explicit ArmWorld(const Options& options) : bus(time) {
    piper::EmulatorOptions emulated = options.emulated;
    emulated.profile = options.profile;
    emulated.start = options.start;
    emulated.opening = 0.03;
    emulated.scene.world_xml =
        R"(<geom name="table" type="plane" size="2 2 0.1" pos="0 0 0"/>)" + options.world_xml;
    for (const std::string& fault : options.faults)
      emulated.faults.push_back(*piper::ParseFault(fault));
    auto made = piper::PiperEmulator::Create(emulated, bus.Attach(), time);
    EXPECT_TRUE(made.ok()) << made.status();
    emulator = *std::move(made);
    time.Add(emulator.get());
    third = bus.Attach();
    EXPECT_TRUE(third->Open().ok());
    piper::PiperArmOptions piper;
    piper.speed_percent = piper::PercentOf(options.control.limits.joint_velocity);
    arm = std::make_unique<piper::PiperArm>(bus.Attach(), time, piper);
    connected = arm->Connect();
    if (!connected.ok()) return;
    model = std::make_unique<piper::PiperModel>(piper::ZeroOf(arm->firmware()),
                                                options.control.workspace);
    auto loop_made = ControlLoop::Create(options.control, arm.get(), &time, &cameras,
                                         options.guards_torque_and_space ? model.get() : nullptr);
    EXPECT_TRUE(loop_made.ok()) << loop_made.status();
    loop = *std::move(loop_made);
    loop->OnPredictionRequested([this] { Serve(); });
    due_ns = time.now_ns();
  }

  // `row(i, q)`: target of the i-th row after an observation of the arm at q.
  void Serve() {
    PredictionRequest request;
    while (loop->prediction_requests().Pop(request)) {
      if (!policy) continue;
      loop->AnswerPrediction(AnswerTo(request, [&](int i) { return policy(i, request); }));
    }
  }

  const TickRecord& Tick(uint32_t requests = 0) {
    due_ns = std::max(due_ns + static_cast<int64_t>(1e9 * kPeriod_s), time.now_ns());
    time.SleepUntil(due_ns);
    if (requests != 0) loop->Ask(requests);
    loop->Tick(due_ns);
    return loop->last_record();
  }
  void Ticks(int n) {
    for (int i = 0; i < n; ++i) Tick();
  }
  // Play a straight way to `to`.
  absl::Status Move(const ArmVector& to, bool checked = true) {
    auto path = std::make_unique<ArmPath>(
        StraightPath(loop->axes(), loop->seen().position, to, PathLimits{}, kPeriod_s));
    if (checked) {
      if (absl::Status crossed = CheckPath(*model, *path); !crossed.ok()) return crossed;
    }
    loop->Play(path.get());
    paths.push_back(std::move(path));
    return absl::OkStatus();
  }

  piper::EmulatedTime time;
  InProcessBus bus;
  NoCameras cameras;
  std::unique_ptr<piper::PiperEmulator> emulator;
  std::unique_ptr<CanBus> third;
  std::unique_ptr<piper::PiperArm> arm;
  std::unique_ptr<piper::PiperModel> model;
  std::unique_ptr<ControlLoop> loop;
  std::vector<std::unique_ptr<ArmPath>> paths;
  std::function<ArmVector(int row, const PredictionRequest& request)> policy;
  absl::Status connected;
  int64_t due_ns = 0;
};

}  // namespace robostress
