#include "eval/store/processor_kind.h"

#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

// Flags of /proc/cpuinfo after which numerical libraries choose a kernel.
bool ChoosesKernels(absl::string_view flag) {
  for (const char* prefix : {"avx", "amx", "fma", "sse4", "f16c"}) {
    if (absl::StartsWith(flag, prefix)) return true;
  }
  return flag == "asimd" || flag == "sve" || flag == "sve2" || flag == "bf16";
}

}  // namespace

std::string ProcessorKind::Text() const {
  return isa.empty() ? model : absl::StrCat(model, " [", isa, "]");
}

ProcessorKind ParseProcessor(const std::string& cpuinfo) {
  ProcessorKind kind;
  std::set<std::string> sets;
  for (absl::string_view line : absl::StrSplit(cpuinfo, '\n')) {
    const std::vector<absl::string_view> parts = absl::StrSplit(line, absl::MaxSplits(':', 1));
    if (parts.size() != 2) continue;
    const absl::string_view key = absl::StripAsciiWhitespace(parts[0]);
    const absl::string_view value = absl::StripAsciiWhitespace(parts[1]);
    if (key == "model name" && kind.model.empty()) kind.model = std::string(value);
    if (key != "flags" && key != "Features") continue;
    for (absl::string_view flag : absl::StrSplit(value, ' ', absl::SkipEmpty())) {
      if (ChoosesKernels(flag)) sets.emplace(flag);
    }
  }
  if (kind.model.empty()) kind.model = "unknown";
  kind.isa = absl::StrJoin(sets, " ");
  return kind;
}

ProcessorKind ThisProcessor() {
  static const auto& kind =
      *new ProcessorKind(ParseProcessor(ReadFile("/proc/cpuinfo").value_or("")));
  return kind;
}

absl::Status RecordMachines(const std::string& unit_folder, const std::string& worker,
                            const std::string& server) {
  nlohmann::json record = {{"worker", worker}};
  if (!server.empty()) record["server"] = server;
  const std::string line = record.dump();
  const std::string file = unit_folder + "/machines.jsonl";
  const std::string present = ReadFile(file).value_or("");
  if (absl::StrContains(present, line + "\n")) return absl::OkStatus();
  if (absl::Status status = MakeDirectories(unit_folder); !status.ok()) return status;
  return AppendLine(file, line);
}

}  // namespace robostress
