#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/store/unit_files.h"

namespace robostress {

// What may be said of a unit of a store, worst first.
enum class StoreFault {
  kDamaged,     // a finished unit whose files are torn, changed or contradict each other
  kConflict,    // one unit with different results in two stores, or one name for two scenario files
  kOtherModel,  // units of one policy that ran on different weights
  kUnlike,      // units that their names do not tell apart, played with other options
  kUnfinished,  // begun, without DONE
  kMissing,     // planned by a grid of the store, never begun
  kUnplanned,   // of no grid of the store; counted all the same
  kDuplicate,   // equal in two stores; counted once
};
const char* StoreFaultName(StoreFault fault);

struct StoreFinding {
  StoreFault fault;
  std::string store, unit;  // unit: empty when it concerns several
  std::string text;
};

// One unit of one store.
struct StoredUnit {
  std::string store;
  UnitInspection inspection;  // its episodes were read and are not kept
  // What must be equal in all stores: configuration (apart from where files lie, which differs
  // between clusters), episodes, weights.
  std::string Fingerprint() const;
};

struct StoreContents {
  std::vector<StoredUnit> units;  // by store, then id
  std::vector<StoreFinding> findings;
  int finished = 0;
};

// Reads every unit of every store (run directory) and compares what several of them hold. NotFound
// when one is no run directory.
absl::StatusOr<StoreContents> CheckStores(const std::vector<std::string>& stores);
// True for what makes a table wrong, rather than incomplete.
bool IsBad(StoreFault fault);
bool IsIncomplete(StoreFault fault);

}  // namespace robostress
