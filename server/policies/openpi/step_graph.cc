#include "server/policies/openpi/step_graph.h"

#include "common/check.h"

#ifdef ROBOSTRESS_CUDA_GRAPHS
#include <ATen/cuda/CUDAGraph.h>
#include <c10/cuda/CUDAGuard.h>
#include <c10/cuda/CUDAStream.h>
#endif

namespace robostress::openpi {

#ifdef ROBOSTRESS_CUDA_GRAPHS
namespace {

class CudaStepGraph : public StepGraph {
 public:
  CudaStepGraph(int device, const std::function<void()>& work) {
    const c10::cuda::CUDAGuard on_device(static_cast<c10::DeviceIndex>(device));
    c10::cuda::getCurrentCUDAStream().synchronize();  // what the work reads has been written
    const c10::cuda::CUDAStreamGuard on_stream(c10::cuda::getStreamFromPool());
    work();  // libraries allocate their workspaces outside of the recording
    c10::cuda::getCurrentCUDAStream().synchronize();
    // Other threads may go on using CUDA meanwhile.
    graph_.capture_begin({0, 0}, cudaStreamCaptureModeThreadLocal);
    work();
    graph_.capture_end();
  }
  void Replay() override { graph_.replay(); }

 private:
  at::cuda::CUDAGraph graph_;
};

}  // namespace

bool StepGraph::Available() { return true; }
std::unique_ptr<StepGraph> StepGraph::Record(int device, const std::function<void()>& work) {
  return std::make_unique<CudaStepGraph>(device, work);
}
#else
bool StepGraph::Available() { return false; }
std::unique_ptr<StepGraph> StepGraph::Record(int, const std::function<void()>&) {
  RS_CHECK(false);
  return nullptr;
}
#endif

}  // namespace robostress::openpi
