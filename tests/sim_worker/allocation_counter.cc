#include "tests/sim_worker/allocation_counter.h"

#include <atomic>
#include <cstdlib>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define ROBOSTRESS_COUNTS_ALLOCATIONS 0
#else
#define ROBOSTRESS_COUNTS_ALLOCATIONS 1
#endif

namespace {
std::atomic<long> allocations{0};
}

#if ROBOSTRESS_COUNTS_ALLOCATIONS
// NOLINTNEXTLINE(bugprone-reserved-identifier): glibc's
extern "C" void* __libc_malloc(size_t size);
extern "C" void* malloc(size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
#endif

namespace robostress {

bool CountsAllocations() { return ROBOSTRESS_COUNTS_ALLOCATIONS; }
long Allocations() { return allocations.load(); }

}  // namespace robostress
