#include "eval/paper/piper_tables.h"

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/scenario_file.h"
#include "common/suites.h"

namespace robostress {
namespace {

constexpr char kProgram[] = "piper-study";

PaperTable TableOf(const std::string& name) {
  PaperTable table;
  table.name = name;
  table.program = kProgram;
  return table;
}

void AddSuite(PaperTable& table, const std::string& suite, int number) {
  table.suites.push_back(suite);
  table.row_keys.push_back(absl::StrCat(number));
}

// Columns of an arm, each but the first compared with the first.
void AddColumns(PaperTable& table, const PiperArmColumn& arm,
                const std::vector<PaperColumn>& columns) {
  const int first = static_cast<int>(table.columns.size());
  for (PaperColumn column : columns) {
    column.scenario = arm.scenario;
    column.group = arm.title;
    if (static_cast<int>(table.columns.size()) > first)
      table.contrasts.push_back({static_cast<int>(table.columns.size()), first});
    table.columns.push_back(column);
  }
}

const PaperColumn kBaseColumn{"Base", PolicyRole::kBase, "base"};
const PaperColumn kRobustColumn{"RobustVLA", PolicyRole::kRobust, "base"};
const PaperColumn kOursColumn{"Ours", PolicyRole::kBase, "ours"};

}  // namespace

std::vector<PiperArmColumn> PiperArms(const std::vector<std::string>& scenarios) {
  std::vector<PiperArmColumn> arms;
  for (const std::string& scenario : scenarios) {
    const char letter = static_cast<char>('A' + arms.size());
    // As a unit names it.
    const std::string arm = IsScenarioFile(scenario)
                                ? std::filesystem::absolute(scenario).lexically_normal().string()
                                : scenario;
    arms.push_back({arm, absl::StrCat("emulated Robot ", std::string(1, letter))});
  }
  return arms;
}

PaperTable RealArmTable(const std::vector<PiperArmColumn>& arms, const std::vector<int>& tasks) {
  PaperTable table = TableOf("real-arm");
  const std::vector<std::string> suites = SuitesOf("piper");
  for (const int task : tasks) AddSuite(table, suites.at(static_cast<size_t>(task - 1)), task);
  table.with_average = true;
  for (const PiperArmColumn& arm : arms)
    AddColumns(table, arm, {kBaseColumn, kRobustColumn, kOursColumn});
  return table;
}

PaperTable ObserverTable(const PiperArmColumn& arm, int task) {
  PaperTable table = TableOf("dob");
  AddSuite(table, SuitesOf("piper").at(static_cast<size_t>(task - 1)), task);
  AddColumns(table, arm,
             {kBaseColumn,
              {"DOB", PolicyRole::kBase, "dob"},
              kOursColumn,
              {"DOB+Ours", PolicyRole::kBase, "dob_ours"}});
  return table;
}

PaperTable UnseenTable(const PiperArmColumn& arm) {
  PaperTable table = TableOf("unseen");
  AddSuite(table, SuitesOf("piper").back(), 1);
  AddColumns(table, arm, {kBaseColumn, kRobustColumn, kOursColumn});
  return table;
}

PaperProtocol PiperProtocol(const std::string& folder) {
  const auto weights = [&](const char* name) {
    return std::filesystem::absolute(absl::StrCat(folder, "/train/", name, ".safetensors"))
        .lexically_normal()
        .string();
  };
  PaperProtocol protocol;
  protocol.grid.robot = "piper";
  protocol.grid.episodes = 25;
  protocol.base = weights("piper-base");
  protocol.robust = weights("piper-robust");
  protocol.cloning.clear();
  protocol.randomised.clear();
  return protocol;
}

}  // namespace robostress
