#include "sim_worker/renderer.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/check.h"
#include "common/image.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "sim_worker/unseen_geoms.h"

namespace robostress {
namespace {

constexpr int kMaxGeoms = 4000;  // of one abstract scene; LIBERO's largest has 270
constexpr int kFirstWidth = 448,
              kFirstHeight = 448;  // [px] of the frame buffer before it has to grow

absl::Status EglError(const char* call) {
  return absl::UnavailableError(
      absl::StrFormat("%s failed with EGL error 0x%x; off-screen rendering needs an EGL driver "
                      "(Debian: libegl1 libgl1-mesa-dri)",
                      call, eglGetError()));
}

// An archive for people without root brings its own EGL (cmake/make_archive.sh). What the caller's
// environment says is stronger.
void UseOwnDrivers() {
  const std::string vendors = PathInPrefix("share/glvnd/egl_vendor.d");
  const std::string drivers = PathInPrefix("lib/dri");
  std::error_code error;
  if (!std::filesystem::exists(drivers, error)) return;
  setenv("__EGL_VENDOR_LIBRARY_DIRS", vendors.c_str(), /*overwrite=*/0);
  setenv("LIBGL_DRIVERS_PATH", drivers.c_str(), /*overwrite=*/0);
}

// The process' display. It is initialised once and stays: EGL counts no users of a display.
absl::StatusOr<EGLDisplay> OpenDisplay() {
  static std::once_flag once;
  static EGLDisplay display = EGL_NO_DISPLAY;
  std::call_once(once, [] {
    // Mesa's software rasteriser would start a thread per core in every worker; 0 renders in the
    // caller.
    setenv("LP_NUM_THREADS", "0", /*overwrite=*/0);
    UseOwnDrivers();
    const auto get_display = reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(
        eglGetProcAddress("eglGetPlatformDisplayEXT"));
    if (get_display == nullptr) return;
    const auto try_display = [](EGLDisplay candidate) {
      if (candidate != EGL_NO_DISPLAY && eglInitialize(candidate, nullptr, nullptr))
        display = candidate;
      return display != EGL_NO_DISPLAY;
    };
    // Surfaceless Mesa first: the same pixels on every machine. A GPU's driver without Mesa is a
    // device.
    if (try_display(get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr)))
      return;
    const auto query_devices =
        reinterpret_cast<PFNEGLQUERYDEVICESEXTPROC>(eglGetProcAddress("eglQueryDevicesEXT"));
    EGLDeviceEXT devices[16];
    EGLint count = 0;
    if (query_devices == nullptr || !query_devices(16, devices, &count)) return;
    for (int i = 0; i < count; ++i) {
      if (try_display(get_display(EGL_PLATFORM_DEVICE_EXT, devices[i], nullptr))) return;
    }
  });
  if (display == EGL_NO_DISPLAY) return EglError("eglGetPlatformDisplayEXT / eglInitialize");
  return display;
}

absl::StatusOr<EGLContext> CreateContext(EGLDisplay display) {
  if (!eglBindAPI(EGL_OPENGL_API)) return EglError("eglBindAPI(OpenGL)");
  constexpr EGLint kConfig[] = {EGL_SURFACE_TYPE,
                                EGL_PBUFFER_BIT,
                                EGL_RENDERABLE_TYPE,
                                EGL_OPENGL_BIT,
                                EGL_RED_SIZE,
                                8,
                                EGL_GREEN_SIZE,
                                8,
                                EGL_BLUE_SIZE,
                                8,
                                EGL_NONE};
  EGLConfig config;
  EGLint count = 0;
  if (!eglChooseConfig(display, kConfig, &config, 1, &count) || count < 1)
    return EglError("eglChooseConfig");
  const EGLContext context = eglCreateContext(display, config, EGL_NO_CONTEXT, nullptr);
  if (context == EGL_NO_CONTEXT) return EglError("eglCreateContext");
  return context;
}

}  // namespace

struct Renderer::Impl {
  explicit Impl(SharedModel shared) : model(std::move(shared)) {}
  ~Impl() {
    if (context == EGL_NO_CONTEXT) return;
    if (has_scene && MakeCurrent().ok()) {
      if (shadow_size > 0) mjr_freeContext(&render);
      mjv_freeScene(&scene);
    }
    eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display, context);
  }

  absl::Status MakeCurrent() const {
    if (eglGetCurrentContext() == context) return absl::OkStatus();
    if (!eglBindAPI(EGL_OPENGL_API) ||
        !eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context)) {
      return EglError("eglMakeCurrent");
    }
    return absl::OkStatus();
  }

  // (Re)builds MuJoCo's OpenGL objects with a frame buffer of at least width x height [px], unless
  // there is one that serves. The context must be current.
  absl::Status MakeBuffers(int width, int height, const RenderOptions& options) {
    if (render.offWidth >= width && render.offHeight >= height && samples == options.samples &&
        shadow_size == options.shadow_size) {
      return absl::OkStatus();
    }
    samples = options.samples;
    shadow_size = options.shadow_size;
    // mjr_makeContext reads these sizes from the model, which is shared: it gets a copy of the
    // struct alone.
    mjModel sized = *model;
    sized.vis.global.offwidth = std::max(width, std::max(kFirstWidth, render.offWidth));
    sized.vis.global.offheight = std::max(height, std::max(kFirstHeight, render.offHeight));
    sized.vis.quality.offsamples = samples;
    sized.vis.quality.shadowsize = shadow_size;
    mjr_makeContext(&sized, &render, mjFONTSCALE_50);  // frees what it held
    mjr_setBuffer(mjFB_OFFSCREEN, &render);
    if (render.currentBuffer != mjFB_OFFSCREEN) {
      return absl::UnavailableError(absl::StrFormat(
          "the OpenGL driver offers no off-screen frame buffer of %d x %d pixels", width, height));
    }
    return absl::OkStatus();
  }

  const SharedModel model;
  EGLDisplay display = EGL_NO_DISPLAY;
  EGLContext context = EGL_NO_CONTEXT;
  bool has_scene = false;
  int samples = 0, shadow_size = 0;  // of the buffers, if there are any
  mjrContext render;
  mjvScene scene;
  mjvOption visual;
};

absl::StatusOr<std::unique_ptr<Renderer>> Renderer::Create(SharedModel model) {
  RS_CHECK(model != nullptr);
  auto impl = std::make_unique<Impl>(std::move(model));
  RS_ASSIGN_OR_RETURN(impl->display, OpenDisplay());
  RS_ASSIGN_OR_RETURN(impl->context, CreateContext(impl->display));
  RS_RETURN_IF_ERROR(impl->MakeCurrent());
  mjr_defaultContext(&impl->render);
  mjv_defaultScene(&impl->scene);
  mjv_makeScene(impl->model.get(), &impl->scene, kMaxGeoms);
  impl->has_scene = true;
  // Group 0 is collision geometry, group 1 what is seen (robosuite's and our convention).
  mjv_defaultOption(&impl->visual);
  impl->visual.geomgroup[0] = 0;
  impl->visual.geomgroup[1] = 1;
  return std::unique_ptr<Renderer>(new Renderer(std::move(impl)));
}

Renderer::Renderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Renderer::~Renderer() = default;

absl::StatusOr<Image> Renderer::Render(const mjData& data, const std::string& camera,
                                       const RenderOptions& options) {
  Impl& r = *impl_;
  const int camera_id =
      camera.empty() ? -1 : mj_name2id(r.model.get(), mjOBJ_CAMERA, camera.c_str());
  if (camera_id < 0 && !camera.empty()) {
    std::vector<std::string> known;
    for (int i = 0; i < r.model->ncam; ++i)
      known.push_back(mj_id2name(r.model.get(), mjOBJ_CAMERA, i));
    return absl::NotFoundError(absl::StrFormat("the scene has no camera '%s'; it has: %s", camera,
                                               absl::StrJoin(known, ", ")));
  }
  const int width = options.width * options.supersample,
            height = options.height * options.supersample;
  if (options.width < 1 || options.height < 1 || options.supersample < 1 || width > 4096 ||
      height > 4096) {
    return absl::InvalidArgumentError(
        absl::StrFormat("an image of %d x %d pixels, supersampled %d times, is outside 1 .. 4096",
                        options.width, options.height, options.supersample));
  }
  if (options.samples < 0 || options.samples > 64 || options.shadow_size < 1 ||
      options.shadow_size > 16384) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%d samples a pixel or a shadow map of %d pixels is outside 0 .. 64 or 1 "
                        ".. 16384",
                        options.samples, options.shadow_size));
  }
  RS_RETURN_IF_ERROR(r.MakeCurrent());
  RS_RETURN_IF_ERROR(r.MakeBuffers(width, height, options));

  mjvCamera view;
  mjv_defaultCamera(&view);
  mjvOption visual = r.visual;
  if (camera.empty()) {
    mjv_defaultFreeCamera(r.model.get(), &view);
    mjv_defaultOption(&visual);
  } else {
    view.type = mjCAMERA_FIXED;
    view.fixedcamid = camera_id;
  }
  // MuJoCo takes mutable data for its stack, which it leaves as it was.
  mjv_updateScene(r.model.get(), const_cast<mjData*>(&data), &visual, nullptr, &view, mjCAT_ALL,
                  &r.scene);
  r.scene.flags[mjRND_SHADOW] = options.shadows;
  r.scene.flags[mjRND_REFLECTION] = options.reflections;
  if (camera_id >= 0) LeaveOutUnseen(*r.model, static_cast<double>(width) / height, r.scene);
  const mjrRect viewport = {0, 0, width, height};
  mjr_render(viewport, &r.scene, &r.render);

  Image image;
  image.width = width;
  image.height = height;
  image.data.resize(size_t{3} * width * height);
  std::vector<uint8_t> bottom_up(image.data.size());
  mjr_readPixels(bottom_up.data(), nullptr, viewport, &r.render);
  const size_t row = size_t{3} * width;
  for (int y = 0; y < height; ++y) {
    std::copy_n(bottom_up.begin() + (height - 1 - y) * row, row, image.data.begin() + y * row);
  }
  return options.supersample == 1 ? image : ResizeArea(image, options.width, options.height);
}

}  // namespace robostress
