#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/robot_arm.h"

// The bytes between the client and a driver process, version 1. README.md is their description for
// whoever writes a driver. Little endian; stamps are CLOCK_MONOTONIC [ns] of this machine, which
// both ends read. Values are in the driver's own units.
namespace robostress::bridge {

inline constexpr uint8_t kVersion = 1;
inline constexpr size_t kHeaderBytes = 16;
inline constexpr size_t kMostPayload = 4096;
inline constexpr double kMostValue = 1e6;  // of a measured value, in any unit

enum class FrameKind : uint8_t {
  kHello = 1,    // client, JSON: who it is and which axes it drives
  kWelcome = 2,  // driver, JSON: who it is and what it can do
  kRefusal = 3,  // driver, JSON {"reason"}: then it closes the connection
  kState = 4,    // driver, at its own rate: StateFrame
  kCommand = 5,  // client, every control tick: CommandFrame
  kBye = 6,      // either: the end, on purpose; no payload
};

struct FrameHeader {
  FrameKind kind = FrameKind::kBye;
  uint16_t size = 0;      // of the payload [bytes]
  uint64_t sequence = 0;  // of the sender, grows from frame to frame
};

enum StateFlag : uint32_t {
  kPowered = 1u << 0,  // every joint has power
  kTaking = 1u << 1,  // targets are obeyed: since kEnable, until it held, stopped or took the power
  kHeld = 1u << 2,    // the driver held by itself: the client was silent
  kStopped = 1u << 3,  // kStop was obeyed
};

struct StateFrame {
  int64_t stamp_ns = 0;    // when the positions were measured
  int64_t sent_ns = 0;     // when the frame was written
  uint64_t command = 0;    // sequence of the newest command that was taken; 0: none
  int64_t command_ns = 0;  // when that was
  uint32_t flags = 0;      // StateFlag
  uint32_t faults = 0;     // ArmFault
  int axes = 0;            // values in each of the three
  ArmVector position{}, velocity{}, effort{};  // by place on the wire
};

enum class CommandMode : uint32_t {
  kHeartbeat = 0,    // the client lives; nothing else
  kTarget = 1,       // positions are the new target
  kEnable = 2,       // power, hold where the arm stands, obey targets from now on
  kPowerOff = 3,     // take the power off: the arm may fall
  kStop = 4,         // the fastest stop there is; obey no target until kEnable
  kAcknowledge = 5,  // a person has seen the faults: forget those that are over
};

struct CommandFrame {
  int64_t stamp_ns = 0;  // when it was made: a driver obeys none that is old
  uint64_t state = 0;    // sequence of the newest state that the client has
  CommandMode mode = CommandMode::kHeartbeat;
  double gripper_effort = 0;  // [Nm], the most the gripper may press with
  int axes = 0;
  ArmVector position{};  // by place on the wire
};

inline constexpr size_t kStateBytes = 40;    // and 24 an axis
inline constexpr size_t kCommandBytes = 32;  // and 8 an axis
inline constexpr size_t kMostFrame = kHeaderBytes + kStateBytes + 24 * kMostAxes;

// Writes the frame to `out`; the number of bytes. Allocates nothing.
size_t EncodeState(const StateFrame& state, uint64_t sequence,
                   std::array<uint8_t, kMostFrame>& out);
size_t EncodeCommand(const CommandFrame& command, uint64_t sequence,
                     std::array<uint8_t, kMostFrame>& out);
void EncodeHeader(const FrameHeader& header, uint8_t* out);  // kHeaderBytes
// A frame with a text.
std::vector<uint8_t> EncodeText(FrameKind kind, uint64_t sequence, const std::string& text);

enum class Decoded : uint8_t {
  kFrame,      // it was read
  kMore,       // its end has not come yet
  kMagic,      // the stream does not begin with a frame
  kVersion,    // of another version of this protocol
  kKind,       // a kind that version 1 does not have
  kLength,     // longer than its kind may be
  kNotFinite,  // a value that is no number, or beyond kMostValue
};
const char* DecodedName(Decoded decoded);

// The header at the front of `data`. Allocates nothing.
Decoded DecodeHeader(const uint8_t* data, size_t size, FrameHeader& header);
// The payload of a state frame with `axes` values in each of the three.
Decoded DecodeState(const uint8_t* payload, size_t size, int axes, StateFrame& state);
Decoded DecodeCommand(const uint8_t* payload, size_t size, int axes, CommandFrame& command);

// What a driver does where its client is silent, or gone.
enum class OnSilence : uint8_t { kHold, kStop, kPowerOff, kNothing };
const char* OnSilenceName(OnSilence on_silence);

// What a driver says of an axis's numbers: "radians", "degrees", "metres"; or a range, of which
// these are the ends; or nothing.
struct SaidUnit {
  std::string name;
  std::vector<double> range;
  bool operator==(const SaidUnit& other) const {
    return name == other.name && range == other.range;
  }
};

// What a driver says of itself; nothing is assumed that it does not say.
struct Welcome {
  int protocol = 0;
  std::string driver;              // program and version
  std::string robot;               // as the driver calls it
  std::vector<std::string> axes;   // names, in the order of the wire
  std::vector<SaidUnit> units;     // by place
  bool stop = false;               // it has a stop that is more than holding
  bool hold = false;               // the arm keeps its place when no target comes
  bool torque_off = false;         // it can take the power off
  bool measures_velocity = false;  // else velocities on the wire mean nothing
  bool measures_effort = false;    // [Nm]
  bool monotonic = false;          // stamps are CLOCK_MONOTONIC; else the client's own are used
  bool simulated = false;          // nobody can be hurt
  OnSilence on_silence = OnSilence::kNothing;
  double watchdog_s = 0;  // ... after so long [s]; 0: never
  double state_hz = 0;    // of its states
  std::string note;       // what a person should know, one line
};

// INVALID_ARGUMENT names field and value.
absl::StatusOr<Welcome> ParseWelcome(const std::string& json);
std::string HelloText(const std::string& robot, const std::vector<std::string>& axes, bool gripper,
                      double rate_hz);
// The reason of a refusal; of a text without one, the text.
std::string ParseRefusal(const std::string& json);

}  // namespace robostress::bridge
