#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/unit_config.h"
#include "robot_client/policy_connection.h"

namespace robostress::piper {

// What a suite of the Piper (common/suites.h) puts on the table.
struct TableSuite {
  const char* name;
  int task;                   // of kTableTasks
  std::vector<int> variants;  // of kObjectVariants, one for each task of the suite
};
// NOT_FOUND lists the names.
absl::StatusOr<TableSuite> FindTableSuite(const std::string& name);
// What the policy is told.
std::string InstructionOf(const TableSuite& suite, int variant);

// Reads, resolves and checks what the Piper's worker can play: a suite on its table, a wear profile
// as scenario, a served policy, no films. The error names field, value and what there is.
absl::StatusOr<UnitConfig> ResolvePiperUnit(const UnitConfig& unit);

// The session that plays the unit, asynchronous with the client's time limits. What
// the client does of a method (client_method.h) is not the session's. All suites are one table
// to the policy, so that a state has the same sampling noise in each.
PolicyConnectionOptions SessionOf(const UnitConfig& unit, const std::string& server);

}  // namespace robostress::piper
