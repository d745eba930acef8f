#pragma once

#include <string>

#include "absl/status/status.h"

namespace robostress {

// A processor as far as results can depend on it: BLAS, oneDNN and the renderer's compiler choose
// their kernels by its family and by its instruction sets.
struct ProcessorKind {
  std::string model;  // "Intel(R) Xeon(R) Platinum 8481C"; "unknown"
  std::string isa;    // the vector and matrix instruction sets, sorted: "avx avx2 avx512f fma"
  std::string Text() const;
};

// This machine's; of `cpuinfo`, a text in the form of /proc/cpuinfo, for tests.
ProcessorKind ThisProcessor();
ProcessorKind ParseProcessor(const std::string& cpuinfo);

// Adds to `unit_folder`/machines.jsonl, once, the machines that work on a unit: the worker's and
// its policy server's ("" where none serves, "unknown" for one that runs elsewhere).
absl::Status RecordMachines(const std::string& unit_folder, const std::string& worker,
                            const std::string& server);

}  // namespace robostress
