#include "server/inference/torch_threads.h"

#include <ATen/Parallel.h>
#include <dlfcn.h>

namespace robostress {

void UseOneTorchThread() {
  // at::set_num_threads does not reach a pthread build of OpenBLAS, which keeps one count for the
  // process.
  static const bool openblas = [] {
    using SetThreads = void (*)(int);
    if (auto set_threads =
            reinterpret_cast<SetThreads>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"))) {
      set_threads(1);
    }
    return true;
  }();
  (void)openblas;
  thread_local bool done = false;
  if (done) return;
  at::set_num_threads(1);
  done = true;
}

}  // namespace robostress
