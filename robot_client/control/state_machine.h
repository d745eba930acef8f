#pragma once

#include <cstdint>

#include "robot_client/control/tick_record.h"
#include "robot_client/control/watchdogs.h"

namespace robostress {

// What a person or the program around the loop may ask for; several at once are worked off in this
// order of precedence, dangerous ones never win over stops.
enum Request : uint32_t {
  kRequestQuickStop = 1u << 0,  // second stage of a stop: the arm sinks, damped
  kRequestHold = 1u << 1,       // first stage: decelerate, hold
  kRequestEnd = 1u << 2,        // the episode is over: decelerate, hold, ENABLED
  kRequestClear = 1u << 3,      // leave FAULT, if its cause is gone; the arm is not enabled by it
  kRequestEnable = 1u << 4,     // IDLE -> ENABLED
  kRequestStart = 1u << 5,      // ENABLED -> RUN: a new episode
  kRequestResume = 1u << 6,     // HOLD -> RUN: the same episode goes on
  kRequestMove = 1u << 7,       // ENABLED -> MOVE: the way that was given to the loop
};

// The states of the client.
//
//   IDLE     nothing is sent
//   ENABLED  the joints have power; the command stands
//   RUN      chunks are played; with nothing to play the command decelerates and stands
//   MOVE     a way of the client's own is played: home, a jog, a demonstration
//   HOLD     the command decelerates and stands; only a person goes on
//   FAULT    latched; nothing is sent: the arm stays at its last target by itself
//
//   IDLE --enable--> ENABLED --start--> RUN --end--> ENABLED
//   RUN --hold request, watchdog--> HOLD --resume--> RUN, HOLD --end--> ENABLED
//   ENABLED --move--> MOVE --arrival, hold request, end--> ENABLED, MOVE --watchdog--> HOLD
//   ENABLED, RUN, MOVE, HOLD --fault--> FAULT --clear--> IDLE
//   any --quick stop--> FAULT, the damped stop repeated every tick
//
// Nothing enables the arm but Enabled(), which the caller calls after a request and a person's
// Enable; nothing here takes its power. A pure function of its inputs, one thread.
class StateMachine {
 public:
  ClientState state() const { return state_; }
  StateCause cause() const { return cause_; }  // of the last change
  bool quick_stop() const { return quick_stop_; }

  // Whether commands are sent.
  bool streaming() const {
    return state_ == ClientState::kEnabled || state_ == ClientState::kRun ||
           state_ == ClientState::kMove || state_ == ClientState::kHold;
  }
  // The state in which an episode, or nothing, was held.
  bool held_in_run() const { return held_in_run_; }

  // One tick. `arm_faults`: the arm's fault bits; a fault is only cleared once they are 0. Returns
  // true when the state changed. kRequestEnable is left to the caller, who enables the arm and
  // calls Enabled.
  bool Advance(uint32_t requests, const WatchdogVerdict& verdict, uint32_t arm_faults);
  void Enabled();  // IDLE -> ENABLED
  void Arrived();  // MOVE -> ENABLED

 private:
  bool Go(ClientState state, StateCause cause);

  ClientState state_ = ClientState::kIdle;
  StateCause cause_ = StateCause::kNone;
  bool quick_stop_ = false;
  bool held_in_run_ = false;
};

}  // namespace robostress
