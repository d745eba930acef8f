#pragma once

#include <cstdint>
#include <limits>

#include "robot_client/robot_arm.h"

namespace robostress {

enum class ClientState : uint8_t { kIdle, kEnabled, kRun, kHold, kFault, kMove };

// Why the client last changed its state, or why it does not run.
enum class StateCause : uint8_t {
  kNone,
  kOperator,        // a request
  kEpisodeEnd,      // the episode was ended
  kArmSilent,       // no complete sample for too long
  kArmFault,        // ArmSnapshot::faults
  kArmDisabled,     // a joint's driver lost its enable
  kServerSilent,    // no usable chunk for too long
  kCameraStale,     // a camera's newest frame is too old
  kFollowingError,  // the arm does not go where it is sent
  kSendFailed,      // the bus takes no commands
  kNotFinite,       // a measured or computed value is not finite
  kQuickStop,       // the second stage of a stop
  kEnableFailed,
  kArrived,        // a motion of the client's own is over
  kPressing,       // a joint's torque is beyond what its motion needs
  kBlocked,        // a joint stands still off its command
  kWorkspace,      // the way leads into the table, out of the box or into the arm itself
  kDelayed,        // commands reach the arm, or its measurements the client, too late
  kPolicyInvalid,  // the policy's actions are not finite or not of its shape
  kRecordFailed,   // the run can no longer be recorded
  kInputSilent,    // a leader arm, keyboard or gamepad that is not heard any more
};

const char* StateName(ClientState state);
const char* CauseName(StateCause cause);

// Bits of TickRecord::flags.
enum TickFlag : uint32_t {
  kTickPlayed = 1u << 0,       // a row of a chunk was the target
  kTickEntered = 1u << 1,      // the first tick of a chunk
  kTickFading = 1u << 2,       // the cross-fade moved the target
  kTickOverrun = 1u << 3,      // a row beyond n_exec: the next chunk is late
  kTickStarved = 1u << 4,      // RUN without a row: decelerating or holding
  kTickObserver = 1u << 5,     // the disturbance observer corrected the target
  kTickLimited = 1u << 6,      // the limiter moved the command; which bound: limiter
  kTickSent = 1u << 7,         // the arm took the command
  kTickFresh = 1u << 8,        // a new sample of the arm since the last tick
  kTickRequested = 1u << 9,    // a prediction was asked for
  kTickCameraLate = 1u << 10,  // a camera's frame is older than its mark
  kTickRejected = 1u << 11,    // a chunk was refused
  kTickLost = 1u << 12,        // records before this one were dropped: a reader was too slow
  kTickRelaxed = 1u << 13,     // the command goes back to where the arm stands
  kTickGuarded = 1u << 14,     // the workspace stopped the command
  kTickLive = 1u << 15,        // a live target was followed: policy and requested hold it
  kTickJoining = 1u << 16,     // ... on the way to it, since the motion began
  kTickTaught = 1u << 17,      // a person guides the arm: ArmSnapshot::taught
};

// Everything of one control tick. Fixed size: it is passed between threads without allocation.
struct TickRecord {
  ArmAxes axes;  // of its vectors
  uint64_t tick = 0;
  int64_t due_ns = 0;    // the deadline on which it should have started
  int64_t start_ns = 0;  // when it did
  int64_t sent_ns = 0;   // when the command had been handed to the arm
  ClientState state = ClientState::kIdle;
  StateCause cause = StateCause::kNone;
  uint8_t limiter = 0;       // LimiterFlag
  uint32_t flags = 0;        // TickFlag
  uint32_t faults = 0;       // ArmFault
  uint8_t fault_joints = 0;  // ArmSnapshot::fault_joints
  int32_t episode = -1;      // counts starts of an episode; -1 before the first
  int32_t chunk = -1;        // index within the episode of the chunk played, -1: none
  int32_t row = -1;          // row of it
  uint64_t prediction_id = 0;
  ArmVector policy{};     // the policy's target before any correction (with kTickPlayed or Live)
  ArmVector requested{};  // the server's: with its own gain or direct correction (with kTickPlayed)
  ArmVector blended{};    // after the cross-fade, or what is held
  ArmVector corrected{};  // after the disturbance observer
  ArmVector sent{};       // after the limiter
  ArmVector position{}, velocity{}, effort{};                 // measured at the start of the tick
  ArmVector excess{};                                         // of effort beyond the model [Nm]
  double delay_s = std::numeric_limits<double>::quiet_NaN();  // estimated; NaN: unknown
  int64_t stamp_ns = 0;                                       // of that measurement
  uint64_t sequence = 0;                                      // of that measurement
};

}  // namespace robostress
