#include "robot_client/control/state_machine.h"

namespace robostress {

bool StateMachine::Go(ClientState state, StateCause cause) {
  state_ = state;
  cause_ = cause;
  return true;
}

void StateMachine::Enabled() {
  if (state_ == ClientState::kIdle) Go(ClientState::kEnabled, StateCause::kOperator);
}

void StateMachine::Arrived() {
  if (state_ == ClientState::kMove) Go(ClientState::kEnabled, StateCause::kArrived);
}

bool StateMachine::Advance(uint32_t requests, const WatchdogVerdict& verdict, uint32_t arm_faults) {
  if ((requests & kRequestQuickStop) && !quick_stop_) {
    quick_stop_ = true;
    return Go(ClientState::kFault, StateCause::kQuickStop);
  }
  if (streaming() && verdict.fault != StateCause::kNone)
    return Go(ClientState::kFault, verdict.fault);

  switch (state_) {
    case ClientState::kIdle:
      return false;
    case ClientState::kEnabled:
      if (requests & (kRequestHold | kRequestEnd)) return false;
      if ((requests & kRequestStart) && verdict.hold == StateCause::kNone)
        return Go(ClientState::kRun, StateCause::kOperator);
      if ((requests & kRequestMove) && verdict.hold == StateCause::kNone)
        return Go(ClientState::kMove, StateCause::kOperator);
      return false;
    case ClientState::kMove:
      held_in_run_ = false;
      if (requests & (kRequestHold | kRequestEnd))
        return Go(ClientState::kEnabled, StateCause::kOperator);
      if (verdict.hold != StateCause::kNone) return Go(ClientState::kHold, verdict.hold);
      return false;
    case ClientState::kRun:
      held_in_run_ = true;
      if (requests & kRequestHold) return Go(ClientState::kHold, StateCause::kOperator);
      if (verdict.hold != StateCause::kNone) return Go(ClientState::kHold, verdict.hold);
      if (requests & kRequestEnd) return Go(ClientState::kEnabled, StateCause::kEpisodeEnd);
      return false;
    case ClientState::kHold:
      if (requests & kRequestEnd) return Go(ClientState::kEnabled, StateCause::kEpisodeEnd);
      if (requests & kRequestHold) return false;
      if ((requests & kRequestResume) && held_in_run_ && verdict.hold == StateCause::kNone)
        return Go(ClientState::kRun, StateCause::kOperator);
      return false;
    case ClientState::kFault:
      if ((requests & kRequestClear) && arm_faults == 0) {
        quick_stop_ = false;
        return Go(ClientState::kIdle, StateCause::kOperator);
      }
      return false;
  }
  return false;
}

}  // namespace robostress
