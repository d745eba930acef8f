#include "robot_client/control/tick_record.h"

namespace robostress {

const char* StateName(ClientState state) {
  switch (state) {
    case ClientState::kIdle:
      return "IDLE";
    case ClientState::kEnabled:
      return "ENABLED";
    case ClientState::kRun:
      return "RUN";
    case ClientState::kHold:
      return "HOLD";
    case ClientState::kFault:
      return "FAULT";
    case ClientState::kMove:
      return "MOVE";
  }
  return "";
}

const char* CauseName(StateCause cause) {
  switch (cause) {
    case StateCause::kNone:
      return "none";
    case StateCause::kOperator:
      return "operator";
    case StateCause::kEpisodeEnd:
      return "episode_end";
    case StateCause::kArmSilent:
      return "arm_silent";
    case StateCause::kArmFault:
      return "arm_fault";
    case StateCause::kArmDisabled:
      return "arm_disabled";
    case StateCause::kServerSilent:
      return "server_silent";
    case StateCause::kCameraStale:
      return "camera_stale";
    case StateCause::kFollowingError:
      return "following_error";
    case StateCause::kSendFailed:
      return "send_failed";
    case StateCause::kNotFinite:
      return "not_finite";
    case StateCause::kQuickStop:
      return "quick_stop";
    case StateCause::kEnableFailed:
      return "enable_failed";
    case StateCause::kArrived:
      return "arrived";
    case StateCause::kPressing:
      return "pressing";
    case StateCause::kBlocked:
      return "blocked";
    case StateCause::kWorkspace:
      return "workspace";
    case StateCause::kDelayed:
      return "delayed";
    case StateCause::kPolicyInvalid:
      return "policy_invalid";
    case StateCause::kRecordFailed:
      return "record_failed";
    case StateCause::kInputSilent:
      return "input_silent";
  }
  return "";
}

}  // namespace robostress
