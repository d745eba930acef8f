#include "server/policies/openpi/policy_options.h"

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "server/policies/openpi/transforms.h"

namespace robostress::openpi {
namespace {

absl::Status CheckRanges(const PolicyOptions& o) {
  struct Range {
    const char* key;
    int64_t value, max;
  };
  for (const Range& range :
       {Range{"horizon", o.horizon, 1024}, Range{"execute_steps", o.execute_steps, 1024},
        Range{"prompt_tokens", o.prompt_tokens, 1 << 16},
        Range{"euler_steps", o.euler_steps, 1000}}) {
    if (range.value < 0 || range.value > range.max) {
      return absl::InvalidArgumentError(absl::StrCat("policy option ", range.key, " is ",
                                                     range.value, ", must be 0..", range.max));
    }
  }
  if (o.transform != "auto") RS_RETURN_IF_ERROR(FindRobotTransform(o.transform).status());
  if (!o.cameras.empty() && o.cameras.size() != kImageSlots.size()) {
    return absl::InvalidArgumentError(absl::StrCat("policy option cameras has ", o.cameras.size(),
                                                   " names, must have ", kImageSlots.size(),
                                                   ", '' where a camera is absent"));
  }
  return absl::OkStatus();
}

}  // namespace

std::string CheckpointFolder(const std::string& path) {
  const std::filesystem::path given(path);
  std::error_code error;
  if (std::filesystem::is_directory(given, error)) return path;
  return given.has_parent_path() ? given.parent_path().string() : ".";
}

absl::StatusOr<PolicyOptions> ReadPolicyOptions(const std::string& path,
                                                const std::vector<std::string>& overrides) {
  PolicyOptions options;
  const auto file = std::filesystem::path(CheckpointFolder(path)) / kPolicyOptionsFile;
  std::error_code error;
  if (std::filesystem::exists(file, error)) {
    RS_ASSIGN_OR_RETURN(options, LoadConfig<PolicyOptions>(file.string()));
  }
  RS_RETURN_IF_ERROR(ApplyOverrides(overrides, options));
  RS_RETURN_IF_ERROR(CheckRanges(options));
  return options;
}

}  // namespace robostress::openpi
