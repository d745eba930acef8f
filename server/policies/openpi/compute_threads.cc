#include "server/policies/openpi/compute_threads.h"

#include <ATen/Parallel.h>
#include <dlfcn.h>
#include <torch/types.h>

#include "common/check.h"

namespace robostress::openpi {

void SetComputeThreads(int n) {
  RS_CHECK(n >= 1);
  at::set_num_threads(n);
  // Debian chooses the BLAS when the program starts, so its functions are looked up then too.
  if (void* set = dlsym(RTLD_DEFAULT, "openblas_set_num_threads"); set != nullptr)
    reinterpret_cast<void (*)(int)>(set)(n);
}

int BlasThreads() {
  void* get = dlsym(RTLD_DEFAULT, "openblas_get_num_threads");
  return get == nullptr ? 0 : reinterpret_cast<int (*)()>(get)();
}

}  // namespace robostress::openpi
