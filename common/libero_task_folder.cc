#include "common/libero_task_folder.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

}  // namespace

absl::StatusOr<LiberoTaskFolder> ReadLiberoTaskFolder(const std::string& folder) {
  LiberoTaskFolder read;
  std::error_code error;
  fs::path path = fs::absolute(folder, error).lexically_normal();
  if (!path.has_filename()) path = path.parent_path();  // "folder/"
  read.path = path.string();
  read.suite = path.filename().string();
  for (fs::directory_iterator entry(path, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->path().extension() == ".bddl") read.tasks.push_back(entry->path().stem().string());
  }
  if (error) return absl::NotFoundError(absl::StrCat(folder, ": ", error.message()));
  if (read.tasks.empty()) {
    return absl::NotFoundError(absl::StrCat(
        folder,
        ": no .bddl file in it; give a folder of LIBERO tasks such as bddl_files/libero_90"));
  }
  std::sort(read.tasks.begin(), read.tasks.end());
  return read;
}

std::string InitialStatesOf(const LiberoTaskFolder& folder, const std::string& task) {
  std::vector<fs::path> places = {folder.path};
  const fs::path above = fs::path(folder.path).parent_path();
  if (above.filename() == "bddl_files")
    places.push_back(above.parent_path() / "init_files" / folder.suite);
  std::error_code ignored;
  for (const fs::path& place : places) {
    for (const char* ending : {".pruned_init", ".pruned_init.npz", ".init", ".init.npz"}) {
      const fs::path file = place / absl::StrCat(task, ending);
      if (fs::is_regular_file(file, ignored)) return file.string();
    }
  }
  return "";
}

}  // namespace robostress
