#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "robot_client/control/spsc_ring.h"

// What the control loop knows of an arm: a complete sample in, absolute joint targets out. Vendor
// units, frames and identifiers stay below this interface.
namespace robostress {

inline constexpr int kMostJoints = 7;
inline constexpr int kMostAxes = kMostJoints + 1;  // and a gripper
// A number per axis, in the order of ArmAxes; what comes after the arm's own axes stays 0.
using ArmVector = std::array<double, kMostAxes>;

// The axes of an arm, as a policy's actions have them: its joints from the base on, then the
// gripper.
struct ArmAxes {
  int joints = 6;  // J1 .. of so many, at most kMostJoints
  bool gripper = true;

  int count() const { return joints + (gripper ? 1 : 0); }
  // Where the gripper's opening stands in an ArmVector; of an arm without one it is always 0.
  int opening() const { return joints; }
  std::string name(int axis) const;        // "J1" .., "gripper"
  std::vector<std::string> names() const;  // of all, in order
  std::string text() const;                // "6 joints and a gripper"
};

// Bits of ArmSnapshot::faults. A bit says what the arm reported, not what follows from it.
enum ArmFault : uint32_t {
  kFaultEmergencyStop = 1u << 0,    // the arm is in an emergency stop
  kFaultNoSolution = 1u << 1,       // no inverse kinematic solution, or a singularity
  kFaultTargetLimit = 1u << 2,      // a target beyond a joint's limit: the arm stops responding
  kFaultJointLimit = 1u << 3,       // a joint stands beyond its limit
  kFaultJointBus = 1u << 4,         // a joint does not answer the main controller
  kFaultBrake = 1u << 5,            // a brake has not opened
  kFaultCollision = 1u << 6,        // collision protection
  kFaultStall = 1u << 7,            // a stalled motor
  kFaultOverCurrent = 1u << 8,      // of a driver
  kFaultOverTemperature = 1u << 9,  // motor, driver, controller or brake resistor
  kFaultUnderVoltage = 1u << 10,    // of a driver's supply
  kFaultDriver = 1u << 11,          // driver or sensor error
  kFaultGripper = 1u << 12,         // the gripper's driver
  kFaultOther = 1u << 13,           // an abnormal status with no name here
  kFaultForeignCommand = 1u << 14,  // another sender commands this arm
  kFaultBus = 1u << 15,             // the bus itself: bus-off, error frames, interface down
  kFaultStatus = 1u << 16,          // the arm's status has stopped coming, or is unknown
  kFaultMode = 1u << 17,            // the arm left the mode in which it takes these commands
  kFaultNotStopped = 1u << 18,      // it was told to stop and does not: only the switch is left
};

// "collision, stall"; "none" for 0. `joints`: bit j: joint j + 1's own driver reports one of
// them, "stall (J2)".
std::string ArmFaultNames(uint32_t faults, uint8_t joints = 0);

// One complete, untorn sample. Before the first one sequence is 0 and nothing else holds.
struct ArmSnapshot {
  ArmVector position{};      // joints [rad], gripper opening between the fingers [m]
  ArmVector velocity{};      // [rad/s], gripper 0 where unknown
  ArmVector effort{};        // [Nm] from motor currents; gripper [Nm] as the bus gives it
  int64_t stamp_ns = 0;      // of the oldest joint frame in it, on the client's clock
  uint64_t sequence = 0;     // grows by one per complete sample
  bool enabled = false;      // every joint's driver
  bool has_effort = false;   // effort is measured
  bool taught = false;       // the arm is limp, its weight carried, and a person guides it
  uint32_t faults = 0;       // ArmFault
  uint8_t fault_joints = 0;  // bit j: joint j + 1's driver reports one of them
};

// Absolute targets: joints [rad], gripper opening [m].
struct ArmCommand {
  ArmVector position{};
  double gripper_effort = 1.0;  // [Nm], the most the gripper may press with
};

// What the arm itself allows, read from it at Connect.
struct ArmLimits {
  ArmAxes axes;                  // the others have no limits
  ArmVector lower{};             // joints [rad], gripper [m]
  ArmVector upper{};             // joints [rad], gripper [m]
  ArmVector max_velocity{};      // [rad/s], gripper [m/s]
  ArmVector max_acceleration{};  // [rad/s^2], gripper [m/s^2]
};

// One thread calls everything but Latest, which any thread may call. Nothing here enables, disables
// or stops an arm unless its function is called.
class RobotArm {
 public:
  virtual ~RobotArm() = default;

  // Opens the bus, waits for complete samples, queries firmware and limits. Refuses silence,
  // commands of another sender, unfit limits and unknown firmware; the status says what to do.
  virtual absl::Status Connect() = 0;
  // Enables the joints' drivers (twice where the firmware needs it) and waits until they say so.
  // Only on a person's request. The arm must be told to hold its measured position before and
  // after. Refuses an arm that moves, whose samples are not fresh, or that somebody else commands.
  // `cancelled`, where given, is asked while it waits; true ends it with CANCELLED, and the joints
  // that have power hold.
  virtual absl::Status Enable(const std::function<bool()>& cancelled) = 0;
  absl::Status Enable() { return Enable({}); }
  // Takes power off the joints: the arm FALLS unless it is supported. Only on a person's request.
  virtual absl::Status Disable() = 0;

  // Takes in what has arrived; never blocks, never allocates. Once per control tick, before Latest.
  // A transport with a reader thread of its own has nothing to do here.
  virtual void Poll() = 0;
  // The connection to the arm is gone, and only Reconnect may bring it back.
  virtual bool lost() const { return false; }
  // A person has repaired what broke: connects anew, as at the start, and demands the same arm that
  // can do the same. Nothing moves. Waits, so it is called in IDLE and FAULT only; `cancelled` as
  // for Enable.
  virtual absl::Status Reconnect(const std::function<bool()>&) {
    return absl::UnimplementedError(
        "this arm has no connection that comes back; start the client again");
  }
  // A person has seen the faults and wants to go on. What is over is forgotten: another sender that
  // has been silent for a second, a mode that the arm left. Never blocks.
  virtual void Acknowledge() {}
  // Before the first tick: every complete sample goes to `ring` too, in order, in the thread that
  // polls. A full ring loses samples; their numbers tell. An arm without a bus has none to give.
  virtual void AddSampleReader(SpscRing<ArmSnapshot>*) {}
  // The newest complete sample; never blocks, never allocates.
  virtual ArmSnapshot Latest() const = 0;
  // Position-mode targets; never blocks, never allocates. An error says that nothing may have been
  // sent (a full transmit queue, bus-off); a target beyond limits() is refused, not clamped.
  virtual absl::Status Send(const ArmCommand& command) = 0;
  // The damped stop: the joints brake and the arm sinks slowly. Call every tick while it is wanted.
  // Never blocks, never allocates. Afterwards only Disable and a new Enable bring the arm back.
  virtual absl::Status QuickStop() = 0;

  virtual ArmLimits limits() const = 0;  // valid after Connect
  ArmAxes axes() const { return limits().axes; }
  virtual std::string description() const = 0;  // for records: kind, bus, firmware
  // What QuickStop does to this arm, for the person who asked for it.
  virtual std::string stop_effect() const { return "damped stop: the arm sinks"; }
};

}  // namespace robostress
