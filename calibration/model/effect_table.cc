#include "calibration/model/effect_table.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/joint_errors/effects/effect_library.h"

namespace robostress::calibration {
namespace {

std::string Cell(const std::string& text) {
  return absl::StrReplaceAll(text, {{"|", "\\|"}, {"\n", " "}});
}

}  // namespace

std::string EffectTableMarkdown() {
  std::string table =
      "| effect | stage | what it does | parameters | needs | mimics | told apart by |\n"
      "|---|---|---|---|---|---|---|\n";
  for (const EffectInfo& effect : EffectLibrary()) {
    std::vector<std::string> parameters;
    for (const EffectParameter& p : effect.parameters)
      parameters.push_back(absl::StrCat(p.name, " [", p.unit, "]",
                                        p.late    ? " (fixed at first)"
                                        : p.fixed ? " (fixed)"
                                                  : ""));
    absl::StrAppend(&table, "| `", effect.type, "` | ", StageName(effect.stage), " | ",
                    Cell(effect.equation), " | ", Cell(absl::StrJoin(parameters, ", ")), " | ",
                    Cell(effect.needs), " | ", absl::StrJoin(effect.mimics, ", "), " | ",
                    Cell(effect.separated_by), " |\n");
  }
  return table;
}

}  // namespace robostress::calibration
