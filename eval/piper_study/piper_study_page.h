#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/piper_study/piper_study.h"
#include "eval/store/run_store.h"

namespace robostress {

// Words of a nano policy's vocabulary that an instruction has and the policy does not.
absl::StatusOr<std::vector<std::string>> UnknownWords(const std::string& weights,
                                                      const std::string& instruction);

// Writes run.dir/tables/, report.html and its kin (eval/report) and report.md: the study's tables,
// what each object variant came to, and which words the policy does not know. Prints the page.
absl::Status WritePiperPage(const std::vector<PiperTablePlan>& plans, const PaperProtocol& protocol,
                            const RunData& run);

}  // namespace robostress
