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

void StateMachine::Fail(StateCause cause) { Go(ClientState::kFault, cause); }

bool StateMachine::Advance(uint32_t requests, const WatchdogVerdict& verdict, uint32_t arm_faults) {
  if ((requests & kRequestQuickStop) && !quick_stop_) {
    quick_stop_ = true;
    return Go(ClientState::kFault, StateCause::kQuickStop);
  }
  const bool streaming = state_ == ClientState::kEnabled || state_ == ClientState::kRun ||
                         state_ == ClientState::kHold;
  if (streaming && verdict.fault != StateCause::kNone)
    return Go(ClientState::kFault, verdict.fault);

  switch (state_) {
    case ClientState::kIdle:
      return false;
    case ClientState::kEnabled:
      if (requests & (kRequestHold | kRequestEnd)) return false;
      if ((requests & kRequestStart) && verdict.hold == StateCause::kNone)
        return Go(ClientState::kRun, StateCause::kOperator);
      return false;
    case ClientState::kRun:
      if (requests & kRequestHold) return Go(ClientState::kHold, StateCause::kOperator);
      if (verdict.hold != StateCause::kNone) return Go(ClientState::kHold, verdict.hold);
      if (requests & kRequestEnd) return Go(ClientState::kEnabled, StateCause::kEpisodeEnd);
      return false;
    case ClientState::kHold:
      if (requests & kRequestEnd) return Go(ClientState::kEnabled, StateCause::kEpisodeEnd);
      if (requests & kRequestHold) return false;
      if ((requests & kRequestResume) && verdict.hold == StateCause::kNone)
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
