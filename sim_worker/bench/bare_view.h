#pragma once

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

namespace robostress {

struct BareViewOptions {
  int size = 224;  // [px] width and height
  bool shadows = false, reflections = false;
  int samples = 0;  // of multisampling
  int shadow_size = 1024;
};

// mjr_render and mjr_readPixels of one camera and nothing else, in an OpenGL context of its own
// beside that of a Renderer, which must be current on this thread when this is made.
class BareView {
 public:
  // `model` must outlive this.
  BareView(const mjModel& model, const std::string& camera, const BareViewOptions& options);
  ~BareView();
  BareView(const BareView&) = delete;
  BareView& operator=(const BareView&) = delete;

  // CPU time of drawing `data` and reading the pixels back [s]. The abstract scene is updated
  // before; the Renderer's context is current again afterwards.
  double TimeOfDrawing(const mjData& data);
  // The last picture, bottom-up RGB.
  const std::vector<unsigned char>& pixels() const { return pixels_; }

 private:
  void MakeCurrent(void* context) const;

  const mjModel& model_;
  const BareViewOptions options_;
  void* display_;
  void* renderers_context_;
  void* context_;
  mjvCamera camera_;
  mjvOption visual_;
  mjvScene scene_;
  mjrContext render_;
  std::vector<unsigned char> pixels_;
};

}  // namespace robostress
