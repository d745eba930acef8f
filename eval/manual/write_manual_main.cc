// write_manual: manual pages and bash completions of the programs, from their option tables.

#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "common/joint_errors/scenarios.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/robots.h"
#include "eval/launch/cluster_launchers.h"
#include "eval/manual/bash_completion.h"
#include "eval/manual/manual_page.h"
#include "eval/manual/option_tables.h"

namespace robostress {
namespace {

KnownValues ValuesOfThisBuild() {
  std::vector<std::string> suites, robots, policies(kSuitePolicies.begin(), kSuitePolicies.end());
  for (const SuiteInfo& suite : AllSuites()) suites.push_back(suite.name);
  for (const RobotInfo& robot : AllRobots()) robots.push_back(robot.name);
  policies.emplace_back(kPiperPolicy);
  return {{"--suite", suites},
          {"--suites", suites},
          {"--robot", robots},
          {"--policy", policies},
          {"--policies", policies},
          {"--scenario", ScenarioNames()},
          {"--method", MethodNames()},
          {"--methods", MethodNames()},
          {"--scenarios", ScenarioNames()},
          {"--launcher", LauncherNames()}};
}

absl::Status WriteManual(const std::vector<std::string>& files, const std::string& out) {
  std::vector<CommandTable> tables;
  std::vector<std::string> pages;
  for (const std::string& file : files) {
    RS_ASSIGN_OR_RETURN(CommandTable table, ReadOptionTable(file));
    pages.push_back(PageName(table));
    tables.push_back(std::move(table));
  }
  std::error_code error;
  for (const char* folder : {"/man1", "/completions"})
    std::filesystem::create_directories(out + folder, error);
  const KnownValues known = ValuesOfThisBuild();
  for (const CommandTable& table : tables) {
    const std::string page = PageName(table);
    // A program's page names its own commands' pages and the front door's.
    const std::string family = page.substr(0, page.find('-'));
    std::vector<std::string> others;
    for (const std::string& other : pages) {
      if (page == family ? absl::StartsWith(other, family + "-") : other == family)
        others.push_back(other);
    }
    RS_RETURN_IF_ERROR(
        WriteFileAtomically(absl::StrCat(out, "/man1/", page, ".1"), ManualPage(table, others)));
    std::vector<CommandTable> own;
    for (const CommandTable& other : tables) {
      const std::string name = PageName(other);
      if (name == page || absl::StartsWith(name, page + "-")) own.push_back(other);
    }
    RS_RETURN_IF_ERROR(WriteFileAtomically(absl::StrCat(out, "/completions/", page),
                                           BashCompletion(page, own, known)));
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Writes manual pages and bash completions from option tables.",
                           "write_manual");
  std::vector<std::string> files;
  std::string out;
  app.add_option("--out", out, "Folder: man1/ and completions/ are made in it")->required();
  app.add_option("tables", files, "What programs print with --option-table")->required();
  return robostress::RunMain(app, argc, argv, [&] { return robostress::WriteManual(files, out); });
}
