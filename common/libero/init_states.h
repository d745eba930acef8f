#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::libero {

// LIBERO's stored initial states of one task: rows of [time, qpos (nq), qvel (nv)].
struct InitStates {
  std::string file;
  int rows = 0, columns = 0;
  std::vector<double> values;  // [rows, columns]
  const double* row(int i) const { return values.data() + static_cast<size_t>(i) * columns; }
};

// Reads a `.pruned_init` file: a zip whose data.pkl is a pickle (protocol 2) of one float64 NumPy
// matrix; or an .npz with such a matrix `states`, as LIBERO-PRO's package has it. Nothing is
// executed: a small stack machine knows the opcodes and the four names that such a file needs and
// refuses everything else, with the file, the byte and the opcode in the error.
absl::StatusOr<InitStates> ParseInitStates(const std::string& file, std::string_view bytes);
absl::StatusOr<InitStates> ReadInitStates(const std::string& file);

// Episodes start from one row each, `first` on; the error names the rows that are not there, the
// file and the remedy.
absl::Status CheckEpisodeRows(const InitStates& states, int first, int episodes);

// The row's length must be 1 + nq + nv of the compiled model; the error names file and sizes.
absl::Status CheckInitStates(const InitStates& states, int nq, int nv);

// A free body's place in qpos: x y z [m], w x y z.
struct FreeBody {
  std::string name;
  int qpos = 0;
};
// In every row each body must be less than 100 m from the origin and its quaternion's norm 1 to a
// hundredth; the error names file, row, body and columns.
absl::Status CheckFreeBodies(const InitStates& states, const std::vector<FreeBody>& bodies);

// A hinge [rad] or slide [m] with limits, and its place in qpos.
struct LimitedJoint {
  std::string name;
  int qpos = 0;
  double low = 0, high = 0;
};
// In every row each joint must be within its limits to 0.1; the error names file, row, joint,
// column and value.
absl::Status CheckLimitedJoints(const InitStates& states, const std::vector<LimitedJoint>& joints);

}  // namespace robostress::libero
