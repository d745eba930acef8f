#pragma once

#include <string>

#include "common/deferred.h"
#include "common/rpc/policy_client.h"
#include "robot_client/policy_link.h"

namespace robostress {

struct PolicyConnectionOptions {
  std::string server;                 // HOST:PORT
  std::string policy = "nano-piper";  // one that the server holds
  std::string robot = "piper";        // names the arm, decides nothing
  std::string suite = "piper";        // names the experiment; part of the noise key
  std::string scenario = "real";      // names the arm
  int64_t seed = 0;                   // of the sampling noise
  double connect_timeout_s = 5;       // [s] until the server must accept
  double call_timeout_s = 2;          // [s] for any answer; the arm holds long before
  Deferred<MethodOptions> method;
  // Lockstep is for simulated time; it is no field of a configuration, because an arm in real time
  // must never wait for an update.
  ExecutionMode mode = ExecutionMode::kAsync;

  template <class V>
  void Visit(V& v) {
    v.Field("server", server, "HOST:PORT of the policy server");
    v.Field("policy", policy, "one that the server holds");
    v.Field("robot", robot, "names the arm");
    v.Field("suite", suite, "names the experiment, part of the noise key");
    v.Field("scenario", scenario, "names the arm");
    v.Field("seed", seed, "of the policy's sampling noise");
    v.Field("connect_timeout_s", connect_timeout_s, "until the server must accept [s]");
    v.Field("call_timeout_s", call_timeout_s, "for any answer of the server [s]");
    v.Section("method", method, "what the server's session does");
  }
};

// Opens a session, asynchronous unless the options say otherwise: a prediction never waits for an
// update.
PolicyLink::Connect ConnectTo(const PolicyConnectionOptions& options, double control_period_s);

}  // namespace robostress
