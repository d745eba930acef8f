#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/types.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

struct RenderOptions {
  int width = 224, height = 224;  // [px] of the returned image
  int supersample = 1;            // renders at this multiple and averages boxes
  bool shadows = false, reflections = false;
  // Of the frame buffer. To change them costs as much as a new Renderer.
  int samples = 0;  // of multisampling, a pixel; the driver's most where it has fewer
  int shadow_size =
      1024;  // [px] of the shadow map; 4096 costs two to seven times as much in software
};

// Renders a model's cameras off-screen through EGL (surfaceless Mesa or a GPU), without a display.
// One context per object, used on the thread that created it.
class Renderer {
 public:
  static absl::StatusOr<std::unique_ptr<Renderer>> Create(SharedModel model);
  ~Renderer();
  // No camera: from outside the whole model, with the shapes that MuJoCo's viewer shows.
  absl::StatusOr<Image> Render(const mjData& data, const std::string& camera,
                               const RenderOptions& options);

 private:
  struct Impl;
  explicit Renderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
