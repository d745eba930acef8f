#pragma once

#include <string>
#include <vector>

#include "common/wire/openpi_dialect.h"

namespace robostress {

// What is asked of a policy that somebody else serves. It says nothing of itself that can be relied
// on, so that what a policy of ours declares stands here.
struct RemotePolicyOptions {
  OpenpiDialect dialect;  // without a name: there is no remote policy
  // The simulator's, in the dialect's order; none: the policy is shown no picture.
  std::vector<std::string> cameras = {"agentview", "robot0_eye_in_hand"};
  int image_size = 224;  // [px] of the views, which are square
  int state_dim = 8, action_dim = 7;
  int execute_steps = 5;
  // Of the noise, where the dialect has a key for it: [noise_rows, noise_cols].
  int noise_rows = 0, noise_cols = 0;

  bool used() const { return !dialect.name.empty(); }

  template <class V>
  void Visit(V& v) {
    v.Section("dialect", dialect, "keys of the server's messages");
    v.Field("cameras", cameras, "the simulator's, in the dialect's order");
    v.Field("image_size", image_size, "of the views [px]");
    v.Field("state_dim", state_dim, "numbers of the state");
    v.Field("action_dim", action_dim, "numbers of an action");
    v.Field("execute_steps", execute_steps, "actions of a chunk that are executed");
    v.Field("noise_rows", noise_rows, "of the noise, where the dialect has a key for it");
    v.Field("noise_cols", noise_cols, "of the noise, where the dialect has a key for it");
  }
};

}  // namespace robostress
