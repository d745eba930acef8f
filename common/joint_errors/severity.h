#pragma once

#include <vector>

#include "common/joint_errors/grasp_gate.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// FactorsAt for one joint, without allocating.
SeverityFactors FactorOfJoint(const Scenario& scenario, int joint, double progress, double grasp);

// How strong the paper's errors of a scenario are at each joint at this moment of an episode: ramps
// over the horizon, the grasp gate. Allocates only in SetScenario.
class SeverityCourse {
 public:
  explicit SeverityCourse(int joints) : factors_(joints), parameters_(joints) {}

  // horizon [control steps]: over which a ramp runs. A scenario with errors has parameters and
  // factors for every joint (checked). Begins an episode.
  void SetScenario(const Scenario& scenario, int horizon);
  void Reset();
  // steps_done: control steps of the episode before this one (0 while settling); held: the grasp
  // check.
  void BeginControlStep(int steps_done, bool held);
  // One sub-step of h [s]; whether parameters may have changed.
  bool BeginSubStep(double h);

  const Scenario& scenario() const { return scenario_; }
  const std::vector<SeverityFactors>& factors() const { return factors_; }             // [joints]
  const std::vector<JointErrorParameters>& parameters() const { return parameters_; }  // [joints]
  bool gate_closed() const { return gate_.closed(); }

 private:
  void Rescale(double grasp);

  Scenario scenario_;  // default: Clean, every component off
  int horizon_ = 1;
  double progress_ = 0;
  GraspGate gate_;
  std::vector<SeverityFactors> factors_;
  std::vector<JointErrorParameters> parameters_;
};

}  // namespace robostress
