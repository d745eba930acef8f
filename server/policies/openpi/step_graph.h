#pragma once

#include <functional>
#include <memory>

namespace robostress::openpi {

// Work on a GPU, recorded once and then started as a whole by one call. Exists where the build has
// LibTorch 2 with CUDA.
class StepGraph {
 public:
  virtual ~StepGraph() = default;
  virtual void Replay() = 0;

  static bool Available();
  // Runs `work` on GPU `device` once to warm up, then records it; only where Available(). The
  // memory that the work reads and writes must outlive the graph. Throws what CUDA reports.
  static std::unique_ptr<StepGraph> Record(int device, const std::function<void()>& work);
};

}  // namespace robostress::openpi
