#pragma once

#include <string>
#include <vector>

#include "eval/plan/unit_text.h"
#include "eval/store/run_store.h"

namespace robostress {

// What a unit's folder holds.
struct UnitInspection {
  UnitResult unit;                // as far as it can be read
  bool finished = false;          // has DONE
  bool without_checksum = false;  // DONE says nothing about the episodes
  std::string episodes_sha256;
  // Everything that is wrong with a finished unit, each with file and value; of an unfinished one
  // nothing is, because its worker completes it.
  std::vector<std::string> damage;
};

// Reads and checks units/ID/. Never fails: what is wrong is part of the result.
UnitInspection InspectUnit(const std::string& folder, UnitTextReader& texts);

// Refuses units of one policy name that ran on different weights, with all of them listed.
struct ModelUse {
  std::string policy, model_hash, unit;
};
std::vector<std::string> DifferentModels(const std::vector<ModelUse>& uses);

}  // namespace robostress
