#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "common/clock.h"
#include "robot_client/emulator/piper_plant.h"

namespace robostress::piper {

struct ViewServerOptions {
  std::string prefix;             // files PREFIX.base and PREFIX.wrist, e.g. /dev/shm/piper
  int width = 320, height = 240;  // [px]
  double rate_hz = 30;
  bool shadows = true;
};

// A table to look at under an arm that stands alone: drawn, not touched.
inline constexpr char kViewAssets[] =
    R"(<texture name="view_table" type="2d" builtin="checker" rgb1="0.55 0.5 0.45" rgb2="0.4 0.37 0.33" width="128" height="128"/>
<material name="view_table" texture="view_table" texrepeat="12 12"/>)";
inline constexpr char kViewTable[] =
    R"(<geom name="view_table" type="plane" size="1.5 1.5 0.1" material="view_table" contype="0" conaffinity="0" group="1"/>)";

// Draws an emulator's base and wrist views in a thread of its own and passes them to clients
// through mapped files (cameras/mapped_frames.h), so that drawing never delays the arm's frames.
class ViewServer {
 public:
  // `plant`'s model is copied. Fails where there is no EGL or the files cannot be made.
  static absl::StatusOr<std::unique_ptr<ViewServer>> Create(const ViewServerOptions& options,
                                                            const PiperPlant& plant,
                                                            const Clock* clock);
  ~ViewServer();
  // The scene as it stands; the arm's thread, as often as it likes. Copies the positions.
  void Show(const mjData& data) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  ViewServer(const ViewServerOptions& options, const Clock* clock);
  absl::Status Serve(const std::atomic<bool>* stop);

  struct FreeModel {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
  };
  const ViewServerOptions options_;
  const Clock* const clock_;
  std::unique_ptr<mjModel, FreeModel> model_;
  std::thread thread_;
  std::atomic<bool> stop_{false}, ready_{false};

  absl::Mutex mu_;
  std::vector<double> qpos_ ABSL_GUARDED_BY(mu_);
  std::vector<double> mocap_ ABSL_GUARDED_BY(mu_);  // positions of what is placed by hand
  int64_t stamp_ns_ ABSL_GUARDED_BY(mu_) = 0;
  absl::Status status_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress::piper
