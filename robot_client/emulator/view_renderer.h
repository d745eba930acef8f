#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress::piper {

// Pictures of an emulated scene's cameras, off-screen through EGL (surfaceless Mesa), without a
// display. Belongs to the thread that created it; `model` outlives it.
class ViewRenderer {
 public:
  // UNAVAILABLE where EGL gives no context; the message says what to install. Without `shadows` a
  // small picture costs a tenth.
  static absl::StatusOr<std::unique_ptr<ViewRenderer>> Create(const mjModel& model, int width,
                                                              int height, bool shadows = true);
  ~ViewRenderer();
  // `data` with positions computed (mj_kinematics at least). NOT_FOUND for a camera that the scene
  // lacks.
  absl::StatusOr<Image> Render(mjData& data, const std::string& camera);

 private:
  struct Context;
  ViewRenderer(const mjModel& model, int width, int height, std::unique_ptr<Context> context);

  const mjModel& model_;
  const int width_, height_;  // [px]
  std::unique_ptr<Context> context_;
};

}  // namespace robostress::piper
