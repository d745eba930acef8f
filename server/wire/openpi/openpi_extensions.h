#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "common/wire/openpi_value.h"

// Our extensions of openpi's wire, under keys of their own; its clients send none of them.
namespace robostress {

// "session": the SessionSpec's fields by name; `method` a name, `method_options` a list of
// "key=value" over that method's. What is absent stays as in `defaults`. Unknown keys are refused,
// but for `resize`.
absl::StatusOr<SessionSpec> ReadOpenpiSession(const OpenpiValue& session,
                                              const SessionSpec& defaults);
// "session/resume".
struct OpenpiResume {
  std::string id, token;
};
absl::StatusOr<OpenpiResume> ReadOpenpiResume(const OpenpiValue& session);
// "session/resize": whether views of other sizes than the policy's are resized. It is the
// connection's, not the session's: a session learns from what it was given.
absl::StatusOr<bool> ReadOpenpiResize(const OpenpiValue& session, bool fallback);

// "executed": what the robot did with a part of an earlier reply, n >= 1 steps.
struct OpenpiExecuted {
  uint64_t sequence = 0;       // 1, 2, 3 ...; repeated after a lost reply
  uint64_t prediction_id = 0;  // reply's adapter/prediction_id
  int first_step = 0;
  std::vector<RobotState> states;  // [n + 1]
  Eigen::MatrixXf sent_commands;   // [n, action_dim]; 0 x 0: the reply's rows as they were
  bool last_of_episode = false;
};
// Keys: sequence, prediction_id, first_step, last_of_episode, sent_commands [n, action_dim], and
// per state, rows in time: stamp_s [n+1] s, q [n+1, dof] rad, dq [n+1, dof] rad/s, p_base_tool
// [n+1, 3] m, q_base_tool [n+1, 4] w x y z, gripper [n+1] m. Absent: dq zero, stamps one control
// period apart, pose and gripper zero (joint-space robots need neither). n is at most the policy's
// horizon.
absl::StatusOr<OpenpiExecuted> ReadOpenpiExecuted(const OpenpiValue& executed,
                                                  const PolicySpec& policy,
                                                  double control_period_s);

// "running": {actions [n, action_dim], held}: PredictRequest.running of policy.proto.
absl::StatusOr<RunningRows> ReadOpenpiRunning(const OpenpiValue& running, const PolicySpec& policy);

}  // namespace robostress
