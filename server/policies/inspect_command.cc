#include "server/policies/inspect_command.h"

#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "server/policies/checkpoint_policies.h"
#include "server/policies/policy_inspect.h"

namespace robostress {
namespace {

constexpr int kProblems = 1;

constexpr char kExamples[] = R"(Examples:
  robostress policy inspect nano
  robostress policy inspect pi05_libero
  robostress policy inspect pi0_base --policy-options transform=piper horizon=50 tokenizer=paligemma_tokenizer.model --json

Exit code 0: it can be served, 1: something is wrong, all of which is listed, 2: bad usage.)";

}  // namespace

PolicyCommand AddInspectCommand(cli::App& policy) {
  struct Arguments {
    std::string path;
    std::vector<std::string> options;
    bool json = false;
  };
  const auto arguments = std::make_shared<Arguments>();
  cli::App* app = policy.add_subcommand(
      "inspect", "Say what a policy is, what it expects, and everything that is wrong with it");
  app->footer("Policy options (robostress_policy.yaml beside the checkpoint, or KEY=VALUE):\n" +
              CheckpointOptionsText() + "\n" + kExamples);
  app->add_option("path", arguments->path,
                  "nano, a weights file, or the folder of a pi0 or pi0.5 checkpoint")
      ->required();
  app->add_option("--policy-options", arguments->options, "KEY=VALUE ...");
  app->add_flag("--json", arguments->json, "print one JSON object");
  return {app, [arguments] {
            const PolicyInspection inspection = InspectPolicy(arguments->path, arguments->options);
            const std::string text =
                arguments->json ? InspectionJson(inspection) : InspectionText(inspection);
            std::fputs(text.c_str(), stdout);
            return inspection.problems.empty() ? 0 : kProblems;
          }};
}

}  // namespace robostress
