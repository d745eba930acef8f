#pragma once

#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sim_worker/libero/catalog.h"

namespace robostress::libero {

// A file that the forty tasks read. `path` is below the folder that setup links:
// "libero/libero/assets/...", "libero/libero/bddl_files/...", "libero/libero/init_files/...",
// "robosuite/models/assets/...".
struct NeededFile {
  std::string path;
  std::string sha256;                // lower-case hexadecimal
  std::vector<std::string> or_also;  // of versions that are as good
};

// The list that comes with this program; DataPath() finds it.
inline constexpr char kNeededFiles[] = "sim_worker/libero/needed_files.sha256";

// A list in sha256sum's form. Lines that begin with '#' are remarks; "# or HASH  PATH" names
// another version of the file of the line before. An error names file and line.
absl::StatusOr<std::vector<NeededFile>> ReadNeededFiles(const std::string& file);

// All files that the forty tasks read, with their hashes, by composing every task. A file that is
// missing is NotFound.
absl::StatusOr<std::vector<NeededFile>> ListNeededFiles(const LiberoPaths& paths);
// The paths alone; files may be missing where only pictures need them.
absl::StatusOr<std::set<std::string>> NeededPaths(const LiberoPaths& paths);

// One of the four folders that are linked, as it was found.
struct FoundPart {
  std::string part;    // "libero/libero/assets"
  std::string folder;  // where it is, links resolved; empty: nowhere
  int needed = 0;      // files of the list below `part`
  // Paths relative to the folder.
  std::vector<std::string> missing;
  std::vector<std::string> different;
  bool complete() const { return !folder.empty() && missing.empty() && different.empty(); }
};

// Empty if every file of the list is below `paths` as the list says, else a sentence that counts
// and names those that are not.
std::string OtherFiles(const LiberoPaths& paths, const std::vector<NeededFile>& needed);

// Looks for the four parts below `roots`: site-packages, checkouts, or folders that hold assets,
// bddl_files or init_files. Of several the one with fewest missing and different files is taken,
// the first of equals; a part that one of the `asked` roots holds is taken from there.
std::vector<FoundPart> FindParts(const std::vector<NeededFile>& needed,
                                 const std::vector<std::string>& asked,
                                 const std::vector<std::string>& roots);

// Replaces the four links below `home`, each at once. Of parts that were not found none is made.
absl::Status LinkParts(const std::vector<FoundPart>& parts, const std::string& home);

// The roots to look in whatever Python there is: LIBERO_ROOT, ROBOSUITE_ROOT, what `home` already
// links, the folders in LIBERO's own config.yaml and cache.
std::vector<std::string> UsualRoots(const std::string& home);
// The folders that a Python imports from. A name without '/' is looked for in PATH.
// FailedPrecondition says how it ended if it does not run.
absl::StatusOr<std::vector<std::string>> PythonRoots(const std::string& python);
// The Python of the active environment: VIRTUAL_ENV's, CONDA_PREFIX's, else python3.
std::string UsualPython();

}  // namespace robostress::libero
