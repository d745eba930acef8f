#include "server/policies/openpi/policy_options.h"

#include <filesystem>

#include "absl/algorithm/container.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "server/policies/openpi/transforms.h"

namespace robostress::openpi {
namespace {

bool IsDevice(absl::string_view device) {
  if (device == "cpu" || device == "cuda") return true;
  int index = 0;
  return absl::ConsumePrefix(&device, "cuda:") && absl::SimpleAtoi(device, &index) && index >= 0;
}

// `source` says where the value of a key was given.
template <class Source>
absl::Status CheckRanges(const PolicyOptions& o, Source&& source) {
  const auto invalid = [&](const char* key, const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(source(key), ": policy option ", key, parts...));
  };
  struct Range {
    const char* key;
    int64_t value, min, max;
  };
  for (const Range& range :
       {Range{"horizon", o.horizon, 0, 1024}, Range{"execute_steps", o.execute_steps, 0, 1024},
        Range{"prompt_tokens", o.prompt_tokens, 0, 1 << 16},
        Range{"euler_steps", o.euler_steps, 0, 1000}, Range{"threads", o.threads, 1, 1024}}) {
    if (range.value < range.min || range.value > range.max)
      return invalid(range.key, " is ", range.value, ", must be ", range.min, "..", range.max);
  }
  if (!IsDevice(o.device))
    return invalid("device", " is '", o.device, "', must be cpu, cuda or cuda:N");
  if (o.transform != "auto") RS_RETURN_IF_ERROR(FindRobotTransform(o.transform).status());
  if (!o.cameras.empty() && o.cameras.size() != kImageSlots.size()) {
    return invalid("cameras", " has ", o.cameras.size(), " names, must have ", kImageSlots.size(),
                   ", '' where a camera is absent");
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
  RS_RETURN_IF_ERROR(CheckRanges(options, [&](absl::string_view key) {
    const auto sets = [key](absl::string_view assignment) {
      return absl::StartsWith(assignment, absl::StrCat(key, "="));
    };
    return absl::c_any_of(overrides, sets) ? "--policy-options" : file.string();
  }));
  return options;
}

}  // namespace robostress::openpi
