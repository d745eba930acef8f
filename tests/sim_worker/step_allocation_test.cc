// A control step allocates nothing: the counter sees what reaches malloc.
#include <gtest/gtest.h>

#include "tests/sim_worker/allocation_counter.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

void ExpectStepsAllocateNothing(const SimOptions& options) {
  auto sim = MakeTestSim(options);
  UseScenario(*sim, "heavy_payload");
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  const Eigen::VectorXf command = Command(0.3, 0.2, -0.5, 1);
  ASSERT_TRUE(sim->Step(command).ok());
  const long before = Allocations();
  for (int i = 0; i < 20; ++i) {
    if (!sim->Step(command).ok()) FAIL();
  }
  EXPECT_EQ(Allocations(), before);
}

TEST(Step, AllocatesNothing) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  for (const Stepping stepping : {Stepping::kFast, Stepping::kReference, Stepping::kParity}) {
    for (const FrictionLaw law : {FrictionLaw::kSgn, FrictionLaw::kStick}) {
      for (const OffsetMode mode : {OffsetMode::kTeleport, OffsetMode::kVelocity}) {
        SimOptions options;
        options.stepping = stepping;
        options.joint_errors.friction_law = law;
        options.joint_errors.offset_mode = mode;
        ExpectStepsAllocateNothing(options);
      }
    }
  }
}

TEST(Step, TheCounterCounts) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  const long before = Allocations();
  auto value = std::make_unique<std::vector<int>>(1000);
  EXPECT_GT(Allocations(), before) << value->size();
}

}  // namespace
}  // namespace robostress
