#include "sim_worker/record/expert_demonstration.h"

#include <algorithm>
#include <chrono>

#include "common/status_macros.h"
#include "sim_worker/simulator_row.h"

namespace robostress {
namespace {

// A constant offset on the command that lasts a few control steps, again and again.
class NoiseBursts {
 public:
  NoiseBursts(const RecordOptions& options, RandomStream& random)
      : options_(options), random_(random), active_(random.Uniform() < options.noisy_share) {}

  Eigen::VectorXf Disturb(Eigen::VectorXf command) {
    if (!active_) return command;
    if (left_ == 0 && random_.Uniform() < options_.burst_chance) {
      left_ = 3 + random_.UniformInt(6);
      const double size = random_.Uniform(0.3, 1);
      for (int i = 0; i < 6; ++i) {
        offset_[i] = size * (i < 3 ? options_.translation_noise : options_.rotation_noise) *
                     random_.Normal();
      }
    }
    if (left_ == 0) return command;
    --left_;
    for (int i = 0; i < 6; ++i)
      command[i] = std::clamp(command[i] + static_cast<float>(offset_[i]), -1.0f, 1.0f);
    return command;
  }

 private:
  const RecordOptions& options_;
  RandomStream& random_;
  bool active_;
  int left_ = 0;
  double offset_[6] = {};
};

// Adds N(0, sigma^2) to the motion channels of what is executed; the simulator takes [-1, 1].
void AddExecutionNoise(double sigma, RandomStream& random, Eigen::VectorXf& command) {
  for (int i = 0; i < 6; ++i) {
    command[i] = std::clamp(command[i] + static_cast<float>(sigma * random.Normal()), -1.0f, 1.0f);
  }
}

Eigen::Matrix<float, 8, 1> AuxOf(const ExpertDecision& decision) {
  Eigen::Matrix<float, 8, 1> aux;
  aux << decision.target.cast<float>(), decision.destination.cast<float>(),
      decision.holding ? 1.0f : 0.0f, static_cast<float>(decision.progress);
  return aux;
}

// Rows first .. first + kLabelSteps of a path; after its end zero motion with the last gripper
// command.
Eigen::MatrixXf LabelFrom(const std::vector<Eigen::VectorXf>& path, size_t first) {
  Eigen::MatrixXf label = Eigen::MatrixXf::Zero(kLabelSteps, 7);
  for (int i = 0; i < kLabelSteps; ++i) {
    if (first + i < path.size()) {
      label.row(i) = path[first + i].transpose();
    } else {
      label(i, 6) = path.empty() ? -1.0f : path.back()[6];
    }
  }
  return label;
}

// What the policy would see now, and what the expert looks at; actions follow.
absl::Status AddFrame(SimTask& task, const PolicySpec& spec, const ExpertDecision& decision,
                      Demonstration& result) {
  DemonstrationFrame frame;
  frame.step = result.steps;
  frame.aux = AuxOf(decision);
  const auto drawing = std::chrono::steady_clock::now();
  RS_ASSIGN_OR_RETURN(Observation observation, task.Observe(spec));
  frame.proprioception = observation.proprioception;
  for (CameraView& view : observation.views) frame.views.push_back(std::move(view.image));
  result.render_seconds +=
      std::chrono::duration<double>(std::chrono::steady_clock::now() - drawing).count();
  result.frames.push_back(std::move(frame));
  return absl::OkStatus();
}

bool Finished(const SimTask& task, const Demonstration& result) {
  return result.success || result.steps >= task.horizon();
}

absl::Status Execute(SimTask& task, const Eigen::VectorXf& command, Demonstration& result) {
  RS_RETURN_IF_ERROR(task.Step(command));
  ++result.steps;
  result.success = task.Success();
  return absl::OkStatus();
}

// A turn of the expert's, with frames. Its labels reach beyond the turn: a branch goes on from
// there.
absl::Status ExpertTurn(SimTask& task, const Expert& expert, const PolicySpec& spec, int stride,
                        Demonstration& result) {
  const size_t first = result.frames.size();
  const int start = result.steps;
  std::vector<Eigen::VectorXf> path;
  for (int i = 0; i < kExpertTurn && !Finished(task, result); ++i) {
    const ExpertDecision decision = expert();
    if (i % stride == 0) RS_RETURN_IF_ERROR(AddFrame(task, spec, decision, result));
    path.push_back(decision.command);
    RS_RETURN_IF_ERROR(Execute(task, decision.command, result));
  }
  if (!result.success) {
    RS_ASSIGN_OR_RETURN(const Eigen::MatrixXf beyond, BranchLabel(task, expert));
    for (const auto& command : beyond.rowwise()) path.push_back(command.transpose());
  }
  for (size_t i = first; i < result.frames.size(); ++i) {
    result.frames[i].actions = LabelFrom(path, result.frames[i].step - start);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Demonstration> RecordExpert(SimTask& task, const Expert& expert,
                                           const RecordOptions& options, const StreamKey& key) {
  RandomStream random(key), execution(key.With("execution noise"));
  NoiseBursts noise(options, random);
  Demonstration result;
  if (options.execution_noise > 0)
    result.execution_sigma = execution.Uniform(0, options.execution_noise);
  PolicySpec recorded;
  recorded.cameras = {kAgentView, kWristView};
  recorded.image_width = recorded.image_height = options.image_size;
  std::vector<Eigen::VectorXf> path;
  while (!Finished(task, result)) {
    const ExpertDecision decision = expert();
    if (options.render && result.steps % options.stride == 0) {
      RS_RETURN_IF_ERROR(AddFrame(task, recorded, decision, result));
      if (options.simulator_state) {
        RS_ASSIGN_OR_RETURN(result.frames.back().simulator, ReadSimulator(task.sim()));
      }
    }
    path.push_back(decision.command);
    Eigen::VectorXf executed = noise.Disturb(decision.command);
    if (result.execution_sigma > 0) AddExecutionNoise(result.execution_sigma, execution, executed);
    RS_RETURN_IF_ERROR(Execute(task, executed, result));
  }
  for (DemonstrationFrame& frame : result.frames) frame.actions = LabelFrom(path, frame.step);
  return result;
}

absl::StatusOr<Eigen::MatrixXf> BranchLabel(SimTask& task, const Expert& expert) {
  const auto snapshot = task.sim().Save();
  std::vector<Eigen::VectorXf> path;
  absl::Status status;
  for (int i = 0; i < kLabelSteps && status.ok() && !task.Success(); ++i) {
    path.push_back(expert().command);
    status = task.Step(path.back());
  }
  task.sim().Restore(*snapshot);
  RS_RETURN_IF_ERROR(status);
  return LabelFrom(path, 0);
}

absl::StatusOr<Demonstration> RecordDagger(SimTask& task, const Expert& expert,
                                           const EpisodeKey& key, const DaggerOptions& options,
                                           PolicyEndpoint& policy, RandomStream random) {
  RS_RETURN_IF_ERROR(policy.StartEpisode(key));
  const PolicySpec& spec = policy.spec();
  // Turns of the policy's whose mean length gives the expert its share.
  const double hand_over =
      options.mix / (1 - options.mix) * spec.execute_steps / static_cast<double>(kExpertTurn);
  Demonstration result;
  bool expert_drives = random.Uniform() < options.mix;
  for (int chunk = 0; !Finished(task, result);) {
    if (expert_drives) {
      RS_RETURN_IF_ERROR(ExpertTurn(task, expert, spec, options.stride, result));
      expert_drives = false;
      continue;
    }
    RS_ASSIGN_OR_RETURN(const Observation observation, task.Observe(spec));
    RS_ASSIGN_OR_RETURN(const PredictedChunk predicted, policy.Predict(observation, chunk++));
    const int rows = std::min<int>(spec.execute_steps, static_cast<int>(predicted.actions.rows()));
    for (int i = 0; i < rows && !Finished(task, result); ++i) {
      RS_RETURN_IF_ERROR(Execute(task, predicted.actions.row(i).transpose(), result));
    }
    expert_drives = random.Uniform() < hand_over;
  }
  return result;
}

}  // namespace robostress
