#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/policies/adapters/adapter_base.h"
#include "server/policies/policy.h"
#include "server/policies/policy_command.h"
#include "server/policies/policy_inspect.h"

// Checkpoints of pi0 and pi0.5, as the rest of policies/ sees them: openpi/checkpoint_policies.cc.
// With ROBOSTRESS_OPENPI=OFF checkpoint_policies_left_out.cc stands in for openpi/, and every
// function says so.
namespace robostress {

// `path`: a folder, a .safetensors file or an index. `options`: KEY=VALUE of openpi's
// PolicyOptions.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadCheckpointPolicy(
    const std::string& path, const std::vector<std::string>& options);

// Adds what the checkpoint is and expects, and what is wrong with it.
void InspectCheckpoint(const std::string& path, const std::vector<std::string>& options,
                       PolicyInspection& inspection);

// Expert's linear layers of a checkpoint of one file. Sets targets and weights.
absl::Status OpenCheckpointBase(const std::string& path, AdapterBase& base);

// "  key             what it means\n" of every policy option.
std::string CheckpointOptionsText();

// check, load and generate.
std::vector<PolicyCommand> AddCheckpointCommands(cli::App& policy);

}  // namespace robostress
