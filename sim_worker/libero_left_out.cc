#include "absl/strings/str_cat.h"
#include "sim_worker/libero/libero_task.h"

// Stands in for libero/ in a build without it.
namespace robostress {
namespace {

absl::Status LeftOut(const std::string& suite) {
  return absl::UnimplementedError(absl::StrCat(
      "suite '", suite, "' needs LIBERO's files, and this build has ROBOSTRESS_LIBERO=OFF"));
}

}  // namespace

absl::StatusOr<std::unique_ptr<SimTask>> MakeLiberoTask(const UnitConfig& unit, int) {
  return LeftOut(unit.suite);
}

absl::StatusOr<int> CountInitialStates(const UnitConfig& unit, int) { return LeftOut(unit.suite); }

absl::Status CheckLiberoFound(const UnitConfig& unit) { return LeftOut(unit.suite); }

absl::Status CheckLiberoTasks(const UnitConfig& unit) { return LeftOut(unit.suite); }

absl::StatusOr<std::vector<LiberoTaskLine>> LiberoTaskLines(const UnitConfig& unit) {
  return LeftOut(unit.suite);
}

}  // namespace robostress
