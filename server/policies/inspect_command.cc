#include "server/policies/inspect_command.h"

#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "server/policies/openpi/policy_options.h"
#include "server/policies/policy_inspect.h"

namespace robostress {
namespace {

constexpr int kProblems = 1;

constexpr char kExamples[] = R"(Examples:
  robostress policy inspect nano
  robostress policy inspect pi05_libero
  robostress policy inspect pi0_base --policy-options transform=piper horizon=50 tokenizer=paligemma_tokenizer.model --json

Exit code 0: it can be served, 1: something is wrong, all of which is listed, 2: bad usage.)";

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

openpi::PolicyCommand AddInspectCommand(CLI::App& policy) {
  struct Arguments {
    std::string path;
    std::vector<std::string> options;
    bool json = false;
  };
  const auto arguments = std::make_shared<Arguments>();
  OptionLister lister;
  openpi::PolicyOptions().Visit(lister);
  CLI::App* app = policy.add_subcommand(
      "inspect", "Say what a policy is, what it expects, and everything that is wrong with it");
  app->footer("Policy options (robostress_policy.yaml beside the checkpoint, or KEY=VALUE):\n" +
              lister.text + "\n" + kExamples);
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
