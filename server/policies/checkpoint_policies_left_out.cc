#include <cstdio>

#include "absl/strings/str_cat.h"
#include "server/policies/checkpoint_policies.h"

// Stands in for openpi/ in a build without it.
namespace robostress {
namespace {

constexpr char kLeftOut[] = "pi0 and pi0.5 are not in this build, which has ROBOSTRESS_OPENPI=OFF";

absl::Status LeftOut(const std::string& path) {
  return absl::UnimplementedError(absl::StrCat(path, ": is no nano file; ", kLeftOut));
}

}  // namespace

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadCheckpointPolicy(const std::string& path,
                                                                 const std::vector<std::string>&) {
  return LeftOut(path);
}

void InspectCheckpoint(const std::string& path, const std::vector<std::string>&,
                       PolicyInspection& inspection) {
  inspection.problems.emplace_back(LeftOut(path).message());
}

absl::Status OpenCheckpointBase(const std::string& path, AdapterBase&) { return LeftOut(path); }

std::string CheckpointOptionsText() { return absl::StrCat("  none: ", kLeftOut, "\n"); }

std::vector<PolicyCommand> AddCheckpointCommands(cli::App& policy) {
  std::vector<PolicyCommand> commands;
  for (const char* name : {"check", "load", "generate"}) {
    cli::App* app = policy.add_subcommand(name, "(not in this build: ROBOSTRESS_OPENPI=OFF)");
    app->prefix_command();  // whatever follows
    commands.push_back({app, [name] {
                          std::fprintf(stderr, "robostress-policy: no command %s: %s\n", name,
                                       kLeftOut);
                          return 2;
                        }});
  }
  return commands;
}

}  // namespace robostress
