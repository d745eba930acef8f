// robostress policy SUBCOMMAND: checkpoints of pi0 and pi0.5, and adapters.

#include <cstdio>
#include <string>

#include "common/run_main.h"
#include "nlohmann/json.hpp"
#include "server/policies/adapters/adapter_command.h"
#include "server/policies/inspect_command.h"
#include "server/policies/openpi/checkpoint_commands.h"
#include "server/policies/openpi/policy_check.h"

namespace {

using robostress::openpi::CheckOptions;

constexpr int kFailed = 1, kBadInput = 2;

constexpr char kCheckExamples[] = R"(Examples:
  robostress policy check --weights pi0.weights.safetensors --io pi0.io.safetensors
  robostress policy check --weights pi0.weights.safetensors --io pi0.io.safetensors --lora pi0.lora.safetensors
  robostress policy check --weights pi0.weights_bf16.safetensors --io pi0.io_bf16w.safetensors --json

With --lora, the expected values of the adapter's file are checked instead of those of --io.
Exit code 0: all quantities within tolerance, 1: one is not or is unknown, 2: bad usage or files.)";

void PrintError(const absl::Status& status, bool json) {
  const std::string message(status.message());
  if (json) {
    const nlohmann::ordered_json error = {{"passed", false}, {"error", message}};
    std::printf(
        "%s\n",
        error.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  }
  std::fprintf(stderr, "robostress-policy: %s\n", message.c_str());
}

int RunCheck(const CheckOptions& options, bool json) {
  const auto report = robostress::openpi::CheckPolicy(options);
  if (!report.ok()) {
    PrintError(report.status(), json);
    return kBadInput;
  }
  const std::string text = json ? robostress::openpi::ReportJson(options, *report)
                                : robostress::openpi::ReportText(*report);
  std::fputs(text.c_str(), stdout);
  return report->num_failed() == 0 ? 0 : kFailed;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Inspects policies; checks, loads and generates pi0 and pi0.5 checkpoints; shows, exports, "
      "imports "
      "and merges adapters.",
      "robostress policy"};
  app.require_subcommand(1);
  CLI::App* check = app.add_subcommand(
      "check", "Compare every intermediate of a network with expected values from a file");
  check->footer(kCheckExamples);
  CheckOptions options;
  bool json = false;
  check->add_option("--weights", options.weights, "safetensors file with openpi's tensor names")
      ->required();
  check->add_option("--io", options.io, "file with inputs/* and expected/*")->required();
  check->add_option("--inputs", options.inputs,
                    "file with inputs/* where --io has none (default: CASE.io.safetensors beside "
                    "CASE.io_*.safetensors)");
  check->add_option("--lora", options.lora, "file with lora/* and the expected values with it");
  check->add_flag("--json", json, "print one JSON object");
  const auto commands = {robostress::openpi::AddLoadCommand(app),
                         robostress::openpi::AddGenerateCommand(app),
                         robostress::AddInspectCommand(app)};
  const robostress::AdapterCommand adapter(app);
  return RunMain(app, argc, argv, [&] {
    for (const auto& command : commands) {
      if (command.app->parsed()) return command.run();
    }
    if (adapter.chosen()) return adapter.Run();
    return RunCheck(options, json);
  });
}
