#include "server/training/success_evaluation.h"

#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

absl::Status CountEpisodes(const std::string& path, SuccessCount& count) {
  std::ifstream stream(path);
  int64_t number = 0;
  for (std::string line; std::getline(stream, line);) {
    ++number;
    const nlohmann::json episode = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
    const auto success = episode.is_object() ? episode.find("success") : episode.end();
    if (!episode.is_object() || success == episode.end() || !success->is_boolean()) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ":", number, ": not an episode with a true or false 'success'"));
    }
    ++count.episodes;
    count.successes += success->get<bool>();
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<SuccessCount> MeasureSuccess(const std::string& command, const std::string& weights,
                                            const std::string& out, int64_t step) {
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  const std::string line = absl::StrReplaceAll(
      command, {{"{weights}", weights}, {"{out}", out}, {"{step}", absl::StrCat(step)}});
  const int status = std::system(line.c_str());
  if (status == -1 || !WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    return absl::UnavailableError(absl::StrCat(
        "evaluation at step ", step, ": `", line, "` ended with ",
        status != -1 && WIFEXITED(status) ? absl::StrCat("exit code ", WEXITSTATUS(status))
                                          : absl::StrCat("status ", status),
        "; correct it, then go on with --resume"));
  }
  SuccessCount count;
  std::error_code error;
  for (fs::recursive_directory_iterator it(out, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().filename() == "episodes.jsonl")
      RS_RETURN_IF_ERROR(CountEpisodes(it->path().string(), count));
  }
  if (count.episodes == 0) {
    return absl::NotFoundError(
        absl::StrCat("evaluation at step ", step, ": `", line, "` left no episodes.jsonl in ", out,
                     "; let it write there, e.g. robostress sweep --out {out}"));
  }
  return count;
}

}  // namespace robostress
