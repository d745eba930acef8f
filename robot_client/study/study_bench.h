#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/can/in_process_bus.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/emulator/rendered_source.h"
#include "robot_client/emulator/view_renderer.h"
#include "robot_client/piper/piper_arm.h"
#include "robot_client/study/table_scene.h"

namespace robostress::piper {

struct StudyBenchOptions {
  std::string arm = "new";  // wear profile
  int task = 0;             // of kTableTasks
  int variant = 0;          // of kObjectVariants
  int image_size = 64;      // [px], square
  Follow follow = Follow::kPlanned;
};

// An emulated Piper with a task in front of it, on an in-process bus in simulated time: what a
// study has where a lab has an arm, a table and two cameras. The arm stands at TableExpert::Home
// when it is made. One thread.
class StudyBench {
 public:
  static absl::StatusOr<std::unique_ptr<StudyBench>> Create(const StudyBenchOptions& options);

  EmulatedTime& time() { return time_; }
  PiperArm& arm() { return *arm_; }  // connected, without power
  TableScene& scene() { return *scene_; }
  PiperEmulator& emulator() { return *emulator_; }
  // "base" and "wrist", in the order in which policies are trained.
  std::vector<FrameSource*> cameras() { return {cameras_[0].get(), cameras_[1].get()}; }

 private:
  StudyBench() = default;
  EmulatedTime time_;
  InProcessBus bus_{time_};
  std::unique_ptr<PiperEmulator> emulator_;
  std::unique_ptr<PiperArm> arm_;
  std::unique_ptr<TableScene> scene_;
  std::unique_ptr<ViewRenderer> renderer_;
  std::vector<std::unique_ptr<RenderedSource>> cameras_;
};

// The cameras' names for a policy and the scene's.
struct StudyCamera {
  const char* name;
  const char* scene_camera;
};
inline constexpr StudyCamera kStudyCameras[] = {{"base", "piper_base_view"},
                                                {"wrist", "piper_wrist_view"}};

}  // namespace robostress::piper
