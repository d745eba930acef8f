#include "calibration/fidelity/replay_comparison.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "sim_worker/sim_task.h"

namespace robostress::calibration {
namespace {

constexpr double kControlPeriod = 0.05;  // [s]

// Squared sums of a replay's distance from a recording.
struct Sums {
  double joint = 0, tool = 0;
  int steps = 0;
  void Add(const RobotState& measured, const RobotState& simulated) {
    joint += (measured.q - simulated.q).squaredNorm() / static_cast<double>(measured.q.size());
    tool += (measured.tool.p_base_tool - simulated.tool.p_base_tool).squaredNorm();
    ++steps;
  }
  ReplayError Error() const {
    const double n = std::max(1, steps);
    return {std::sqrt(joint / n), std::sqrt(tool / n), steps};
  }
};

// Control steps before the first contact; settling stands before the first of them.
size_t FreeSteps(const JointLog& log, double contact_limit_N) {
  const double settled = log.samples.empty()
                             ? 0
                             : log.samples.back().t + 1 / JointLog::kRateHz -
                                   kControlPeriod * static_cast<double>(log.actions.size());
  for (const JointSample& sample : log.samples) {
    if (sample.contact_N <= contact_limit_N) continue;
    const double steps = std::floor((sample.t - settled) / kControlPeriod + 1e-6);
    return static_cast<size_t>(std::max(0.0, steps));
  }
  return log.actions.size();
}

}  // namespace

absl::StatusOr<ReplayComparison> CompareReplays(const std::vector<JointLog>& recorded,
                                                const std::string& scenario,
                                                double contact_limit_N) {
  std::map<std::string, std::unique_ptr<SimTask>> tasks;
  Sums free_motion, whole;
  for (const JointLog& log : recorded) {
    UnitConfig unit;
    unit.suite = log.suite;
    unit.scenario = scenario;
    unit.severity = log.severity;
    std::unique_ptr<SimTask>& task = tasks[absl::StrCat(log.suite, "/", log.task)];
    if (task == nullptr) {
      RS_ASSIGN_OR_RETURN(task, MakeSimTask(unit, log.task));
    }
    RS_RETURN_IF_ERROR(task->Reset(log.initial_state));
    const size_t free_steps = FreeSteps(log, contact_limit_N);
    for (size_t i = 0; i < log.actions.size(); ++i) {
      RS_RETURN_IF_ERROR(task->Step(log.actions[i]));
      RS_ASSIGN_OR_RETURN(const RobotState state, task->Measure());
      whole.Add(log.states[i + 1], state);
      if (i < free_steps) free_motion.Add(log.states[i + 1], state);
    }
  }
  return ReplayComparison{free_motion.Error(), whole.Error()};
}

}  // namespace robostress::calibration
