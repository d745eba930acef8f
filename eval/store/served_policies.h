#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "eval/store/run_store.h"

namespace robostress {

// What a run knows of a policy that somebody else served.
struct ServedPolicy {
  std::string label;                      // which the user gave
  std::string dialect;                    // name of the keys
  bool noise_paired = true;               // the server takes a seed or the noise
  std::map<std::string, int> urls;        // -> units that it answered, without queries
  std::set<std::string> metadata_sha256;  // what the servers said of themselves
  int reconnections = 0;                  // over all units
  std::vector<std::string> changed;       // units whose server's metadata changed as they ran
  int units = 0;
};

// By label; empty where every policy was served by us.
std::vector<ServedPolicy> ServedPolicies(const RunData& run);
// What a table must say of them: who answered, how often connections broke, and, first, whether a
// server may have become another model in mid-run.
std::vector<std::string> ServerNotes(const RunData& run);

}  // namespace robostress
