#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A folder of BDDL files that none of our suites has: LIBERO-90, LIBERO-PRO's, one's own.
struct LiberoTaskFolder {
  std::string path;                // absolute
  std::string real_path;           // the same with symbolic links followed
  std::string suite;               // the folder's name
  std::vector<std::string> tasks;  // its .bddl files without that ending, sorted

  // The name of the folder that a link leads to.
  std::string SuiteOfFiles() const;
};

// NotFound, with the path, where there is no such folder or no .bddl file in it.
absl::StatusOr<LiberoTaskFolder> ReadLiberoTaskFolder(const std::string& folder);

// Where the stored initial states of a task may be, the first that is there counts: beside its BDDL
// file, else, as LIBERO has it, in init_files/SUITE beside bddl_files/SUITE, also of the folder
// that a link leads to; as .pruned_init or .init, with or without .npz (LIBERO-PRO's package). It
// may be one that cannot be read. Empty: nowhere.
std::string InitialStatesOf(const LiberoTaskFolder& folder, const std::string& task);

// What is said where it is empty.
std::string NoInitialStates(const LiberoTaskFolder& folder, const std::string& task);

// SHA-256, hex, of its tasks and their initial states: what two runs in it have to have in common.
absl::StatusOr<std::string> LiberoTasksSha256(const std::string& folder);

}  // namespace robostress
