#include "sim_worker/bench/bare_view.h"

#include <EGL/egl.h>

#include "common/check.h"
#include "sim_worker/bench/timing.h"

namespace robostress {
namespace {

constexpr int kMaxGeoms = 4000;  // as in renderer.cc

// A context with the configuration of the current one.
EGLContext CreateContextLike(EGLDisplay display, EGLContext current) {
  EGLint id = 0, count = 0;
  RS_CHECK(eglQueryContext(display, current, EGL_CONFIG_ID, &id));
  const EGLint wanted[] = {EGL_CONFIG_ID, id, EGL_NONE};
  EGLConfig config = nullptr;
  RS_CHECK(eglChooseConfig(display, wanted, &config, 1, &count) && count == 1);
  const EGLContext context = eglCreateContext(display, config, EGL_NO_CONTEXT, nullptr);
  RS_CHECK(context != EGL_NO_CONTEXT);
  return context;
}

}  // namespace

BareView::BareView(const mjModel& model, const std::string& camera, const BareViewOptions& options)
    : model_(model),
      options_(options),
      display_(eglGetCurrentDisplay()),
      renderers_context_(eglGetCurrentContext()),
      context_(CreateContextLike(display_, renderers_context_)),
      pixels_(size_t{3} * options.size * options.size) {
  MakeCurrent(context_);
  mjModel sized = model;
  sized.vis.global.offwidth = sized.vis.global.offheight = options.size;
  sized.vis.quality.offsamples = options.samples;
  sized.vis.quality.shadowsize = options.shadow_size;
  mjr_defaultContext(&render_);
  mjr_makeContext(&sized, &render_, mjFONTSCALE_50);
  mjr_setBuffer(mjFB_OFFSCREEN, &render_);
  RS_CHECK(render_.currentBuffer == mjFB_OFFSCREEN);
  mjv_defaultScene(&scene_);
  mjv_makeScene(&model, &scene_, kMaxGeoms);
  mjv_defaultOption(&visual_);
  visual_.geomgroup[0] = 0;
  mjv_defaultCamera(&camera_);
  camera_.type = mjCAMERA_FIXED;
  camera_.fixedcamid = mj_name2id(&model, mjOBJ_CAMERA, camera.c_str());
  RS_CHECK(camera_.fixedcamid >= 0);
  MakeCurrent(renderers_context_);
}

BareView::~BareView() {
  MakeCurrent(context_);
  mjr_freeContext(&render_);
  mjv_freeScene(&scene_);
  MakeCurrent(renderers_context_);
  eglDestroyContext(display_, context_);
}

void BareView::MakeCurrent(void* context) const {
  RS_CHECK(eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context));
}

double BareView::TimeOfDrawing(const mjData& data) {
  MakeCurrent(context_);
  mjv_updateScene(&model_, const_cast<mjData*>(&data), &visual_, nullptr, &camera_, mjCAT_ALL,
                  &scene_);
  scene_.flags[mjRND_SHADOW] = options_.shadows;
  scene_.flags[mjRND_REFLECTION] = options_.reflections;
  const mjrRect viewport = {0, 0, options_.size, options_.size};
  const double time = TimeOf([&] {
    mjr_render(viewport, &scene_, &render_);
    mjr_readPixels(pixels_.data(), nullptr, viewport, &render_);
  });
  MakeCurrent(renderers_context_);
  return time;
}

}  // namespace robostress
