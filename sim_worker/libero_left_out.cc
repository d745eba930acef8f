#include "absl/strings/str_cat.h"
#include "common/suites.h"
#include "sim_worker/libero/catalog.h"
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

namespace libero {

absl::StatusOr<std::vector<std::string>> LiberoTaskNames(const std::string& suite) {
  const SuiteInfo* info = FindSuite(suite);
  if (info != nullptr && info->needs_libero) return LeftOut(suite);
  return absl::NotFoundError(absl::StrCat("suite '", suite, "' is unknown"));
}

std::string LiberoInstruction(const std::string&) { return ""; }

}  // namespace libero
}  // namespace robostress
