// Bends a joint's motion by a scenario and lists the corrections: what another simulator would do.

#include <cstdio>
#include <cstdlib>

#include "adapter/methods.h"
#include "common/joint_errors/scenarios.h"

int main() {
  const auto scenario = robostress::MakeScenario("heavy_payload", 5);
  if (!scenario.ok()) {
    std::fprintf(stderr, "%s\n", std::string(scenario.status().message()).c_str());
    return EXIT_FAILURE;
  }
  const auto methods = robostress::MethodNames();
  std::printf("%s, %zu joints, %zu methods\n", scenario->name.c_str(), scenario->end.size(),
              methods.size());
  return scenario->end.empty() || methods.empty() ? EXIT_FAILURE : EXIT_SUCCESS;
}
