#pragma once

#include <memory>
#include <string>

#include "sim_worker/renderer.h"
#include "sim_worker/sim_task.h"
#include "sim_worker/suites/expert.h"
#include "sim_worker/suites/task_model.h"

namespace robostress {

// One task of an embedded suite. Initial states 0 .. 49 are the reproducible ones;
// kFirstTrainingDraw and above are training draws.
class EmbeddedTask : public SimTask {
 public:
  // Unknown suites and tasks list the known ones.
  static absl::StatusOr<std::unique_ptr<EmbeddedTask>> Create(const UnitConfig& unit, int task);

  absl::Status Reset(int initial_state) override;
  absl::StatusOr<Observation> Observe(const PolicySpec& spec) override;
  absl::StatusOr<RobotState> Measure() override { return sim_->Measure(); }
  absl::Status Step(const Eigen::VectorXf& command) override { return sim_->Step(command); }
  bool Success() const override;
  int horizon() const override { return horizon_; }
  const std::string& name() const override { return name_; }
  const std::string& instruction() const override { return model_->task().instruction; }
  PandaSim& sim() override { return *sim_; }
  std::string mjcf() const override { return model_->mjcf(); }
  absl::StatusOr<Expert> MakeExpert() override;
  absl::StatusOr<Image> Film(int height) override;

  const TaskModel& model() const { return *model_; }
  ExpertDecision Decide() const { return DecideExpert(*model_, *sim_); }

  // Starts an episode from any state, e.g. one that a test made up.
  absl::Status ResetTo(const InitialState& state);

  // [8]: tool position in the base frame [m], Log(R_tool R_home^-1) [rad], finger joints [m].
  Eigen::VectorXf Proprioception() const;
  // A view at the size a policy wants: small views are rendered at twice their size and averaged.
  absl::StatusOr<Image> RenderView(const std::string& camera, int width, int height);

 private:
  EmbeddedTask() = default;

  std::string name_;
  int horizon_ = 0;
  int settle_steps_ = 0;
  std::unique_ptr<TaskModel> model_;
  std::unique_ptr<PandaSim> sim_;
  std::unique_ptr<Renderer> renderer_;  // created with the first view
};

// "put_the_pot_on_the_plate" of an instruction.
std::string TaskName(const std::string& instruction);

}  // namespace robostress
