#pragma once

#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::libero {

// A predicate applied to names: (On akita_black_bowl_1 plate_1). Lower case, as LIBERO's scanner
// makes it.
struct BddlAtom {
  std::string predicate;
  std::vector<std::string> arguments;
  int line = 0;
};

// A region of the table or floor (with ranges) or a named site of an object (without).
struct BddlRegion {
  std::string name;    // "<target>_<region>", how the rest of the file calls it
  std::string target;  // instance that owns it
  std::vector<std::array<double, 4>> ranges;  // x0 y0 x1 y1 [m], relative to the workspace
  std::array<double, 2> yaw = {0, 0};         // range of the rotation about z [rad]
  std::array<double, 4> rgba = {0, 0, 1, 0};
  int line = 0;
};

// Instances of one category, in the file's order: the order fixes qpos.
struct BddlGroup {
  std::string category;
  std::vector<std::string> instances;
  int line = 0;
};

// One task of LIBERO: what exists, where it starts, when it is solved.
struct BddlProblem {
  std::string file;
  std::string name;  // "libero_tabletop_manipulation"
  std::string language;
  std::vector<BddlRegion> regions;
  std::vector<BddlGroup> fixtures, objects;
  std::vector<std::string> objects_of_interest;
  std::vector<BddlAtom> init, goal;  // conjunctions

  const BddlRegion* FindRegion(std::string_view name) const;
};

// Parses the text of a BDDL file; `file` names it in errors, which also hold the line and the
// token.
absl::StatusOr<BddlProblem> ParseBddl(const std::string& file, std::string_view text);
absl::StatusOr<BddlProblem> ReadBddl(const std::string& file);

}  // namespace robostress::libero
