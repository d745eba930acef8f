#include "common/rollout/rollout.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/rollout/late_rollout.h"
#include "common/rollout/spec_checks.h"
#include "common/rollout/stop_watch.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<EpisodeRecord> RunEpisode(const EpisodeKey& key, const RolloutOptions& options,
                                         Robot& robot, PolicyEndpoint& policy, uint64_t& sequence) {
  if (options.late.delay_steps > 0) return RunLateEpisode(key, options, robot, policy, sequence);
  PolicySpec spec = policy.spec();
  if (options.execute_steps > spec.horizon) {
    return absl::InvalidArgumentError(absl::StrCat("execute_steps is ", options.execute_steps,
                                                   ", a chunk of policy '", spec.name, "' has ",
                                                   spec.horizon, " rows"));
  }
  if (options.execute_steps > 0) spec.execute_steps = options.execute_steps;
  EpisodeRecord record;
  // The robot first: a policy with access to the state (the expert) reads it when its episode
  // starts.
  RS_RETURN_IF_ERROR(robot.Reset(options.initial_state));
  RS_RETURN_IF_ERROR(policy.StartEpisode(key));
  if (options.on_step) options.on_step(0);
  RS_ASSIGN_OR_RETURN(RobotState state, robot.Measure());
  record.success = robot.Success();

  for (int chunk = 0; !record.success && record.steps < robot.horizon(); ++chunk) {
    absl::StatusOr<Observation> observation = absl::UnknownError("not observed");
    {
      const StopWatch watch(record.observe_s);
      observation = robot.Observe(spec);
    }
    RS_RETURN_IF_ERROR(observation.status());
    absl::StatusOr<PredictedChunk> prediction = absl::UnknownError("not predicted");
    {
      const StopWatch watch(record.predict_s);
      prediction = policy.Predict(*observation, chunk);
    }
    RS_RETURN_IF_ERROR(prediction.status());
    RS_RETURN_IF_ERROR(CheckExecutable(*prediction, spec));

    ExecutedChunk executed;
    executed.sequence = sequence + 1;
    executed.task = key.task;
    executed.episode = key.episode;
    executed.chunk = chunk;
    executed.prediction_id = prediction->prediction_id;
    const int steps = std::min(spec.execute_steps, robot.horizon() - record.steps);
    executed.final_state = state;
    for (int i = 0; i < steps && !record.success; ++i) {
      RS_ASSIGN_OR_RETURN(Eigen::VectorXf command, policy.NextCommand(*prediction, executed));
      ExecutedStep& step = executed.steps.emplace_back();
      step.before = std::move(executed.final_state);
      step.policy_command = prediction->policy_actions.row(i).transpose();
      step.sent_command = std::move(command);
      if (prediction->base_actions.size() > 0)
        step.base_command = prediction->base_actions.row(i).transpose();
      {
        const StopWatch watch(record.step_s);
        RS_RETURN_IF_ERROR(robot.Step(step.sent_command));
      }
      RS_ASSIGN_OR_RETURN(executed.final_state, robot.Measure());
      record.success = robot.Success();
      ++record.steps;
      if (options.on_step) options.on_step(record.steps);
    }
    state = executed.final_state;
    executed.last_of_episode = record.success || record.steps >= robot.horizon();
    record.chunks.push_back(executed);
    {
      const StopWatch watch(record.feedback_s);
      RS_RETURN_IF_ERROR(policy.SendFeedback(std::move(executed)));
    }
    ++sequence;
  }
  return record;
}

}  // namespace robostress
