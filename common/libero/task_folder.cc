#include "common/libero/task_folder.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/plain_line.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// JSON and terminals show it.
absl::Status CheckName(const std::string& name, const std::string& folder) {
  const bool utf8 = !nlohmann::json::parse("\"" + name + "\"", nullptr, false).is_discarded();
  if (utf8 && IsPlainLine(name)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      folder, ": the name '", absl::CHexEscape(name),
      "' of a suite or task is not plain UTF-8 without quotes and backslashes; rename it"));
}

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
    const fs::path& file = entry->path();
    std::error_code ignored;
    // Archives leave files such as ._task.bddl.
    if (file.extension() != ".bddl" || file.filename().string().starts_with('.') ||
        fs::is_directory(file, ignored))
      continue;
    std::error_code why;
    if (!fs::is_regular_file(file, why)) {
      return absl::NotFoundError(absl::StrCat(file.string(), ": ",
                                              why == std::errc::no_such_file_or_directory
                                                  ? "a link to a file that is not there"
                                              : why ? why.message()
                                                    : "no regular file",
                                              "; mend or remove it, tasks are counted by place"));
    }
    read.tasks.push_back(file.stem().string());
    RS_RETURN_IF_ERROR(CheckName(read.tasks.back(), folder));
  }
  RS_RETURN_IF_ERROR(CheckName(read.suite, folder));
  if (error) return absl::NotFoundError(absl::StrCat(folder, ": ", error.message()));
  if (read.tasks.empty()) {
    return absl::NotFoundError(absl::StrCat(
        folder,
        ": no .bddl file in it; give a folder of LIBERO tasks such as bddl_files/libero_90"));
  }
  read.real_path = fs::canonical(path, error).string();
  if (error) return absl::NotFoundError(absl::StrCat(folder, ": ", error.message()));
  std::sort(read.tasks.begin(), read.tasks.end());
  return read;
}

std::string LiberoTaskFolder::SuiteOfFiles() const {
  return fs::path(real_path).filename().string();
}

std::string InitialStatesOf(const LiberoTaskFolder& folder, const std::string& task) {
  std::vector<fs::path> places = {folder.path};
  for (const fs::path path : {folder.path, folder.real_path}) {
    if (path.parent_path().filename() == "bddl_files")
      places.push_back(path.parent_path().parent_path() / "init_files" / path.filename());
  }
  std::error_code why;
  for (const fs::path& place : places) {
    for (const char* ending : {".pruned_init", ".pruned_init.npz", ".init", ".init.npz"}) {
      const fs::path file = place / absl::StrCat(task, ending);
      const fs::file_status status = fs::symlink_status(file, why);
      // One that cannot be read is not passed over for other states: reading it says why.
      if (fs::exists(status) || why == std::errc::permission_denied) return file.string();
    }
  }
  return "";
}

std::string NoInitialStates(const LiberoTaskFolder& folder, const std::string& task) {
  const bool as_libero = fs::path(folder.path).parent_path().filename() == "bddl_files";
  return absl::StrCat("no initial states: neither ", task,
                      ".pruned_init nor .init, with or without .npz, lies beside it",
                      as_libero ? absl::StrCat(" or in init_files/", folder.suite) : "");
}

absl::StatusOr<std::string> LiberoTasksSha256(const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const LiberoTaskFolder read, ReadLiberoTaskFolder(folder));
  std::string hashes;
  for (const std::string& task : read.tasks) {
    const std::string states = InitialStatesOf(read, task);
    RS_ASSIGN_OR_RETURN(const std::string of_task,
                        Sha256OfFile(absl::StrCat(read.path, "/", task, ".bddl")));
    absl::StrAppend(&hashes, task, " ", of_task, " ");
    if (!states.empty()) absl::StrAppend(&hashes, Sha256OfFile(states).value_or("unreadable"));
    hashes += '\n';
  }
  return Sha256Hex(hashes);
}

}  // namespace robostress
