#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/libero/init_states.h"
#include "sim_worker/libero/fixture_poses.h"
#include "sim_worker/libero/predicates.h"
#include "sim_worker/libero/scene.h"
#include "sim_worker/renderer.h"
#include "sim_worker/sim_task.h"

namespace robostress::libero {

// A task of a LIBERO suite in PandaSim. The model is compiled once and kept across resets.
class LiberoSimTask : public SimTask {
 public:
  static absl::StatusOr<std::unique_ptr<LiberoSimTask>> Create(const UnitConfig& unit, int task);
  // What Create would say, sooner.
  static absl::Status Check(const UnitConfig& unit, int task);

  // Row `initial_state` of the task's .pruned_init, fixtures as unit.libero_fixtures has them for
  // it, then the settle steps with the originals' dummy command. From kFirstTrainingDraw on,
  // objects and fixtures as an environment of the originals places them that was seeded with this
  // number.
  absl::Status Reset(int initial_state) override;
  // Proprioception [8]: grip site in the world [m], axis-angle of the hand body's quaternion as
  // openpi computes it (not along the short path), finger joints [m]. Views are rendered at 256 x
  // 256, mirrored as the originals' are, and resized to the policy's size.
  absl::StatusOr<Observation> Observe(const PolicySpec& spec) override;
  absl::StatusOr<RobotState> Measure() override { return sim_->Measure(); }
  // From any state instead of a stored one, without settle steps: qpos [nq], qvel [nv]; home: the
  // posture [7] at which the originals' controller was reset.
  absl::Status ResetTo(absl::Span<const double> qpos, absl::Span<const double> qvel,
                       const Eigen::Matrix<double, 7, 1>& home);
  absl::Status Step(const Eigen::VectorXf& command) override;
  // settling: progress stays 0.
  absl::Status StepExact(const Eigen::Matrix<double, 7, 1>& command, bool settling);
  // As of the last step, like the originals' done; false after Reset.
  bool Success() const override { return success_; }
  int horizon() const override { return horizon_; }
  const std::string& name() const override { return name_; }
  const std::string& instruction() const override { return instruction_; }
  PandaSim& sim() override { return *sim_; }
  std::string mjcf() const override { return PlacedMjcf(*scene_, *placed_model_); }
  std::string problem() const override { return scene_->problem.name; }
  absl::StatusOr<Expert> MakeExpert() override;
  absl::StatusOr<Image> Film(int height) override;

  const LiberoScene& scene() const { return *scene_; }
  const LiberoGoal& goal() const { return *goal_; }
  const InitStates& init_states() const { return init_states_; }
  int settle_steps() const { return unit_.sim.settle_steps; }
  // Where the fixtures stand from the next ResetTo on, or Reset if unit.libero_fixtures is centred.
  absl::Status MoveFixtures(const std::vector<FixturePose>& poses);
  // LIBERO's init_qpos: the arm's posture at a reset, and the controller's null-space posture.
  static Eigen::Matrix<double, 7, 1> HomePosture();
  // The compiled model with the fixtures where they stand.
  const mjModel& placed_model() const { return *placed_model_; }

 private:
  LiberoSimTask() = default;
  static absl::StatusOr<std::unique_ptr<LiberoSimTask>> Read(const UnitConfig& unit, int task,
                                                             bool pictures);
  absl::Status MakeSimulator();
  absl::Status ResetDrawn(uint32_t seed);
  absl::StatusOr<Image> RenderUpright(const std::string& camera, const RenderOptions& options);

  UnitConfig unit_;
  std::string name_, instruction_;
  int horizon_ = 0;
  std::unique_ptr<LiberoScene> scene_;
  std::unique_ptr<LiberoGoal> goal_;
  InitStates init_states_;
  Scenario scenario_;
  std::unique_ptr<FixturePoses> fixture_poses_;  // null: centred, nothing moves between episodes
  // Fixtures are moved in place between episodes, on the thread that steps: sim_ and experts refer
  // to simulation_model_.
  std::shared_ptr<mjModel> placed_model_, simulation_model_;
  std::unique_ptr<PandaSim> sim_;
  std::shared_ptr<mjModel> render_model_;
  std::unique_ptr<Renderer> renderer_;  // created with the first view
  bool success_ = false;
  bool drawn_ = false;       // the episode's placement, fixtures included
  bool goal_holds_ = false;  // at the moment of the last control step at which the originals look
};

}  // namespace robostress::libero
