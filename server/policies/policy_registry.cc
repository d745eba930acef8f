#include "server/policies/policy_registry.h"

#include <cstdlib>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "common/program_folder.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "server/policies/checkpoint_policies.h"
#include "server/policies/nano/nano_policy.h"
#include "server/policies/policy.h"

namespace robostress {
namespace {

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadNano(const std::string& name) {
  const std::string path = WeightsPath(name);
  RS_ASSIGN_OR_RETURN(NanoModel model, LoadNanoModel(path));
  RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(path));
  return MakeNanoPolicy(std::move(model), hash, name);
}

bool IsCheckpointPath(const std::string& path) {
  std::error_code error;
  return std::filesystem::is_directory(path, error) || absl::EndsWith(path, ".safetensors") ||
         absl::EndsWith(path, ".safetensors.index.json");
}

}  // namespace

std::string WeightsPath(const std::string& name_or_path) {
  if (!IsEmbeddedPolicy(name_or_path)) return name_or_path;
  const char* directory = std::getenv("ROBOSTRESS_WEIGHTS_DIR");
  return absl::StrCat(directory != nullptr ? directory : DataPath("server/models/weights"), "/",
                      name_or_path, ".safetensors");
}

bool IsNanoFile(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return false;
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
  if (!file.ok()) return false;
  const auto format = file->metadata().find("format");
  return format != file->metadata().end() && format->second == kNanoFormat;
}

// One line per policy, served under the name it was asked for: embedded policies are files of
// the source, "nano:random" has random weights (tests, timing), and a path is a nano file or a
// checkpoint of pi0 or pi0.5.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadFlowPolicy(
    const std::string& name_or_path, const std::vector<std::string>& options) {
  const bool random = name_or_path == "nano:random";
  if (random || IsNanoFile(WeightsPath(name_or_path))) {
    if (!options.empty()) {
      return absl::InvalidArgumentError(
          absl::StrCat("policy ", name_or_path,
                       " takes no policy options; given: ", absl::StrJoin(options, ", ")));
    }
    if (random) return MakeNanoPolicy(RandomNanoModel(NanoConfig(), 1), "random", name_or_path);
    return LoadNano(name_or_path);
  }
  if (IsEmbeddedPolicy(name_or_path)) {
    absl::StatusOr<std::unique_ptr<FlowPolicy>> policy = LoadNano(name_or_path);
    if (policy.ok()) return policy;
    return absl::Status(policy.status().code(),
                        absl::StrCat(policy.status().message(),
                                     "; ROBOSTRESS_WEIGHTS_DIR names the folder of the weights "
                                     "that come with the programs (server/models/weights)"));
  }
  if (IsCheckpointPath(name_or_path)) return LoadCheckpointPolicy(name_or_path, options);
  return absl::NotFoundError(absl::StrCat(
      "policy '", name_or_path, "' is unknown; use ",
      absl::StrJoin(kSuitePolicies, ", ",
                    [](std::string* out, std::string_view name) { out->append(name); }),
      ", ", kPiperPolicy,
      ", nano:random, a path that ends in .safetensors, or the "
      "folder of a pi0 or pi0.5 checkpoint"));
}

}  // namespace robostress
