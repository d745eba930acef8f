#include "common/suites.h"

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
  };
  return suites;
}

const SuiteInfo* FindSuite(const std::string& name) {
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.name == name) return &suite;
  }
  return nullptr;
}

}  // namespace robostress
