#pragma once

#include <cstdint>
#include <limits>

#include "robot_client/control/tick_record.h"
#include "robot_client/robot_arm.h"

namespace robostress {

struct WatchdogOptions {
  double arm_hold_s = 0.05;       // age of the newest complete sample: HOLD
  double arm_fault_s = 0.25;      // FAULT
  double camera_mark_s = 0.15;    // age of a camera's newest frame: marked in the record
  double camera_hold_s = 0.5;     // HOLD; no prediction is asked for
  double server_hold_s = 2.0;     // RUN without a row to play: HOLD
  double first_chunk_s = 10.0;    // the same for an episode's first chunk
  double following_error = 0.35;  // [rad] between the last command and the measured joint ...
  double following_s = 0.5;       // ... for as long as this: HOLD
  int send_hold_ticks = 3;        // commands in a row that the bus did not take: HOLD
  int send_fault_ticks = 15;      // FAULT
  double delay_hold_s = 0.25;     // from a command to its motion in the measurement: HOLD

  template <class V>
  void Visit(V& v) {
    v.Field("arm_hold_s", arm_hold_s, "age of the arm's newest sample at which it is held [s]");
    v.Field("arm_fault_s", arm_fault_s, "age of the arm's newest sample that is a fault [s]");
    v.Field("camera_mark_s", camera_mark_s, "age of a frame that is marked in the record [s]");
    v.Field("camera_hold_s", camera_hold_s, "age of a frame at which the arm is held [s]");
    v.Field("server_hold_s", server_hold_s, "time without a row to play until the arm is held [s]");
    v.Field("first_chunk_s", first_chunk_s, "the same for the first chunk of an episode [s]");
    v.Field("following_error", following_error, "most a joint may be off its command [rad] ...");
    v.Field("following_s", following_s, "... for longer than this [s]");
    v.Field("send_hold_ticks", send_hold_ticks, "commands the bus did not take until it is held");
    v.Field("send_fault_ticks", send_fault_ticks, "commands the bus did not take that are a fault");
    v.Field("delay_hold_s", delay_hold_s, "from a command to its motion in the measurement [s]");
  }
};

// How old the cameras' pictures are, as the control thread asks it.
class CameraStamps {
 public:
  virtual ~CameraStamps() = default;
  // Stamp of the newest picture of the camera that is furthest behind; 0 while one has delivered
  // nothing, INT64_MAX without cameras. Any thread; never waits, never allocates.
  virtual int64_t Oldest() const = 0;
};

class NoCameras : public CameraStamps {
 public:
  int64_t Oldest() const override { return std::numeric_limits<int64_t>::max(); }
};

// A stamp may be this far ahead of the clock: rounding between a driver's time and ours. Further
// ahead it says nothing about its age.
inline constexpr double kMostAhead_s = 0.02;

// What the watchdogs say of one tick. `fault` outranks `hold`.
struct WatchdogVerdict {
  StateCause fault = StateCause::kNone;
  StateCause hold = StateCause::kNone;
  bool camera_late = false;
};

// Watches arm, server and cameras. Allocates nothing. One thread.
class Watchdogs {
 public:
  Watchdogs(const WatchdogOptions& options, double period_s, int joints)
      : options_(options), period_s_(period_s), joints_(joints) {}

  struct Inputs {
    int64_t now_ns = 0;
    ArmSnapshot arm;
    int64_t oldest_camera_ns = 0;            // CameraStamps::Oldest
    bool streaming = false;                  // commands are being sent (ENABLED, RUN, HOLD)
    bool running = false;                    // RUN: rows are expected
    ArmVector command{};                     // the last one sent; joints compared with arm.position
    bool pressing = false, blocked = false;  // PressWatch
    bool guarded = false;                    // the workspace has stopped the command for long
    bool record_failed = false;
    bool policy_invalid = false;
    bool input_silent = false;  // LiveTarget::Silent
    double delay_s = 0;         // DelayEstimator; 0: unknown
  };
  WatchdogVerdict Check(const Inputs& inputs);

  void OnSend(bool taken) { refused_sends_ = taken ? 0 : refused_sends_ + 1; }
  void OnRunStart(int64_t now_ns);  // an episode starts or goes on
  void OnRow(int64_t now_ns);       // a row of a chunk was played

 private:
  const WatchdogOptions options_;
  const double period_s_;
  const int joints_;  // of the arm
  int refused_sends_ = 0;
  double following_s_ = 0;  // for how long the error has been too large
  int64_t last_row_ns_ = 0;
  bool first_chunk_ = true;
};

}  // namespace robostress
