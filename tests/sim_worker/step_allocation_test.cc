// A control step allocates nothing: this program counts what reaches malloc.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>

#include "tests/sim_worker/test_scene.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define ROBOSTRESS_COUNTS_ALLOCATIONS 0
#else
#define ROBOSTRESS_COUNTS_ALLOCATIONS 1
#endif

namespace {
std::atomic<long> allocations{0};
}

#if ROBOSTRESS_COUNTS_ALLOCATIONS
extern "C" void* __libc_malloc(size_t size);
extern "C" void* malloc(size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
#endif

namespace robostress {
namespace {

TEST(Step, AllocatesNothing) {
  if (!ROBOSTRESS_COUNTS_ALLOCATIONS) GTEST_SKIP() << "a sanitizer owns malloc";
  for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kStick}) {
    for (const OffsetMode mode : {OffsetMode::kTeleport, OffsetMode::kVelocity}) {
      SimOptions options;
      options.joint_errors.friction_law = law;
      options.joint_errors.offset_mode = mode;
      auto sim = MakeTestSim(options);
      UseScenario(*sim, "heavy_payload");
      ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
      const Eigen::VectorXf command = Command(0.3, 0.2, -0.5, 1);
      ASSERT_TRUE(sim->Step(command).ok());
      const long before = allocations.load();
      for (int i = 0; i < 20; ++i) {
        if (!sim->Step(command).ok()) FAIL();
      }
      EXPECT_EQ(allocations.load(), before);
    }
  }
}

TEST(Step, TheCounterCounts) {
  if (!ROBOSTRESS_COUNTS_ALLOCATIONS) GTEST_SKIP() << "a sanitizer owns malloc";
  const long before = allocations.load();
  auto value = std::make_unique<std::vector<int>>(1000);
  EXPECT_GT(allocations.load(), before) << value->size();
}

}  // namespace
}  // namespace robostress
