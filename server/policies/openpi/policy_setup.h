#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/policies/openpi/checkpoint.h"
#include "server/policies/openpi/normalisation.h"
#include "server/policies/openpi/policy_options.h"
#include "server/policies/openpi/prompt.h"
#include "server/policies/openpi/transforms.h"

namespace robostress::openpi {

// Everything that is decided before and after the network: options and checkpoint, with no "auto"
// left.
struct PolicySetup {
  RobotTransform robot;       // its cameras, state_dim and action_dim as they will be
  bool delta = false;         // of robot.delta_dims leading action entries
  NormStats stats;            // as found
  Normaliser state, actions;  // environment <-> network
  NormConvention convention = NormConvention::kOpenpi;
  PromptFormat prompt = PromptFormat::kText;
  bool prompt_has_padded_state = false;  // LeRobot discretises the state after padding it
  int64_t prompt_tokens = 0;
  ResizeFilter resize = ResizeFilter::kPillow;
  int64_t execute_steps = 0;
  int64_t euler_steps = 0;
  std::string tokenizer;  // path
};

// A setup as far as it could be decided, and why it cannot be used. All problems at once.
struct SetupResult {
  PolicySetup setup;
  std::vector<std::string> problems;
};

// What the options say of the network itself.
CheckpointOptions NetworkOptions(const PolicyOptions& options);

// Reads norm stats and looks for the tokenizer; takes no memory for weights.
SetupResult ResolveSetup(const Checkpoint& checkpoint, const PolicyOptions& options);

}  // namespace robostress::openpi
