#pragma once

#include <array>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.h"
#include "robot_client/bridge/driver_socket.h"
#include "robot_client/bridge/protocol.h"
#include "robot_client/bridge/robot_file.h"
#include "robot_client/robot_arm.h"
#include "robot_client/snapshot_cell.h"

namespace robostress::bridge {

struct BridgeArmOptions {
  double wait_s = 5;               // for a driver that is being started
  double again_s = 1;              // for one that was started again, and for each of its answers
  double welcome_s = 5;            // for its answer and its first state
  double enable_s = 5;             // Enable gives up after this
  double reply_s = 0.5;            // Enable waits for a fresh state of an arm that stands
  double fresh_s = 0.05;           // Enable takes no older pose
  double still = 0.05;             // [rad/s] nor one that moves faster
  double velocity_window_s = 0.1;  // over which velocities are estimated
  double stop_s = 0.3;             // until a driver that was told to stop must say so ...
  double stopped_s = 1;            // ... and until the joints must be slower ...
  double stopped_velocity = 0.2;   // ... than this [rad/s]
};

// What was refused of what a driver sent.
struct BridgeCounters {
  uint64_t states = 0;      // taken
  uint64_t repeated = 0;    // with a sequence or a stamp that is not newer, or of a time to come
  uint64_t not_finite = 0;  // with a value that is no number
  uint64_t jumps = 0;       // to where no joint can get in that time
  uint64_t full = 0;        // commands that the driver did not read
};

// An arm behind a driver process, at the other end of a unix socket. It has no thread: Poll takes
// in what has come, at most so much a tick, and sends a heartbeat where nothing else was sent.
// Connect, Enable and Disable wait on the clock; the others never wait and never allocate, their
// errors carry a code only.
//
// A connection that ends, or on which something comes that is no frame, is closed: kFaultBus until
// Reconnect has made another one, to a driver that says the same of itself and of its arm. A value
// that is no number is kFaultDriver until Acknowledge. A sample that no joint can have got to is
// not taken: where they go on the arm is silent.
class BridgeArm : public RobotArm {
 public:
  // `clock` outlives it. `address`: unix:PATH.
  BridgeArm(BridgeRobot robot, std::string address, Clock& clock, BridgeArmOptions options = {});
  // Opens its stream by `dial`, which is given how long to wait for a driver [s].
  using Dial = std::function<absl::StatusOr<std::unique_ptr<DriverSocket>>(double wait_s)>;
  BridgeArm(BridgeRobot robot, Dial dial, Clock& clock, BridgeArmOptions options = {});
  ~BridgeArm() override;  // says that it is the end: the driver does what it does on silence

  absl::Status Connect() override;
  using RobotArm::Enable;
  absl::Status Enable(const std::function<bool()>& cancelled) override;
  // UNIMPLEMENTED where the driver cannot take the power off.
  absl::Status Disable() override;
  void Poll() override;
  bool lost() const override { return *broken_ != '\0'; }
  absl::Status Reconnect(const std::function<bool()>& cancelled) override;
  void Acknowledge() override;
  void AddSampleReader(SpscRing<ArmSnapshot>* ring) override { sample_reader_ = ring; }
  ArmSnapshot Latest() const override { return snapshot_.Load(); }
  absl::Status Send(const ArmCommand& command) override;
  absl::Status QuickStop() override;
  ArmLimits limits() const override { return robot_.limits; }
  std::string description() const override;
  std::string stop_effect() const override;

  // After Connect, for the person who starts it: what the driver cannot do, a line each.
  std::vector<std::string> Warnings() const;
  const std::optional<ArmChain>& chain() const { return robot_.chain; }  // of its model
  const Welcome& welcome() const { return welcome_; }
  const BridgeCounters& counters() const { return counters_; }
  // The newest state as it came; for measuring.
  const StateFrame& state() const { return state_; }

 private:
  absl::Status Open(double wait_s, double answer_s, const std::function<bool()>& stop);
  absl::Status Greet(double answer_s, const std::function<bool()>& stop);
  absl::Status Stopped() const;
  absl::Status CheckStands(double still) const;
  absl::Status SendFrame(CommandMode mode, const ArmVector& position, double gripper_effort);
  absl::Status SendHold(CommandMode mode);
  void TakeBytes();
  void TakeFrame(const FrameHeader& header, const uint8_t* payload);
  void TakeState(const FrameHeader& header, const uint8_t* payload);
  bool TakeSample(const StateFrame& state);
  void EstimateVelocity();
  bool Jumps(const ArmVector& position, int64_t stamp_ns) const;
  void Broken(const char* why);
  void WatchStop(int64_t now_ns);
  void Publish();
  template <class Done>
  bool WaitFor(double seconds, const Done& done);
  std::string Named(const std::string& text) const;  // with the bridge in front

  const BridgeRobot robot_;
  const std::string address_;
  const Dial dial_;
  Clock& clock_;
  const BridgeArmOptions options_;
  std::unique_ptr<DriverSocket> socket_;
  Welcome welcome_;         // of the first driver; those after it must say the same
  Welcome greeting_;        // of the one that is connected
  bool connected_ = false;  // once, by Connect
  bool welcomed_ = false;
  std::string refusal_;      // what the driver or its bytes said against going on
  const char* broken_ = "";  // why the connection is given up; empty: it is not

  std::array<uint8_t, 4 * (kHeaderBytes + kMostPayload)> buffer_{};  // bytes that came
  size_t filled_ = 0;
  uint64_t sent_sequence_ = 0;
  int64_t sent_ns_ = 0;
  uint64_t state_sequence_ = 0;
  StateFrame state_;
  ArmSnapshot sample_;
  SnapshotCell<ArmSnapshot> snapshot_;
  SpscRing<ArmSnapshot>* sample_reader_ = nullptr;
  uint32_t latched_ = 0;            // ArmFault, until Acknowledge
  bool commanding_ = false;         // since Enable: the driver must go on taking targets
  bool stopped_ = false;            // by QuickStop, until Enable
  std::optional<ArmCommand> grip_;  // the last one taken since the joints have had power
  int64_t stop_ns_ = 0;             // when that began
  int64_t stop_asked_ns_ = 0;       // when it was last asked for
  // Since a sample was refused as a jump: the time that its way took [s].
  double jump_s_ = std::numeric_limits<double>::infinity();
  bool anywhere_ = true;  // the next sample may be: a person has looked
  BridgeCounters counters_;

  struct Place {
    int64_t stamp_ns = 0;
    ArmVector position{};
  };
  static constexpr size_t kPlaces = 64;
  std::array<Place, kPlaces> places_{};  // of the last samples, for velocities
  size_t places_seen_ = 0;
};

}  // namespace robostress::bridge
