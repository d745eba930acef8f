#include "robot_client/study/study_bench.h"

#include <algorithm>
#include <limits>

#include "common/status_macros.h"
#include "robot_client/study/table_expert.h"

namespace robostress::piper {

absl::StatusOr<std::unique_ptr<StudyBench>> StudyBench::Create(const StudyBenchOptions& options) {
  std::unique_ptr<StudyBench> bench(new StudyBench);
  EmulatorOptions emulated;
  emulated.profile = options.arm;
  emulated.scene = MakeTableScene(kObjectVariants.at(static_cast<size_t>(options.variant)));
  RS_ASSIGN_OR_RETURN(const ArmVector home, TableExpert::Home());
  std::copy_n(home.begin(), kJoints, emulated.start.begin());
  emulated.opening = home[kJoints];
  RS_ASSIGN_OR_RETURN(bench->emulator_,
                      PiperEmulator::Create(emulated, bench->bus_.Attach(), bench->time_));
  bench->time_.Add(bench->emulator_.get());
  RS_ASSIGN_OR_RETURN(TableScene scene,
                      TableScene::Create(&bench->emulator_->plant(),
                                         kTableTasks.at(static_cast<size_t>(options.task))));
  bench->scene_ = std::make_unique<TableScene>(scene);
  bench->scene_->Place(TableScene::kFirstTrainingState);
  // Nobody else is on this bus, and the study's committed figures were made without these waits.
  PiperArmOptions arm;
  arm.enable_listen_ns = 0;
  arm.enable_percent = 100;
  arm.follow = options.follow;
  arm.still = std::numeric_limits<double>::infinity();
  bench->arm_ = std::make_unique<PiperArm>(bench->bus_.Attach(), bench->time_, arm);
  RS_RETURN_IF_ERROR(bench->arm_->Connect());
  RS_ASSIGN_OR_RETURN(bench->renderer_, ViewRenderer::Create(bench->emulator_->plant().model(),
                                                             options.image_size, options.image_size,
                                                             /*shadows=*/false));
  for (const StudyCamera& camera : kStudyCameras) {
    bench->cameras_.push_back(std::make_unique<RenderedSource>(
        camera.name, camera.scene_camera, &bench->emulator_->plant(), bench->renderer_.get(),
        &bench->time_));
    RS_RETURN_IF_ERROR(bench->cameras_.back()->Start());
  }
  return bench;
}

}  // namespace robostress::piper
