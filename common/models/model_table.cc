#include "common/models/model_table.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {

const char* FactSourceName(FactSource source) {
  switch (source) {
    case FactSource::kRead:
      return "read";
    case FactSource::kRig:
      return "rig";
    case FactSource::kAssumed:
      return "assumed";
    case FactSource::kRepaired:
      return "repaired";
    case FactSource::kLeftOut:
      return "left out";
  }
  return "read";
}

ModelFact HeldFact(std::vector<std::string> joints) {
  constexpr size_t kMost = 12;
  const size_t count = joints.size();
  if (count > kMost) joints.resize(kMost);
  return {"model", "joints held at 0",
          absl::StrCat(absl::StrJoin(joints, ", "),
                       count > kMost ? absl::StrCat(" and ", count - kMost, " more") : ""),
          FactSource::kAssumed, "list a joint that moves in the rig"};
}

std::string ModelTableText(const std::vector<ModelFact>& facts, const std::string& indent) {
  std::string text;
  const std::string* part = nullptr;
  // Remedies in the order in which they first stand, with what they mend.
  std::vector<std::pair<std::string, std::vector<std::string>>> remedies;
  for (const ModelFact& fact : facts) {
    absl::StrAppend(&text,
                    part != nullptr && *part == fact.part
                        ? "; "
                        : absl::StrCat(part == nullptr ? "" : "\n", indent, fact.part, ": "),
                    fact.what, " ", fact.value);
    part = &fact.part;
    if (fact.source != FactSource::kRead)
      absl::StrAppend(&text, " (", FactSourceName(fact.source), ")");
    if (fact.remedy.empty()) continue;
    const auto known = std::find_if(remedies.begin(), remedies.end(), [&](const auto& remedy) {
      return remedy.first == fact.remedy;
    });
    std::vector<std::string>& mended =
        known == remedies.end()
            ? remedies.emplace_back(fact.remedy, std::vector<std::string>{}).second
            : known->second;
    if (std::find(mended.begin(), mended.end(), fact.what) == mended.end())
      mended.push_back(fact.what);
  }
  if (text.empty()) return text;
  for (const auto& [remedy, mended] : remedies)
    absl::StrAppend(&text, "\n", indent, "  ", absl::StrJoin(mended, ", "), ": ", remedy);
  return text + "\n";
}

}  // namespace robostress
