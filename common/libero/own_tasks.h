#pragma once

#include <array>
#include <string>
#include <string_view>

#include "absl/types/span.h"

namespace robostress {

// One of LIBERO's own four suites, its tasks in the benchmark's order (task_order_index 0; LIBERO
// 8f1084e, libero/libero/benchmark/libero_suite_task_map.py).
struct LiberosOwnSuite {
  std::string_view suite;
  std::array<std::string_view, 10> tasks;
};
absl::Span<const LiberosOwnSuite> LiberosOwnSuites();

// Where the tasks of such a suite lie, bddl_files/SUITE; `libero_root` as a unit has it. Empty:
// another suite, or not found.
std::string LiberosOwnFolder(const std::string& libero_root, const std::string& suite);
// SHA-256, hex, of the ten tasks of that folder and of their initial states in init_files/SUITE:
// what two runs have to have in common. A file that is missing counts as such.
std::string LiberosOwnSha256(const std::string& folder);

}  // namespace robostress
