#include "common/joint_errors/severity.h"

#include <algorithm>

#include "common/check.h"

namespace robostress {

void SeverityCourse::SetScenario(const Scenario& scenario, int horizon) {
  const bool any =
      scenario.friction_on || scenario.gravity_on || scenario.backlash_on || scenario.compliance_on;
  const size_t joints = factors_.size();
  RS_CHECK(!any || (scenario.nominal.size() == joints && scenario.start.size() == joints &&
                    scenario.end.size() == joints));
  RS_CHECK(horizon >= 1);
  scenario_ = scenario;
  horizon_ = horizon;
  Reset();
}

void SeverityCourse::Reset() {
  gate_.Reset();
  progress_ = 0;
  Rescale(0);
}

void SeverityCourse::BeginControlStep(int steps_done, bool held) {
  gate_.BeginControlStep(held);
  progress_ = std::min(static_cast<double>(steps_done) / horizon_, 1.0);
}

bool SeverityCourse::BeginSubStep(double h) {
  const double grasp = gate_.SubStep(h);
  if (scenario_.profile == SeverityProfile::kFixed) return false;
  Rescale(grasp);
  return true;
}

void SeverityCourse::Rescale(double grasp) {
  const size_t joints = factors_.size();
  const bool known = scenario_.nominal.size() == joints && scenario_.end.size() == joints;
  for (size_t j = 0; j < joints; ++j) {
    factors_[j] =
        known ? FactorOfJoint(scenario_, static_cast<int>(j), progress_, grasp) : SeverityFactors();
    parameters_[j] = known ? Scale(scenario_.nominal[j], factors_[j]) : JointErrorParameters();
  }
}

}  // namespace robostress
