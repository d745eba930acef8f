#include <cstdlib>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "common/status_macros.h"
#include "server/policies/nano_policy.h"
#include "server/policy.h"

namespace robostress {
namespace {

// Where the weights that come with the source are; ROBOSTRESS_WEIGHTS_DIR overrides for an
// installed program.
std::string WeightsDirectory() {
  const char* directory = std::getenv("ROBOSTRESS_WEIGHTS_DIR");
  return directory != nullptr ? directory : ROBOSTRESS_SOURCE_WEIGHTS_DIR;
}

absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadNano(const std::string& name,
                                                     const std::string& path) {
  RS_ASSIGN_OR_RETURN(NanoModel model, LoadNanoModel(path));
  RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(path));
  return MakeNanoPolicy(std::move(model), hash, name);
}

}  // namespace

// One line per policy, served under the name it was asked for: kEmbeddedPolicies are the files that
// come with the source, "nano:random" has random weights (tests, timing), and anything that ends in
// .safetensors is a path.
absl::StatusOr<std::unique_ptr<FlowPolicy>> LoadFlowPolicy(const std::string& name_or_path) {
  if (IsEmbeddedPolicy(name_or_path))
    return LoadNano(name_or_path,
                    absl::StrCat(WeightsDirectory(), "/", name_or_path, ".safetensors"));
  if (name_or_path == "nano:random") {
    return MakeNanoPolicy(RandomNanoModel(NanoConfig(), 1), "random", name_or_path);
  }
  if (absl::EndsWith(name_or_path, ".safetensors")) return LoadNano(name_or_path, name_or_path);
  return absl::NotFoundError(absl::StrCat("policy '", name_or_path,
                                          "' is unknown; use nano, nano-bc, nano-dr, nano-robust, "
                                          "nano:random or a path that ends in .safetensors"));
}

}  // namespace robostress
