#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/libero/catalog.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/sim_task.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<SimTask>> MakeSimTask(const UnitConfig& unit, int task) {
  const SuiteInfo* info = FindSuite(unit.suite);
  if (info != nullptr && info->needs_libero) return MakeLiberoTask(unit, task);
  RS_ASSIGN_OR_RETURN(std::unique_ptr<EmbeddedTask> embedded, EmbeddedTask::Create(unit, task));
  return embedded;
}

absl::StatusOr<std::vector<std::string>> SuiteInstructions(const std::string& suite) {
  std::vector<std::string> instructions;
  if (const SuiteSpec* spec = FindSuiteSpec(suite)) {
    for (const TaskSpec& task : spec->tasks) instructions.push_back(task.instruction);
    return instructions;
  }
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, libero::LiberoTaskNames(suite));
  for (const std::string& name : names) instructions.push_back(libero::LiberoInstruction(name));
  return instructions;
}

}  // namespace robostress
