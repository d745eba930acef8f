#include "common/suites.h"

#include "common/unit_config.h"

namespace robostress {

const std::vector<SuiteInfo>& AllSuites() {
  static const std::vector<SuiteInfo>& suites = *new std::vector<SuiteInfo>{
      {"tabletop_spatial", "Spatial", 10, 220, 50, false},
      {"tabletop_object", "Object", 10, 280, 50, false},
      {"tabletop_goal", "Goal", 10, 300, 50, false},
      {"tabletop_long", "Long", 10, 520, 50, false},
      {"libero_spatial", "LIBERO-Spatial", 10, 220, 50, true},
      {"libero_object", "LIBERO-Object", 10, 280, 50, true},
      {"libero_goal", "LIBERO-Goal", 10, 300, 50, true},
      {"libero_10", "LIBERO-Long", 10, 520, 50, true},
      // The paper's real-arm tasks; each is a suite, because each has a session of its own.
      {"piper_1_next_to_plate", "1 bowl next to the plate", 1, 450, 1000, false, "piper"},
      {"piper_2_on_cabinet", "2 bowl on the cabinet", 1, 450, 1000, false, "piper"},
      {"piper_3_on_box", "3 bowl on the box", 1, 450, 1000, false, "piper"},
      {"piper_4_open_drawer", "4 top drawer", 1, 450, 1000, false, "piper"},
      {"piper_unseen", "unseen objects", 5, 450, 1000, false, "piper", true},
  };
  return suites;
}

std::vector<std::string> SuitesOf(const std::string& robot) {
  std::vector<std::string> names;
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.robot == robot) names.push_back(suite.name);
  }
  return names;
}

const SuiteInfo* FindSuite(const std::string& name) {
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.name == name) return &suite;
  }
  return nullptr;
}

int HorizonOf(const UnitConfig& unit) {
  const SuiteInfo* suite = FindSuite(unit.suite);
  return unit.horizon > 0 || suite == nullptr ? unit.horizon : suite->horizon;
}

}  // namespace robostress
