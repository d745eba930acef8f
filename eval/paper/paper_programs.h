#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/paper/filled_table.h"
#include "eval/paper/paper_table.h"

// Tables whose numbers another program of this repository measures.
namespace robostress {

struct ProgramRequest {
  PaperTable table;  // payload, real-arm, dob, unseen
  std::string out;   // the program's own folder lies in it
  bool full = false;
  int bootstrap_replicates = 4000;
};

// The command that is run, its program first; NotFound when the program is not in this build.
absl::StatusOr<std::vector<std::string>> ProgramCommand(const ProgramRequest& request);

// Runs it to its end with its messages on standard error and reads what it left. What it finished
// before is not repeated. Internal with the exit code when it fails.
absl::StatusOr<FilledTable> RunPaperProgram(const ProgramRequest& request);

// What `robostress fidelity` left in fidelity.json, as a table [mm]. DataLoss names file and field.
absl::StatusOr<FilledTable> PayloadTable(const std::string& json_file);

// Measures the joint-space residual of the emulated arms with `piper_residual` and adds their two
// rows to the residual table; a note instead where the program is not in this build.
absl::Status AddPiperResiduals(int episodes, FilledTable& table);
// The percentages of a profile without payload in what the program prints.
std::optional<double> PiperResidualOf(const std::string& output, const std::string& profile);

}  // namespace robostress
