#pragma once

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "nlohmann/json.hpp"
#include "robot_client/bridge/bridge_arm.h"
#include "robot_client/control/control_loop.h"
#include "tests/robot_client/answer_to.h"

namespace robostress::bridge {

inline constexpr char kFiveServos[] = R"(
name: five
rate_hz: 30
joints:
  - {name: pan, unit: degrees, lower: -1.8, upper: 1.8, velocity: 2, acceleration: 8}
  - {name: lift, unit: degrees, sign: -1, zero: 0.5, lower: -1.7, upper: 1.7, velocity: 2, acceleration: 8}
  - {name: elbow, unit: radians, lower: -1.6, upper: 1.6, velocity: 2, acceleration: 8}
  - {name: flex, unit: range, driver_range: [-100, 100], range: [-2, 2], lower: -1.6, upper: 1.6, velocity: 2, acceleration: 8}
  - {name: roll, unit: degrees, lower: -2.6, upper: 2.6, velocity: 2, acceleration: 8}
gripper: {name: jaw, unit: range, driver_range: [0, 100], range: [0, 0.08], lower: 0, upper: 0.08, velocity: 0.2, acceleration: 4}
home: [0, 0.2, 0.3, 0, 0, 0.04]
driver: {on_silence: true, watchdog_s: 0.5, torque_off: true}
simulated: true
)";

// A Franka: seven joints and a hand, in radians and metres.
inline std::string SevenJoints() {
  std::string yaml = "name: seven\njoints:\n";
  for (int j = 1; j <= 7; ++j)
    yaml += "  - {name: j" + std::to_string(j) +
            ", unit: radians, lower: -2, upper: 2, velocity: 2, acceleration: 8}\n";
  return yaml +
         "gripper: {name: hand, unit: range, driver_range: [0, 0.04], range: [0, 0.08], lower: 0, "
         "upper: 0.08, velocity: 0.1, acceleration: 2}\n"
         "home: [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.04]\n"
         "driver: {torque_off: true}\nsimulated: true\n";
}

// The driver's end of the bridge in the test's own thread, in simulated time: it gets its turn
// whenever the client lets time pass. An axis goes to its target at 2 rad/s at most.
class ScriptedDriver {
 public:
  explicit ScriptedDriver(int descriptor, const BridgeRobot& robot)
      : descriptor_(descriptor), axes_(robot.limits.axes.count()), conversions_(robot.conversions) {
    welcome = {{"protocol", 1},
               {"driver", "scripted"},
               {"robot", "five servos"},
               {"clock", "monotonic"},
               {"stop", true},
               {"hold", true},
               {"torque_off", true},
               {"measures_velocity", false},
               {"measures_effort", false},
               {"simulated", true},
               {"on_silence", "hold"},
               {"watchdog_s", 0.25},
               {"state_hz", 100},
               {"axes", robot.names()}};
    for (int i = 0; i < axes_; ++i)
      target[i] = position[i] = i == robot.limits.axes.opening() ? 0.04 : 0.1 * i;
  }
  ~ScriptedDriver() { HangUp(); }
  void HangUp() {
    if (descriptor_ >= 0) close(descriptor_);
    descriptor_ = -1;
  }

  void Write(const void* data, size_t size) {
    if (descriptor_ >= 0) std::ignore = send(descriptor_, data, size, MSG_DONTWAIT | MSG_NOSIGNAL);
  }
  void WriteText(FrameKind kind, const std::string& text) {
    const std::vector<uint8_t> bytes = EncodeText(kind, ++sequence, text);
    Write(bytes.data(), bytes.size());
  }

  // Until `now_ns`: what came is obeyed, a state goes out every 10 ms.
  void Turn(int64_t now_ns) {
    if (reads) Read();
    const double dt = 1e-9 * static_cast<double>(now_ns - last_ns_);
    for (int i = 0; i < axes_; ++i) {
      if (blocked) break;
      position[i] += std::clamp(target[i] - position[i], -2 * dt, 2 * dt);
    }
    position[axes_ - 1] = std::max(position[axes_ - 1], grasped);
    last_ns_ = now_ns;
    if (silent || now_ns < next_ns_ || !greeted) return;
    next_ns_ = now_ns + 10'000'000;
    for (int k = 0; k < floods; ++k) WriteState(State(now_ns));
  }

  StateFrame State(int64_t now_ns) const {
    StateFrame state;
    state.stamp_ns = now_ns - stamp_back_ns;
    state.sent_ns = now_ns;
    state.command = newest;
    state.flags = (powered ? kPowered : 0u) | (taking ? kTaking : 0u) | (stopped ? kStopped : 0u);
    state.faults = faults;
    state.axes = axes_;
    for (int i = 0; i < axes_; ++i)
      state.position[i] =
          conversions_[i].Drivers(position[i] + (i == shifted || shifted < 0 ? shift : 0));
    const ArmVector torque = model != nullptr ? model->Torque(position, {}, {}, 0) : ArmVector{};
    for (int i = 0; i < axes_; ++i) state.effort[i] = torque[i] + push[i];
    if (nan) state.position[axes_ - 2] = std::numeric_limits<double>::quiet_NaN();
    return state;
  }
  void WriteState(const StateFrame& state) {
    std::array<uint8_t, kMostFrame> bytes;
    const size_t size = EncodeState(state, frozen_sequence ? sequence : ++sequence, bytes);
    Write(bytes.data(), size);
  }

  nlohmann::json welcome;
  std::string greeting;  // the hello, once it came
  uint64_t sequence = 0, newest = 0;
  ArmVector position{}, target{};  // by place, ours
  CommandFrame last;               // as it came
  int commands = 0, heartbeats = 0, stops = 0, enables = 0;
  const ArmModel* model = nullptr;  // its motors hold what this says ...
  ArmVector push{};                 // [Nm] ... and press with this
  bool greeted = false, powered = false, taking = false, stopped = false;
  // What goes wrong.
  bool reads = true, silent = false, nan = false, blocked = false, frozen_sequence = false;
  bool obeys_stop = true, obeys_enable = true, lies = false;
  double grasped = -10;  // between the fingers, the last axis: they close no further
  double shift = 0;      // [rad] of every measurement, or of the axis `shifted`
  int shifted = -1;
  int64_t stamp_back_ns = 0;
  int floods = 1;
  uint32_t faults = 0;

 private:
  void Read() {
    uint8_t bytes[4096];
    ssize_t count = 0;
    while (descriptor_ >= 0 && (count = recv(descriptor_, bytes, sizeof bytes, MSG_DONTWAIT)) > 0)
      came_.insert(came_.end(), bytes, bytes + count);
    FrameHeader header;
    while (!came_.empty() && DecodeHeader(came_.data(), came_.size(), header) == Decoded::kFrame) {
      Take(header, came_.data() + kHeaderBytes);
      came_.erase(came_.begin(), came_.begin() + static_cast<long>(kHeaderBytes) + header.size);
    }
  }
  void Take(const FrameHeader& header, const uint8_t* payload) {
    if (header.kind == FrameKind::kHello) {
      greeting.assign(payload, payload + header.size);
      WriteText(FrameKind::kWelcome, welcome.dump());
      greeted = true;
      return;
    }
    if (header.kind != FrameKind::kCommand) return;
    CommandFrame command;
    ASSERT_EQ(DecodeCommand(payload, header.size, axes_, command), Decoded::kFrame);
    EXPECT_GT(header.sequence, newest);
    newest = header.sequence;
    if (command.mode == CommandMode::kEnable && obeys_enable) {
      ++enables;
      powered = taking = true;
      stopped = false;
    }
    if (command.mode == CommandMode::kPowerOff) powered = taking = false;
    if (command.mode == CommandMode::kStop) {
      ++stops;
      if (obeys_stop) {
        taking = false;
        stopped = true;
        if (!lies) target = position;
      }
    }
    if (command.mode == CommandMode::kHeartbeat) ++heartbeats;
    if (command.mode != CommandMode::kTarget) return;
    ++commands;
    last = command;
    if (!taking) return;
    for (int i = 0; i < axes_; ++i) target[i] = conversions_[i].Ours(command.position[i]);
  }

  int descriptor_;
  const int axes_;
  const std::vector<Conversion> conversions_;
  std::vector<uint8_t> came_;
  int64_t last_ns_ = 0, next_ns_ = 0;
};

// Lets the driver take its turn every millisecond that somebody sleeps.
class TurnClock : public ManualClock {
 public:
  TurnClock() : ManualClock(10'000'000'000) {}
  void SleepUntil(int64_t deadline_ns) override {
    while (now_ns() < deadline_ns) {
      ManualClock::SleepUntil(std::min(now_ns() + 1'000'000, deadline_ns));
      if (driver != nullptr) driver->Turn(now_ns());
      if (on_turn) on_turn();
    }
  }
  std::function<void()> on_turn;
  ScriptedDriver* driver = nullptr;
};

// Client and driver, in simulated time.
struct BridgeWorld {
  static constexpr int64_t kPeriod_ns = 33'333'333;

  explicit BridgeWorld(const std::string& yaml = kFiveServos) {
    auto read = ParseBridgeRobot("five.yaml", yaml);
    EXPECT_TRUE(read.ok()) << read.status();
    Begin(*std::move(read));
  }
  explicit BridgeWorld(BridgeRobot read) { Begin(std::move(read)); }
  void Begin(BridgeRobot read) {
    robot = std::move(read);
    StartDriver();
    const auto dial = [this](double) -> absl::StatusOr<std::unique_ptr<DriverSocket>> {
      if (listening < 0) return absl::UnavailableError("nobody listens");
      return std::make_unique<DriverSocket>(std::exchange(listening, -1));
    };
    arm = std::make_unique<BridgeArm>(robot, dial, clock);
  }
  ~BridgeWorld() {
    if (listening >= 0) close(listening);
  }
  // A driver that the next dial reaches.
  void StartDriver() {
    int ends[2];
    EXPECT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends), 0);
    listening = ends[0];
    driver = std::make_unique<ScriptedDriver>(ends[1], robot);
    clock.driver = driver.get();
  }
  absl::Status Connected() { return arm->Connect(); }
  // Connects, and sets the loop up.
  void Open(ControlOptions options = {}, const ArmModel* model = nullptr) {
    ASSERT_TRUE(arm->Connect().ok());
    FitDefaults(robot.limits.axes.joints, options.press);
    auto made = ControlLoop::Create(options, arm.get(), &clock, &cameras, model);
    ASSERT_TRUE(made.ok()) << made.status();
    loop = *std::move(made);
    loop->OnPredictionRequested([this] { Serve(); });
    due_ns = clock.now_ns();
  }
  void Serve() {
    PredictionRequest request;
    while (loop->prediction_requests().Pop(request)) {
      loop->AnswerPrediction(AnswerTo(request, [&](int i) {
        ArmVector target = request.position;
        target[moved] += speed * (i + 1) / 30.0;
        return target;
      }));
    }
  }
  const TickRecord& Tick(uint32_t requests = 0) {
    due_ns = std::max(due_ns + kPeriod_ns, clock.now_ns());
    clock.SleepUntil(due_ns);
    if (requests != 0) loop->Ask(requests);
    loop->Tick(due_ns);
    return loop->last_record();
  }
  void Ticks(int n) {
    for (int i = 0; i < n; ++i) Tick();
  }
  // Enabled, and in the middle of an episode that moves J1, or `moved`.
  void Run() {
    Tick(kRequestEnable);
    ASSERT_EQ(loop->state(), ClientState::kEnabled) << loop->enable_status();
    Tick(kRequestStart);
    Ticks(30);
    ASSERT_EQ(loop->state(), ClientState::kRun) << CauseName(loop->cause());
  }
  // Ticks until the state is left; the seconds that took.
  double SecondsUntilLeft(ClientState state, int most = 120) {
    const int64_t from = clock.now_ns();
    for (int i = 0; i < most && loop->state() == state; ++i) Tick();
    return 1e-9 * static_cast<double>(clock.now_ns() - from);
  }

  TurnClock clock;
  BridgeRobot robot;
  std::unique_ptr<ScriptedDriver> driver;
  std::unique_ptr<BridgeArm> arm;
  NoCameras cameras;
  std::unique_ptr<ControlLoop> loop;
  double speed = 0.3;  // [rad/s] of what the policy wants of `moved`
  int moved = 0;
  int listening = -1;
  int64_t due_ns = 0;
};

}  // namespace robostress::bridge
