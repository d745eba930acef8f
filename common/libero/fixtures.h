#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// Where the fixtures of LIBERO's scenes (cabinet, stove, rack) stand at each episode. Initial
// states do not hold their poses.
struct LiberoFixtures {
  enum class Source {
    kCentred,  // at the centres of their regions, always
    kSampled,  // drawn from their regions, a function of task and initial state
    kNumpy,    // where the originals' environment has them after as many resets
    kTable,    // as a file says
  };
  Source source = Source::kCentred;
  // Of kNumpy. The environment is seeded with it once a task, as in openpi's evaluation, which has
  // 7; or, each_seeded, with seed + k before the reset of initial state k, after one reset more, as
  // in LeRobot's.
  uint32_t seed = 7;
  bool each_seeded = false;
  std::string table;  // of kTable: the file
};

// Whether `text` is none of the words below, and so the path of a table.
bool NamesFixtureTable(const std::string& text);

// "centred", "sampled", "numpy", "numpy:SEED", "numpy-each:SEED", or the path of a readable table.
// InvalidArgument names what was given and what is known.
absl::StatusOr<LiberoFixtures> ParseLiberoFixtures(const std::string& text);

}  // namespace robostress
