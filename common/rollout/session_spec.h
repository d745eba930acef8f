#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/deferred.h"
#include "common/rollout/policy_endpoint.h"
#include "common/unit_config.h"

namespace robostress {

struct MethodOptions;  // adapter/method_options.h

enum class ExecutionMode { kLockstep, kAsync };

// Everything that decides what a session computes but its method.
struct SessionSetting {
  std::string robot = "panda_sim";  // a name, decides nothing
  std::string suite;                // part of the noise key
  std::string scenario;             // names the session, part of no noise key
  int severity = 5;                 // 1..5; names the session, part of no noise key
  std::string policy;               // "nano"
  int64_t seed = 0;                 // of the sampling noise; part of the noise key
  ExecutionMode mode = ExecutionMode::kLockstep;
  ControlSpace control_space =
      ControlSpace::kUnspecified;  // of the robot; unspecified: the policy's
  GoalReference goal_reference = GoalReference::kAchieved;
  double control_period_s = 0.05;   // [s]
  double translation_scale = 0.05;  // of action entries 0..2 [m]
  double rotation_scale = 0.5;      // of action entries 3..5 [rad]
};

// What a client asks for: equal requests, observations and feedback give equal bits.
struct RequestedSession : SessionSetting {
  std::string method_yaml = "method: base\n";  // adapter/methods.h reads it
};

// The same with its method read: what a server computes from (server/sessions/read_spec.h).
struct SessionSpec : SessionSetting {
  Deferred<MethodOptions> method;
};

// Whose predictions go first when several wait.
enum class Priority { kUnspecified, kSimulation, kRobot };  // unspecified: by the mode

// How a session's predictions are served; decides no result.
struct SessionScheduling {
  Priority priority = Priority::kUnspecified;
  int deadline_ms = 0;  // of a prediction, from its arrival; 0: none. Async only
};

// Of an open session, whose space is specified.
inline bool ActsInJointSpace(const SessionSetting& setting) {
  return setting.control_space == ControlSpace::kJoint;
}

// What a server holds.
struct ServerInfo {
  std::string version;
  std::vector<PolicySpec> policies;
  int open_sessions = 0;
  int max_sessions = 0;
  int inference_threads = 0;
  bool durable = false;  // acknowledged feedback survives the server
  std::string instance;  // of this start of the server
  bool draining = false;
};

// A session's adaptation as a safetensors file: LoRA, Adam, feedback buffer, counters.
struct AdapterState {
  std::string safetensors;
  uint64_t feedback_sequence = 0;  // watermark it includes
  uint64_t updates_applied = 0;
};

}  // namespace robostress
