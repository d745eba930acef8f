#include "server/policies/checkpoint_policies.h"

#include <utility>

#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint.h"
#include "server/policies/openpi/checkpoint_commands.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/openpi_policy.h"
#include "server/policies/openpi/policy_options.h"

namespace robostress {
namespace {

// Collects "key  what it means" of every policy option.
struct OptionLister {
  template <class T>
  void Field(const char* key, T&, const char* doc) {
    Add(key, doc);
  }
  template <class E>
  void Choice(const char* key, E&, const std::vector<std::pair<const char*, E>>& choices,
              const char* doc) {
    std::string values;
    for (const auto& [name, value] : choices)
      values += (values.empty() ? "" : "|") + std::string(name);
    Add(key, values + "; " + doc);
  }
  void Add(const char* key, const std::string& doc) {
    text += "  " + std::string(key) + std::string(16 - std::string(key).size(), ' ') + doc + "\n";
  }
  std::string text;
};

}  // namespace

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadCheckpointPolicy(
    const std::string& path, const std::vector<std::string>& options) {
  return openpi::LoadOpenpiPolicy(path, options);
}

absl::Status OpenCheckpointBase(const std::string& path, AdapterBase& base) {
  RS_ASSIGN_OR_RETURN(const openpi::Checkpoint checkpoint, openpi::OpenCheckpoint(path));
  base.targets = openpi::ExpertLoraTargets(checkpoint.config);
  for (const LoraTarget& target : base.targets)
    base.weights.push_back({checkpoint.tensors.at(target.name + ".weight").stored_name});
  return absl::OkStatus();
}

std::string CheckpointOptionsText() {
  OptionLister lister;
  openpi::PolicyOptions().Visit(lister);
  return lister.text;
}

std::vector<PolicyCommand> AddCheckpointCommands(cli::App& policy) {
  std::vector<PolicyCommand> commands;  // in the order of the help
  commands.push_back(openpi::AddCheckCommand(policy));
  commands.push_back(openpi::AddLoadCommand(policy));
  commands.push_back(openpi::AddGenerateCommand(policy));
  return commands;
}

}  // namespace robostress
