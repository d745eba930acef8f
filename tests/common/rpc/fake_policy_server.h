#pragma once

#include <memory>
#include <string>

#include "common/rollout/policy_endpoint.h"

namespace robostress {

struct FakeServerOptions {
  PolicySpec spec;                 // of the only policy it serves
  bool answer_predictions = true;  // false: Predict hangs
  int fail_predict_at =
      0;  // n > 0: the n-th prediction of the server's life ends the stream with INTERNAL
  int wrong_horizon = 0;  // n > 0: predictions have n rows
  bool joint_targets =
      false;             // predicts absolute joint targets that sway about the joints observed
  double predict_s = 0;  // every prediction takes this long
  int lose_ack_of =
      0;  // n > 0: the feedback stream ends after chunk n is in, before it is acknowledged
  std::string host = "127.0.0.1";  // listens on
  int port = 0;                    // 0: a free one
};

// A small PolicySpec: no cameras, state_dim 2, action_dim 3, horizon 4, execute_steps 2, adaptable.
PolicySpec FakeSpec();

// Speaks robostress.v1, on a free port of the loopback interface unless told otherwise. Its
// "policy" is arithmetic: actions are a function of (seed, task, episode, chunk, proprioception)
// plus a bias, and every second executed chunk from the fourth after a change of task on moves the
// bias by a function of the buffered chunks. So two sessions agree exactly when they saw the same
// feedback, which is what the tests of resuming need.
class FakePolicyServer {
 public:
  explicit FakePolicyServer(FakeServerOptions options);
  ~FakePolicyServer();
  std::string address() const;
  int open_sessions() const;
  int predictions() const;
  int feedback_chunks() const;  // taken in, of all sessions

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
