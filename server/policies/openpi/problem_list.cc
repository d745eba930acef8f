#include "server/policies/openpi/problem_list.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress::openpi {

absl::Status ProblemList(const std::string& file, const std::string& what,
                         const std::vector<std::string>& problems, const std::string& remedy) {
  if (problems.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      file, ": ", what, ", ", problems.size(), problems.size() == 1 ? " problem" : " problems",
      ":\n  ", absl::StrJoin(problems, "\n  "), "\n", remedy));
}

}  // namespace robostress::openpi
