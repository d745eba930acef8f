#include "sim_worker/suites/scene_spec.h"

namespace robostress {

const SuiteSpec* FindSuiteSpec(const std::string& name) {
  static const std::vector<SuiteSpec>& suites = *new std::vector<SuiteSpec>{
      TabletopSpatial(), TabletopObject(), TabletopGoal(), TabletopLong()};
  for (const SuiteSpec& suite : suites) {
    if (suite.name == name) return &suite;
  }
  return nullptr;
}

}  // namespace robostress
