#include "robot_client/emulator/view_renderer.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

constexpr int kMaxGeoms = 1000;
constexpr int kMaxSide = 2048;

absl::Status Refused(const char* call) {
  return absl::UnavailableError(absl::StrCat(call, " failed (EGL ", eglGetError(),
                                             "): views need EGL (Debian: libegl-mesa0 "
                                             "libgl1-mesa-dri)"));
}

}  // namespace

// An EGL context and MuJoCo's objects in it.
struct ViewRenderer::Context {
  EGLDisplay display = EGL_NO_DISPLAY;
  EGLContext egl = EGL_NO_CONTEXT;
  bool made = false;
  mjrContext render;
  mjvScene scene;
  mjvOption options;

  absl::Status Open() {
    const auto platform = reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(
        eglGetProcAddress("eglGetPlatformDisplayEXT"));
    if (platform == nullptr) return Refused("eglGetPlatformDisplayEXT");
    display = platform(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
    if (display == EGL_NO_DISPLAY || !eglInitialize(display, nullptr, nullptr))
      return Refused("eglInitialize");
    constexpr EGLint kWanted[] = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE,
                                  EGL_OPENGL_BIT, EGL_NONE};
    EGLConfig config;
    EGLint count = 0;
    if (!eglBindAPI(EGL_OPENGL_API) || !eglChooseConfig(display, kWanted, &config, 1, &count) ||
        count < 1)
      return Refused("eglChooseConfig");
    egl = eglCreateContext(display, config, EGL_NO_CONTEXT, nullptr);
    if (egl == EGL_NO_CONTEXT) return Refused("eglCreateContext");
    return MakeCurrent();
  }
  absl::Status MakeCurrent() const {
    return eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, egl) ? absl::OkStatus()
                                                                        : Refused("eglMakeCurrent");
  }
  ~Context() {
    if (egl == EGL_NO_CONTEXT) return;
    if (made && MakeCurrent().ok()) {
      mjr_freeContext(&render);
      mjv_freeScene(&scene);
    }
    eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display, egl);  // the display stays: EGL counts no users of it
  }
};

ViewRenderer::ViewRenderer(const mjModel& model, int width, int height,
                           std::unique_ptr<Context> context)
    : model_(model), width_(width), height_(height), context_(std::move(context)) {}
ViewRenderer::~ViewRenderer() = default;

absl::StatusOr<std::unique_ptr<ViewRenderer>> ViewRenderer::Create(const mjModel& model, int width,
                                                                   int height, bool shadows) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return absl::InvalidArgumentError(
        absl::StrCat("views of ", width, " x ", height, ", must be 1..", kMaxSide, " a side"));
  }
  auto context = std::make_unique<Context>();
  RS_RETURN_IF_ERROR(context->Open());
  mjr_defaultContext(&context->render);
  mjv_defaultScene(&context->scene);
  mjv_defaultOption(&context->options);
  mjv_makeScene(&model, &context->scene, kMaxGeoms);
  context->scene.flags[mjRND_SHADOW] = shadows ? 1 : 0;
  // The frame buffer's size is read from the model: a copy of the struct alone says ours.
  mjModel sized = model;
  sized.vis.global.offwidth = width;
  sized.vis.global.offheight = height;
  mjr_makeContext(&sized, &context->render, mjFONTSCALE_50);
  context->made = true;
  mjr_setBuffer(mjFB_OFFSCREEN, &context->render);
  if (context->render.currentBuffer != mjFB_OFFSCREEN)
    return absl::UnavailableError("the OpenGL driver offers no off-screen frame buffer");
  return std::unique_ptr<ViewRenderer>(new ViewRenderer(model, width, height, std::move(context)));
}

absl::StatusOr<Image> ViewRenderer::Render(mjData& data, const std::string& camera) {
  mjvCamera view;
  mjv_defaultCamera(&view);
  view.type = mjCAMERA_FIXED;
  view.fixedcamid = mj_name2id(&model_, mjOBJ_CAMERA, camera.c_str());
  if (view.fixedcamid < 0)
    return absl::NotFoundError(absl::StrCat("the scene has no camera '", camera, "'"));
  RS_RETURN_IF_ERROR(context_->MakeCurrent());
  mjv_updateScene(&model_, &data, &context_->options, nullptr, &view, mjCAT_ALL, &context_->scene);
  const mjrRect viewport = {0, 0, width_, height_};
  mjr_render(viewport, &context_->scene, &context_->render);
  const size_t row = size_t{3} * width_;
  std::vector<uint8_t> upward(row * height_);  // OpenGL's rows begin at the bottom
  mjr_readPixels(upward.data(), nullptr, viewport, &context_->render);
  Image image{width_, height_, std::vector<uint8_t>(upward.size())};
  for (int y = 0; y < height_; ++y)
    std::copy_n(upward.begin() + static_cast<long>(row) * (height_ - 1 - y), row,
                image.data.begin() + static_cast<long>(row) * y);
  return image;
}

}  // namespace robostress::piper
