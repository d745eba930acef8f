#include "common/status_macros.h"
#include "common/suites.h"
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

absl::StatusOr<std::vector<std::string>> SuiteInstructions(const UnitConfig& unit) {
  std::vector<std::string> instructions;
  if (const SuiteSpec* spec = FindSuiteSpec(unit.suite)) {
    for (const TaskSpec& task : spec->tasks) instructions.push_back(task.instruction);
    return instructions;
  }
  RS_ASSIGN_OR_RETURN(const std::vector<LiberoTaskLine> tasks, LiberoTaskLines(unit));
  for (const LiberoTaskLine& task : tasks) {
    RS_RETURN_IF_ERROR(task.read);
    instructions.push_back(task.instruction);
  }
  return instructions;
}

}  // namespace robostress
