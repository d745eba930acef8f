// robostress-suites: lists suites, tasks and instructions; draws a contact sheet of first frames.

#include <cstdio>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "nlohmann/json.hpp"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {
namespace {

struct CommandLine {
  std::string suite, sheet;
  bool json = false;
  int size = 128, initial_state = 0, step = 0;
};

void PrintText(const CommandLine& line) {
  for (const SuiteInfo& info : AllSuites()) {
    if (!line.suite.empty() && line.suite != info.name) continue;
    std::printf("%s  (%s, %d tasks, horizon %d, %d initial states%s)\n", info.name.c_str(),
                info.title.c_str(), info.num_tasks, info.horizon, info.num_initial_states,
                info.needs_libero ? ", needs --libero-root" : "");
    const SuiteSpec* spec = FindSuiteSpec(info.name);
    if (spec == nullptr) continue;
    for (size_t i = 0; i < spec->tasks.size(); ++i)
      std::printf("  %zu  %s\n", i, spec->tasks[i].instruction.c_str());
  }
}

void PrintJson(const CommandLine& line) {
  nlohmann::json out = nlohmann::json::array();
  for (const SuiteInfo& info : AllSuites()) {
    if (!line.suite.empty() && line.suite != info.name) continue;
    nlohmann::json suite = {{"name", info.name},
                            {"title", info.title},
                            {"num_tasks", info.num_tasks},
                            {"horizon", info.horizon},
                            {"num_initial_states", info.num_initial_states},
                            {"needs_libero", info.needs_libero}};
    if (const SuiteSpec* spec = FindSuiteSpec(info.name)) {
      for (const TaskSpec& task : spec->tasks) {
        suite["tasks"].push_back(
            {{"name", TaskName(task.instruction)}, {"instruction", task.instruction}});
      }
    }
    out.push_back(suite);
  }
  std::printf("%s\n", out.dump(2).c_str());
}

// A row per suite and view: the first frame of every task, after `step` control steps of the
// expert.
absl::Status WriteSheet(const CommandLine& line) {
  std::vector<Image> rows;
  for (const SuiteInfo& info : AllSuites()) {
    if (info.needs_libero || (!line.suite.empty() && line.suite != info.name)) continue;
    std::vector<Image> views[2];
    for (int i = 0; i < info.num_tasks; ++i) {
      UnitConfig unit;
      unit.suite = info.name;
      RS_ASSIGN_OR_RETURN(const std::unique_ptr<EmbeddedTask> task, EmbeddedTask::Create(unit, i));
      RS_RETURN_IF_ERROR(task->Reset(line.initial_state));
      for (int k = 0; k < line.step && !task->Success(); ++k)
        RS_RETURN_IF_ERROR(task->Step(task->Decide().command));
      RS_ASSIGN_OR_RETURN(Image agent, task->RenderView("agentview", line.size, line.size));
      RS_ASSIGN_OR_RETURN(Image wrist,
                          task->RenderView("robot0_eye_in_hand", line.size, line.size));
      views[0].push_back(std::move(agent));
      views[1].push_back(std::move(wrist));
    }
    for (const auto& row : views) rows.push_back(HStack(row, 2));
  }
  Image sheet = rows.front();
  for (size_t i = 1; i < rows.size(); ++i) {
    sheet.data.insert(sheet.data.end(), rows[i].data.begin(), rows[i].data.end());
    sheet.height += rows[i].height;
  }
  RS_ASSIGN_OR_RETURN(const std::string png, EncodePng(sheet));
  return WriteFileAtomically(line.sheet, png);
}

int Run(const CommandLine& line) {
  if (!line.suite.empty() && FindSuite(line.suite) == nullptr) {
    std::fprintf(stderr, "suites: suite '%s' is unknown; `robostress suites` lists them\n",
                 line.suite.c_str());
    return 2;
  }
  if (!line.sheet.empty()) {
    if (const SuiteInfo* info = FindSuite(line.suite); info != nullptr && info->needs_libero) {
      std::fprintf(stderr,
                   "suites: a sheet can be drawn of the embedded suites only, not of '%s'\n",
                   line.suite.c_str());
      return 2;
    }
    const absl::Status status = WriteSheet(line);
    if (!status.ok()) std::fprintf(stderr, "suites: %s\n", std::string(status.message()).c_str());
    return status.ok() ? 0 : 1;
  }
  line.json ? PrintJson(line) : PrintText(line);
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  CLI::App app("Lists suites, tasks and instructions.", "robostress suites");
  app.footer(
      "\nExamples\n  robostress suites\n  robostress suites --suite tabletop_goal --json\n  "
      "robostress suites --sheet suites.png --size 160\n");
  robostress::CommandLine line;
  app.add_option("--suite", line.suite, "Only this one");
  app.add_flag("--json", line.json, "As JSON");
  app.add_option("--sheet", line.sheet, "Write a PNG with the first frames of all embedded tasks");
  app.add_option("--size", line.size, "Of a view on the sheet [px]")
      ->check(CLI::Range(16, 512))
      ->capture_default_str();
  app.add_option("--initial-state", line.initial_state, "Shown on the sheet")
      ->capture_default_str();
  app.add_option("--step", line.step, "Control steps of the expert before the picture")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  return robostress::Run(line);
}
