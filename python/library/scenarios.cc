#include "common/joint_errors/scenarios.h"

#include <string>
#include <vector>

#include "python/library/robostress.h"

namespace robostress {
namespace {

// What is offered: the table without the one that is kept for tuning.
const std::vector<Scenario>& Offered() {
  static const std::vector<Scenario>& offered = *[] {
    auto* scenarios = new std::vector<Scenario>;
    for (const std::string& name : ScenarioNames()) {
      absl::StatusOr<Scenario> scenario = MakeScenario(name, 5);
      if (scenario.ok()) scenarios->push_back(*std::move(scenario));
    }
    return scenarios;
  }();
  return offered;
}

const Scenario* At(size_t index) { return index < Offered().size() ? &Offered()[index] : nullptr; }

}  // namespace
}  // namespace robostress

extern "C" {

const char* robostress_version(void) { return ROBOSTRESS_LIBRARY_VERSION; }
int robostress_interface(void) { return ROBOSTRESS_INTERFACE; }

size_t robostress_scenario_count(void) { return robostress::Offered().size(); }
const char* robostress_scenario_name(size_t index) {
  const robostress::Scenario* scenario = robostress::At(index);
  return scenario == nullptr ? nullptr : scenario->name.c_str();
}
const char* robostress_scenario_title(size_t index) {
  const robostress::Scenario* scenario = robostress::At(index);
  return scenario == nullptr ? nullptr : scenario->title.c_str();
}
int robostress_scenario_deployed(size_t index) {
  const robostress::Scenario* scenario = robostress::At(index);
  return scenario != nullptr && scenario->deployment;
}

}  // extern "C"
