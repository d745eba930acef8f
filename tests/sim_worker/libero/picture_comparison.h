#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/safetensors.h"
#include "common/types.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/renderer.h"

namespace robostress::libero {

// How two pictures of one size differ, in levels of 255.
struct PictureDifference {
  double mean = 0;     // absolute, over pixels and channels
  int largest = 0;     // of one channel
  double visible = 0;  // share of channels that differ by more than 16
  double block = 0;    // largest |difference of means| of 8 x 8 pixels, over the three channels:
                       // edges average out in it, what is elsewhere or of another colour does not
};
PictureDifference Compare(const Image& ours, const Image& theirs);
// Ours, theirs, and eight times their absolute difference, side by side.
Image Beside(const Image& ours, const Image& theirs);

// One picture of ours beside the original's.
struct ComparedPicture {
  std::string moment, camera;  // "0.settled"; a camera's name, client.NAME when resized
  PictureDifference difference;
  Image ours, theirs;
};

struct ComparedTask {
  // At the positions that the originals' pictures show: 256 px, and 224 px as a client sends them.
  std::vector<ComparedPicture> same_state;
  // 224 px after our own reset, settle steps and motion: physics differs as well.
  std::vector<ComparedPicture> whole_way;
  // Largest difference of the eight numbers of the state [m, rad]: before the first step, and
  // moment -> after our own way.
  double start_proprioception = 0;
  std::map<std::string, double> whole_way_proprioception;
  double fixtures = 0;  // largest difference of a fixture's pose [m, quaternion]
  std::map<std::string, double> model_arrays;  // largest difference of each that decides pictures
};

// What our pictures would be if they were drawn with other options, at the same positions and 256
// px, and the processor's time for one.
struct DrawnOtherwise {
  double mean = 0;   // over pictures, as PictureDifference
  double block = 0;  // the worst picture's
  double cpu_s = 0;  // median
};
absl::StatusOr<DrawnOtherwise> CompareDrawn(const std::string& file, const std::string& suite,
                                            int task, const std::string& site,
                                            const RenderOptions& options);

// Compares what tests/sim_worker/libero/originals/look.py wrote of a task with ours. `site`: the
// site-packages of its environment, where LIBERO's and robosuite's files are.
absl::StatusOr<ComparedTask> CompareTask(const std::string& file, const std::string& suite,
                                         int task, const std::string& site);
// What a unit reads to play that task as the originals were asked to.
UnitConfig OriginalsUnit(const std::string& suite, const std::string& site);

}  // namespace robostress::libero
