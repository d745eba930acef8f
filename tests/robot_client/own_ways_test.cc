#include "robot_client/own_ways.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>

#include "robot_client/operator_console.h"
#include "tests/robot_client/fake_arm.h"

namespace robostress {
namespace {

constexpr int64_t kTick_ns = 33'333'333;
const int kOpening = ArmAxes().opening();

// An enabled arm that was told to close, and holds something 30 mm wide.
struct Grasp {
  ManualClock clock{1'000'000'000};
  FakeArm arm{&clock};
  NoCameras cameras;
  ClientConfig config;
  std::unique_ptr<ControlLoop> loop;
  std::unique_ptr<OwnWays> ways;
  ArmPath close;
  double widest = 0;  // that was commanded since it was closed

  Grasp() {
    EXPECT_TRUE(arm.Connect().ok());
    loop = *ControlLoop::Create({}, &arm, &clock, &cameras);
    ways = std::make_unique<OwnWays>(config, arm, nullptr, loop.get(), &clock, [](std::string) {});
    arm.grasped = 0.03;
    Tick(kRequestEnable);
    close.rows.assign(20, arm.Latest().position);
    for (ArmVector& row : close.rows) row[kOpening] = 0;
    loop->Play(&close);
    while (Tick() != ClientState::kEnabled) {
    }
    for (int i = 0; i < 30; ++i) Tick();
    EXPECT_NEAR(arm.Latest().position[kOpening], 0.03, 1e-9);
    EXPECT_NEAR(arm.last.position[kOpening], 0, 1e-6);
    widest = 0;
  }
  ClientState Tick(uint32_t requests = 0) {
    clock.Advance(kTick_ns);
    if (requests != 0) loop->Ask(requests);
    loop->Tick(clock.now_ns());
    widest = std::max(widest, arm.last.position[kOpening]);
    return loop->state();
  }
  std::string Finish(absl::StatusOr<PendingAnswer> pending) {
    EXPECT_TRUE(pending.ok()) << pending.status();
    if (!pending.ok()) return "";
    for (int i = 0; i < 300; ++i) {
      Tick();
      if (const auto answer = pending->answer())
        return answer->ok() ? **answer : answer->status().ToString();
    }
    return "never";
  }
};

TEST(OwnWays, AJogToClearTheWayLetsNothingFall) {
  Grasp grasp;
  EXPECT_THAT(grasp.Finish(grasp.ways->Jog(0, 0.2)), ::testing::HasSubstr("the arm is there"));
  EXPECT_NEAR(grasp.arm.Latest().position[0], 0.2, 0.01);
  EXPECT_NEAR(grasp.widest, 0, 1e-6);
}

TEST(OwnWays, AJogOfTheGripperOpensItByWhatIsSeen) {
  Grasp grasp;
  EXPECT_THAT(grasp.Finish(grasp.ways->Jog(kGripperAxis, 0.01)),
              ::testing::HasSubstr("the arm is there"));
  EXPECT_NEAR(grasp.arm.last.position[kOpening], 0.04, 1e-3);
}

}  // namespace
}  // namespace robostress
