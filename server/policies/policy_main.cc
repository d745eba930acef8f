// robostress policy SUBCOMMAND: checkpoints of pi0 and pi0.5, and adapters.

#include "common/run_main.h"
#include "server/policies/adapters/adapter_command.h"
#include "server/policies/checkpoint_policies.h"
#include "server/policies/inspect_command.h"

int main(int argc, char** argv) {
  robostress::cli::App app{
      "Inspects policies; checks, loads and generates pi0 and pi0.5 checkpoints; shows, exports, "
      "imports "
      "and merges adapters.",
      "robostress policy"};
  app.require_subcommand(1);
  std::vector<robostress::PolicyCommand> commands = robostress::AddCheckpointCommands(app);
  commands.push_back(robostress::AddInspectCommand(app));
  const robostress::AdapterCommand adapter(app);
  return robostress::RunMain(app, argc, argv, [&] {
    for (const robostress::PolicyCommand& command : commands) {
      if (command.app->parsed()) return command.run();
    }
    return adapter.Run();
  });
}
