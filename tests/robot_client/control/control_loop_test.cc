#include "robot_client/control/control_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <new>
#include <optional>
#include <thread>

#include "tests/robot_client/answer_to.h"
#include "tests/robot_client/fake_arm.h"

namespace {
thread_local bool count_allocations = false;
thread_local int allocations = 0;
void* Allocate(size_t size) {
  if (count_allocations) ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
}  // namespace

void* operator new(size_t size) { return Allocate(size); }
void* operator new[](size_t size) { return Allocate(size); }
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, size_t) noexcept { std::free(memory); }

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kPeriod_ns = 33'333'333;

struct FakeStamps : CameraStamps {
  int64_t Oldest() const override { return stamp_ns; }
  int64_t stamp_ns = 0;
};

// A client in simulated time against a fake arm; the policy moves J1 at 0.3 rad/s.
struct Bench {
  ManualClock clock{1'000'000'000};
  FakeArm arm{&clock};
  FakeStamps cameras;
  SpscRing<TickRecord> records{1 << 12};
  std::unique_ptr<ControlLoop> loop;
  std::vector<TickRecord> seen;
  bool server_alive = true, camera_alive = true;
  int latency_ticks = 0;
  std::vector<std::pair<int64_t, ArmChunk>> on_the_way;
  double policy_speed = 0.3;
  double policy_offset = 0;  // [rad], where chunks start against the observation
  std::optional<double> policy_opening;

  explicit Bench(const ControlOptions& options = {}, const ArmModel* model = nullptr) {
    EXPECT_TRUE(arm.Connect().ok());
    auto made = ControlLoop::Create(options, &arm, &clock, &cameras, model);
    EXPECT_TRUE(made.ok()) << made.status();
    loop = *std::move(made);
    loop->AddReader(&records);
    loop->OnPredictionRequested([this] { Serve(); });
  }

  void Serve() {
    PredictionRequest request;
    while (loop->prediction_requests().Pop(request)) {
      if (!server_alive) continue;
      const ArmChunk chunk = AnswerTo(request, [&](int i) {
        ArmVector target = request.position;
        target[0] += policy_offset + policy_speed * (i + 1) / 30.0;
        if (policy_opening) target[ArmAxes().opening()] = *policy_opening;
        return target;
      });
      on_the_way.emplace_back(clock.now_ns() + latency_ticks * kPeriod_ns, chunk);
    }
    Deliver();
  }
  void Deliver() {
    while (!on_the_way.empty() && on_the_way.front().first <= clock.now_ns()) {
      loop->AnswerPrediction(on_the_way.front().second);
      on_the_way.erase(on_the_way.begin());
    }
  }
  TickRecord Tick(uint32_t requests = 0) {
    clock.Advance(kPeriod_ns);
    if (camera_alive) cameras.stamp_ns = clock.now_ns() - 10'000'000;
    Deliver();
    if (requests != 0) loop->Ask(requests);
    loop->Tick(clock.now_ns());
    TickRecord record;
    while (records.Pop(record)) seen.push_back(record);
    return seen.back();
  }
  void Start() {
    Tick(kRequestEnable);
    EXPECT_EQ(loop->state(), ClientState::kEnabled);
    Tick(kRequestStart);
    EXPECT_EQ(loop->state(), ClientState::kRun);
  }
  void Ticks(int n) {
    for (int i = 0; i < n; ++i) Tick();
  }
};

double LargestStep(const std::vector<TickRecord>& records, size_t first) {
  double largest = 0;
  for (size_t i = first + 1; i < records.size(); ++i)
    largest = std::max(largest, std::abs(records[i].sent[0] - records[i - 1].sent[0]));
  return largest;
}

TEST(ControlLoopTest, SendsNothingBeforeAPersonEnables) {
  Bench bench;
  bench.Ticks(30);
  bench.Tick(kRequestStart | kRequestResume);
  EXPECT_EQ(bench.arm.sends, 0);
  EXPECT_EQ(bench.arm.enables, 0);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
}

TEST(ControlLoopTest, TheFirstCommandIsWhereTheArmStands) {
  Bench bench;
  bench.arm.bias = 0.01;
  bench.Tick(kRequestEnable);
  for (int j = 0; j < ArmAxes().count(); ++j)
    EXPECT_EQ(bench.arm.last.position[j], bench.seen.back().position[j]);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
}

TEST(ControlLoopTest, AnArmAtRestBeyondItsLimitsStartsAtTheNearestOne) {
  ManualClock clock(5);
  NoCameras cameras;
  for (const double beyond : {0.02, 0.2}) {
    RehearsalArmOptions options;
    options.start[1] = -beyond;  // J2's lower limit is 0
    FakeArm arm(&clock, options);
    ASSERT_TRUE(arm.Connect().ok());
    auto loop = ControlLoop::Create({}, &arm, &clock, &cameras);
    ASSERT_TRUE(loop.ok());
    (*loop)->Ask(kRequestEnable);
    (*loop)->Tick(clock.now_ns());
    if (beyond < 0.1) {
      EXPECT_EQ(arm.last.position[1], 0);
    } else {
      EXPECT_EQ((*loop)->state(), ClientState::kIdle);
      EXPECT_EQ(arm.enables, 0) << "it never got power";
      EXPECT_THAT(std::string((*loop)->enable_status().message()), ::testing::HasSubstr("J2"));
    }
  }
}

TEST(ControlLoopTest, AFailedEnableStaysIdleAndSaysWhy) {
  Bench bench;
  bench.arm.refuse_enable = true;
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()), ::testing::HasSubstr("no power"));
}

TEST(ControlLoopTest, PlaysTenRowsOfEachPredictionAndRecordsEveryStage) {
  Bench bench;
  bench.Start();
  bench.Ticks(45);
  int played = 0;
  for (const TickRecord& r : bench.seen) {
    if (r.state != ClientState::kRun) continue;
    ASSERT_TRUE(r.flags & kTickPlayed);
    EXPECT_EQ(r.row, played % 10);
    EXPECT_EQ(r.chunk, played / 10);
    EXPECT_EQ(r.policy, r.blended) << "in time: nothing to fade";
    EXPECT_EQ(r.corrected, r.blended) << "no observer";
    EXPECT_TRUE(r.flags & kTickSent);
    ++played;
  }
  EXPECT_EQ(played, 46);
}

TEST(ControlLoopTest, EntersLateChunksAtTheDueRowAndStaysSmooth) {
  Bench bench;
  bench.latency_ticks = 3;
  bench.Start();
  bench.Ticks(60);
  int entered = 0;
  for (const TickRecord& r : bench.seen) {
    if (!(r.flags & kTickEntered)) continue;
    if (entered++ > 0) {
      EXPECT_EQ(r.row, 3);
    }
  }
  EXPECT_GE(entered, 5);
  EXPECT_LE(LargestStep(bench.seen, 0), 1.0 / 30 + 1e-9);
}

TEST(ControlLoopTest, AnEmptyQueueDeceleratesHoldsAndGoesOnByItself) {
  Bench bench;
  bench.Start();
  bench.Ticks(9);
  bench.server_alive = false;
  bench.Ticks(10 + 12);  // late rows, then braking
  EXPECT_TRUE(bench.seen.back().flags & kTickStarved);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  const double held = bench.seen.back().sent[0];
  bench.Ticks(5);
  EXPECT_EQ(bench.seen.back().sent[0], held);
  bench.server_alive = true;
  // The lost answer is not waited for forever: HOLD ends the wait.
  bench.Ticks(60);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kServerSilent);
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  bench.Tick();
  EXPECT_TRUE(bench.seen.back().flags & kTickPlayed);
}

// Cause by cause: what happens in mid-motion, which state follows, and how long the command moves.
struct Mishap {
  const char* name;
  void (*happen)(Bench&);
  ClientState state;
  StateCause cause;
  int within_ticks;
};
class MishapTest : public ::testing::TestWithParam<Mishap> {};

TEST_P(MishapTest, TheArmHoldsInTime) {
  const Mishap& mishap = GetParam();
  Bench bench;
  bench.policy_speed = 0.6;
  bench.Start();
  bench.Ticks(25);
  ASSERT_GT(std::abs(bench.seen.back().sent[0] - bench.seen[bench.seen.size() - 2].sent[0]), 0.01);
  mishap.happen(bench);
  int ticks = 0;
  while (bench.Tick().state != mishap.state && ticks < 200) ++ticks;
  EXPECT_EQ(bench.loop->state(), mishap.state);
  EXPECT_EQ(bench.seen.back().cause, mishap.cause);
  EXPECT_LE(ticks, mishap.within_ticks);
  const int sends = bench.arm.sends;
  bench.Ticks(40);  // 1 rad/s is gone after 9; then the command goes back to where the arm stands
  const ArmVector rest = bench.arm.last.position;
  bench.Ticks(100);
  EXPECT_EQ(bench.arm.last.position, rest) << "it does not move any more";
  if (mishap.state == ClientState::kFault) {
    EXPECT_EQ(bench.arm.sends, sends) << "a fault sends nothing";
  }
  EXPECT_EQ(bench.arm.enables, 1) << "nothing enables it again";
  EXPECT_EQ(bench.arm.disables, 0) << "nothing drops it";
}

INSTANTIATE_TEST_SUITE_P(
    Causes, MishapTest,
    ::testing::Values(Mishap{"server_killed", [](Bench& b) { b.server_alive = false; },
                             ClientState::kHold, StateCause::kServerSilent, 82},
                      Mishap{"camera_unplugged", [](Bench& b) { b.camera_alive = false; },
                             ClientState::kHold, StateCause::kCameraStale, 15},
                      Mishap{"arm_silent", [](Bench& b) { b.arm.silent = true; },
                             ClientState::kHold, StateCause::kArmSilent, 2},
                      Mishap{"arm_silent_for_long", [](Bench& b) { b.arm.silent = true; },
                             ClientState::kFault, StateCause::kArmSilent, 8},
                      Mishap{"arm_fault", [](Bench& b) { b.arm.faults = kFaultCollision; },
                             ClientState::kFault, StateCause::kArmFault, 0},
                      Mishap{"enable_lost", [](Bench& b) { b.arm.lost_enable = true; },
                             ClientState::kFault, StateCause::kArmDisabled, 0},
                      Mishap{"bus_off", [](Bench& b) { b.arm.refuse_send = true; },
                             ClientState::kHold, StateCause::kSendFailed, 3},
                      Mishap{"blocked",
                             [](Bench& b) {
                               b.arm.blocked = true;
                               b.policy_speed = 2;
                               b.policy_offset = 0.4;
                             },
                             ClientState::kHold, StateCause::kBlocked, 60},
                      Mishap{"operator", [](Bench& b) { b.loop->Ask(kRequestHold); },
                             ClientState::kHold, StateCause::kOperator, 0}),
    [](const auto& info) { return std::string(info.param.name); });

TEST(ControlLoopTest, TheSecondStageOfAStopRepeatsTheDampedStop) {
  Bench bench;
  bench.Start();
  bench.Ticks(20);
  bench.Tick(kRequestHold);
  EXPECT_EQ(bench.arm.quick_stops, 0);
  bench.Tick(kRequestQuickStop);
  const int sends = bench.arm.sends;
  bench.Ticks(10);
  EXPECT_EQ(bench.arm.quick_stops, 11);
  EXPECT_EQ(bench.arm.sends, sends);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kQuickStop);
}

TEST(ControlLoopTest, APressHoldsAndASecondOneSoonAfterIsTheQuickStop) {
  Bench bench;
  std::atomic<int> presses{0};
  bench.loop->ObeyStops(&presses);
  bench.Start();
  bench.Ticks(10);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  bench.Ticks(95);  // more than three seconds
  bench.Tick(kRequestResume);
  bench.Ticks(10);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold) << "a first press again";
  bench.Ticks(20);
  EXPECT_EQ(bench.arm.quick_stops, 0);
  ++presses;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.arm.quick_stops, 1);
}

TEST(ControlLoopTest, TwoPressesBetweenTwoTicksAreTheQuickStop) {
  Bench bench;
  std::atomic<int> presses{0};
  bench.loop->ObeyStops(&presses);
  bench.Start();
  presses += 2;
  bench.Tick();
  EXPECT_EQ(bench.seen.back().cause, StateCause::kQuickStop);
}

TEST(ControlLoopTest, AfterAFaultTheArmMustBeClearedAndEnabledAgain) {
  Bench bench;
  bench.Start();
  bench.Ticks(10);
  bench.arm.faults = kFaultStall;
  bench.Tick();
  ASSERT_EQ(bench.loop->state(), ClientState::kFault);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kMoving);
  bench.Ticks(30);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kFaults);
  bench.arm.faults = 0;
  bench.Ticks(5);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault) << "latched";
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  bench.Tick(kRequestEnable);
  bench.Tick(kRequestStart);
  bench.Ticks(3);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  EXPECT_EQ(bench.loop->episode(), 1);
}

// ----------------------------------------------------------- set going only where it stands now

TEST(ControlLoopTest, NothingIsEnabledOnAPoseThatIsOld) {
  Bench bench;
  bench.Ticks(10);
  bench.arm.silent = true;
  bench.Ticks(3);
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_EQ(bench.arm.enables, 0) << "it got no power";
  EXPECT_EQ(bench.arm.sends, 0);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()),
              ::testing::AllOf(::testing::HasSubstr("old"), ::testing::HasSubstr("ms")));
}

TEST(ControlLoopTest, AnArmThatMovesIsNotEnabledClearedOrStarted) {
  Bench bench;
  bench.arm.drift = 0.06;
  bench.Ticks(3);
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_EQ(bench.arm.enables, 0);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()), ::testing::HasSubstr("moves"));
  bench.arm.drift = 0;
  bench.Ticks(5);
  bench.Tick(kRequestEnable);
  ASSERT_EQ(bench.loop->state(), ClientState::kEnabled);
  bench.arm.drift = 0.06;
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kMoving);
}

// As it was found: a fault for silence, the arm moved by hand meanwhile, clear, enable.
TEST(ControlLoopTest, AfterSilenceTheFirstCommandIsWhereTheArmIsNow) {
  Bench bench;
  bench.Start();
  bench.Ticks(20);
  bench.arm.silent = true;
  bench.Ticks(12);
  ASSERT_EQ(bench.loop->state(), ClientState::kFault);
  bench.Tick(kRequestClear);
  EXPECT_EQ(bench.loop->state(), ClientState::kFault) << "nobody knows where it is";
  EXPECT_EQ(bench.loop->refusal(), Refusal::kStale);
  bench.arm.silent = false;
  bench.arm.bias = 0.4;  // somewhere else
  bench.arm.Send({bench.arm.Latest().position}).IgnoreError();
  bench.Ticks(60);
  bench.Tick(kRequestClear);
  ASSERT_EQ(bench.loop->state(), ClientState::kIdle);
  const ArmVector stands = bench.arm.Latest().position;
  bench.Tick(kRequestEnable);
  ASSERT_EQ(bench.loop->state(), ClientState::kEnabled);
  for (int j = 0; j < ArmAxes().joints; ++j)
    EXPECT_NEAR(bench.arm.last.position[j], stands[j], 1e-3) << j;
  bench.Ticks(10);
  for (int j = 0; j < ArmAxes().joints; ++j)
    EXPECT_NEAR(bench.arm.last.position[j], stands[j], 1e-3) << j;
}

TEST(ControlLoopTest, AnEpisodeStartsOnlyWhereTheArmIsSent) {
  Bench bench;
  bench.Tick(kRequestEnable);
  bench.Ticks(5);
  bench.arm.blocked = true;
  bench.arm.bias = 0;
  bench.arm.blocked_at(0, bench.arm.Latest().position[0] + 0.2);
  bench.Ticks(2);
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kApart);
}

TEST(ControlLoopTest, AnEnableThatIsUnderWayIsCancelledByAPress) {
  struct SlowArm : FakeArm {
    using FakeArm::FakeArm;
    absl::Status Enable(const std::function<bool()>& cancelled) override {
      during();
      return cancelled() ? absl::CancelledError("cancelled") : FakeArm::Enable(cancelled);
    }
    std::function<void()> during;
  };
  for (int kind = 0; kind < 3; ++kind) {
    ManualClock clock{1'000'000'000};
    SlowArm arm(&clock);
    ASSERT_TRUE(arm.Connect().ok());
    NoCameras cameras;
    auto loop = *ControlLoop::Create({}, &arm, &clock, &cameras);
    std::atomic<int> presses{0}, gentle{0};
    loop->ObeyStops(&presses, &gentle);
    arm.during = [&] {
      if (kind == 0) ++presses;
      if (kind == 1) ++gentle;
      if (kind == 2) loop->Ask(kRequestHold);
    };
    loop->Ask(kRequestEnable);
    loop->Tick(clock.now_ns());
    EXPECT_EQ(loop->state(), ClientState::kIdle) << kind;
    EXPECT_EQ(arm.enables, 0) << kind;
  }
}

TEST(ControlLoopTest, ATerminationHoldsHoweverOftenItComes) {
  Bench bench;
  std::atomic<int> presses{0}, gentle{0};
  bench.loop->ObeyStops(&presses, &gentle);
  bench.Start();
  bench.Ticks(10);
  gentle += 2;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  ++gentle;
  bench.Ticks(10);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.arm.quick_stops, 0) << "the arm does not sink";
}

// ------------------------------------------------------------------------- pressing and bounds

// Torques of nothing, and a wall at J1 = `wall`.
struct WallModel : ArmModel {
  ArmVector Torque(const ArmVector&, const ArmVector&, const ArmVector&,
                   double payload_kg) const override {
    ArmVector torque{};
    torque[1] = 10 * payload_kg;
    return torque;
  }
  Clearance ClearanceAt(const ArmVector& position) const override {
    return {wall - position[0], 1, 1};
  }
  double wall = 10;
};

TEST(ControlLoopTest, TorqueBeyondTheModelIsHeldWithinTenthsAndTheCommandGoesBack) {
  WallModel model;
  Bench bench({}, &model);
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(10);
  bench.arm.blocked = true;
  bench.arm.effort[1] = 10.9;  // 5 Nm a payload explains, 6 are allowed
  bench.Ticks(10);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  bench.arm.effort[1] = 11.1;
  int ticks = 1;
  for (; bench.Tick().state == ClientState::kRun; ++ticks) ASSERT_LT(ticks, 10);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kPressing);
  EXPECT_LE(ticks, 3) << "0.1 s";
  EXPECT_NEAR(bench.seen.back().excess[1], 6.1, 1e-9);
  bench.Ticks(90);
  for (int j = 0; j < ArmAxes().joints; ++j) {
    EXPECT_NEAR(bench.arm.last.position[j], bench.seen.back().position[j] - (j <= 1 ? 0.02 : 0),
                1e-3)
        << "J1 and J2 give way to what they press against";
  }
  bench.arm.effort[1] = 60;
  Bench sudden({}, &model);
  sudden.Start();
  sudden.Ticks(5);
  sudden.arm.effort[1] = 17.1;
  EXPECT_EQ(sudden.Tick().state, ClientState::kHold) << "twice as much at once";
}

TEST(ControlLoopTest, AnArmThatGivesWayDoesNotDoSoForEver) {
  WallModel model;
  Bench bench({}, &model);
  bench.Tick(kRequestEnable);
  const double stood = bench.arm.Latest().position[1];
  bench.arm.effort[1] = 30;  // a weight that nobody declared
  bench.Ticks(300);
  EXPECT_NEAR(bench.arm.last.position[1], stood - 0.2, 1e-6);
}

TEST(ControlLoopTest, ABlockedJointIsHeldThoughEachChunkBeginsWhereItStands) {
  Bench bench;  // no model: an arm without torques
  bench.policy_speed = 0.6;
  bench.Start();
  bench.Ticks(25);
  bench.arm.blocked = true;
  int ticks = 0;
  while (bench.Tick().state == ClientState::kRun && ticks < 100) ++ticks;
  EXPECT_EQ(bench.seen.back().cause, StateCause::kBlocked);
  EXPECT_LE(ticks, 40);
  double worst = 0;
  for (const TickRecord& r : bench.seen)
    worst = std::max(worst, std::abs(r.sent[0] - r.position[0]));
  EXPECT_LT(worst, 0.35) << "the following error alone would not have seen it";
}

TEST(ControlLoopTest, AFaultLetsGoOnceAndThenSendsNothing) {
  Bench bench;
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(15);
  bench.arm.blocked = true;
  bench.Ticks(5);
  ASSERT_GT(std::abs(bench.arm.last.position[0] - bench.arm.Latest().position[0]), 0.05);
  bench.arm.faults = kFaultStall;
  const int sends = bench.arm.sends;
  bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  EXPECT_EQ(bench.arm.sends, sends + 1);
  EXPECT_EQ(bench.arm.last.position[0], bench.arm.Latest().position[0]);
  bench.Ticks(10);
  EXPECT_EQ(bench.arm.sends, sends + 1);
}

// In mid-motion, with something 30 mm wide between fingers that were told to close.
struct GraspBench : Bench {
  GraspBench() {
    policy_speed = 0.9;
    policy_opening = 0;
    arm.grasped = 0.03;
    Start();
    Ticks(20);
    EXPECT_NEAR(Opening(), 0, 1e-4);
    arm.blocked = true;
    Ticks(5);
  }
  double Opening() const { return arm.last.position[ArmAxes().opening()]; }
  void Fault(uint32_t fault) {
    arm.faults = fault;
    Tick();
    EXPECT_EQ(loop->state(), ClientState::kFault);
  }
  void EnableAgain() {
    arm.faults = 0;
    Ticks(10);
    Tick(kRequestClear);
    Tick(kRequestEnable);
    EXPECT_EQ(loop->state(), ClientState::kEnabled);
  }
};

TEST(ControlLoopTest, WhatTheGripperHoldsStaysHeldWhereTheJointsLetGo) {
  GraspBench held;
  for (int i = 0; i < 60 && held.loop->state() == ClientState::kRun; ++i) held.Tick();
  EXPECT_EQ(held.loop->cause(), StateCause::kBlocked);
  held.Ticks(60);
  EXPECT_NEAR(held.arm.last.position[0], held.arm.Latest().position[0], 0.03);
  EXPECT_NEAR(held.Opening(), 0, 1e-4);

  GraspBench fault;
  fault.Fault(kFaultStall);
  EXPECT_EQ(fault.arm.last.position[0], fault.arm.Latest().position[0]);
  EXPECT_NEAR(fault.Opening(), 0, 1e-4);
  fault.EnableAgain();
  EXPECT_EQ(fault.arm.last.position[0], fault.arm.Latest().position[0]);
  EXPECT_NEAR(fault.Opening(), 0, 1e-4);
}

// Somebody's fingers may be between its own.
TEST(ControlLoopTest, AGripperThatWasLimpOrAtFaultDoesNotCloseAgain) {
  GraspBench limp;
  limp.Fault(kFaultStall);
  limp.arm.lost_enable = true;
  limp.Ticks(3);
  limp.arm.lost_enable = false;
  limp.EnableAgain();
  EXPECT_NEAR(limp.Opening(), 0.03, 1e-9);

  GraspBench strained;
  strained.arm.blocked = false;
  strained.policy_speed = 0;
  strained.Ticks(60);
  strained.Fault(kFaultGripper);
  EXPECT_NEAR(strained.Opening(), 0.03, 1e-9) << "though its joints stand at their command";
  strained.EnableAgain();
  EXPECT_NEAR(strained.Opening(), 0.03, 1e-9);
}

TEST(ControlLoopTest, IsSettledOnceCommandAndArmStand) {
  Bench bench;
  EXPECT_TRUE(bench.loop->settled());
  bench.policy_speed = 0.9;
  bench.Start();
  bench.Ticks(20);
  EXPECT_FALSE(bench.loop->settled());
  bench.loop->Ask(kRequestHold);
  EXPECT_FALSE(bench.loop->settled());
  int ticks = 0;
  while (!bench.loop->settled() && ++ticks < 60) bench.Tick();
  EXPECT_GT(ticks, 5) << "it brakes";
  EXPECT_LT(ticks, 30);
  const ArmVector rest = bench.arm.last.position;
  bench.loop->Ask(kRequestResume);
  EXPECT_FALSE(bench.loop->settled()) << "who knows what becomes of it";
  bench.loop->Ask(kRequestHold);
  bench.Ticks(10);
  EXPECT_TRUE(bench.loop->settled());
  EXPECT_EQ(bench.arm.last.position, rest);
}

TEST(ControlLoopTest, NoCommandAndNoBrakingCrossesABoundOfTheWorkspace) {
  WallModel model;
  model.wall = 0.45;
  Bench bench({}, &model);
  bench.policy_speed = 1.4;
  bench.Start();
  for (int i = 0; i < 120 && bench.loop->state() == ClientState::kRun; ++i) bench.Tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.seen.back().cause, StateCause::kWorkspace);
  EXPECT_EQ(bench.loop->crossed(), ArmModel::kTable);
  double furthest = 0;
  for (const TickRecord& r : bench.seen) furthest = std::max(furthest, r.sent[0]);
  EXPECT_LE(furthest, model.wall);
  EXPECT_GT(furthest, model.wall - 0.1) << "it goes up to it";
  bench.Ticks(20);
  bench.policy_speed = -0.6;
  bench.Tick(kRequestResume);
  bench.Ticks(60);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun)
      << CauseName(bench.loop->cause()) << ": away from it is free";
  EXPECT_LT(bench.seen.back().sent[0], furthest - 0.2);
}

// What of the way to rest is not looked at may cross a bound.
TEST(ControlLoopTest, AnArmThatBrakesForLongerThanIsLookedAheadIsRefused) {
  WallModel model;
  ManualClock clock{1'000'000'000};
  FakeArm arm(&clock);
  FakeStamps cameras;
  ASSERT_TRUE(arm.Connect().ok());
  ControlOptions options;
  const auto create = [&](const ArmModel* known) {
    return ControlLoop::Create(options, &arm, &clock, &cameras, known).status();
  };
  options.rate_hz = 200;
  EXPECT_TRUE(create(&model).ok());
  options.limits.joint_velocity = 3;
  const absl::Status refused = create(&model);
  EXPECT_TRUE(absl::IsInvalidArgument(refused));
  EXPECT_THAT(std::string(refused.message()),
              ::testing::AllOf(HasSubstr("joint_velocity is 3 rad/s, joint_acceleration 5 rad/s^2"),
                               HasSubstr("control.rate_hz 200: J1 brakes for up to 16"),
                               HasSubstr("looked for in 100; lower the velocity")));
  EXPECT_TRUE(create(nullptr).ok()) << "nothing is looked for";
  options.workspace.guard = false;
  EXPECT_TRUE(create(&model).ok());
  options.workspace.guard = true;
  options.rate_hz = 100;
  EXPECT_TRUE(create(&model).ok());
  options.limits.gripper_acceleration = 0.1;
  EXPECT_THAT(std::string(create(&model).message()), HasSubstr("gripper_acceleration 0.1"));
}

TEST(ControlLoopTest, APolicyRunsOnlyInsideTheWorkspace) {
  WallModel model;
  model.wall = -0.05;  // the arm stands 50 mm into it
  Bench bench({}, &model);
  bench.Tick(kRequestEnable);
  bench.Tick(kRequestStart);
  EXPECT_EQ(bench.loop->state(), ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kOutside);
  EXPECT_EQ(bench.loop->crossed(), ArmModel::kTable);
  EXPECT_NEAR(bench.loop->outside_m(), 0.05, 1e-9);
  ArmPath out;
  for (int i = 1; i <= 60; ++i) {
    out.rows.push_back(bench.arm.Latest().position);
    out.rows.back()[0] = -0.2 * i / 60;
  }
  bench.loop->Play(&out);
  for (int i = 0; i < 150 && bench.loop->cause() != StateCause::kArrived; ++i) bench.Tick();
  ASSERT_EQ(bench.loop->cause(), StateCause::kArrived) << "a way of the client's own leads out";
  bench.Ticks(10);
  bench.Tick(kRequestStart);
  ASSERT_EQ(bench.loop->state(), ClientState::kRun);
  bench.Tick(kRequestHold);
  bench.Ticks(20);
  model.wall = -0.3;
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kOutside);
  model.wall = 10;
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kNone);
}

TEST(ControlLoopTest, ADelayThatIsConstantIsEstimatedAndHeld) {
  struct LateArm : FakeArm {
    using FakeArm::FakeArm;
    absl::Status Send(const ArmCommand& command) override {
      late.push_back(command);
      if (static_cast<int>(late.size()) <= delay_ticks) return absl::OkStatus();
      const ArmCommand due = late.front();
      late.erase(late.begin());
      return FakeArm::Send(due);
    }
    std::vector<ArmCommand> late;
    int delay_ticks = 0;
  };
  for (const int delay_ticks : {0, 2, 8}) {
    ManualClock clock{1'000'000'000};
    RehearsalArmOptions quick;
    quick.lag_s = 0.03;
    LateArm arm(&clock, quick);
    arm.delay_ticks = delay_ticks;
    ASSERT_TRUE(arm.Connect().ok());
    NoCameras cameras;
    auto loop = *ControlLoop::Create({}, &arm, &clock, &cameras);
    ArmPath path;
    for (int i = 0; i < 150; ++i) {
      path.rows.push_back(quick.start);
      path.rows.back()[0] += 0.3 * (1 - std::cos(2 * M_PI * 0.4 * i / 30));
    }
    const auto tick = [&] {
      clock.Advance(kPeriod_ns);
      loop->Tick(clock.now_ns());
      return loop->last_record();
    };
    loop->Ask(kRequestEnable);
    tick();
    ASSERT_EQ(loop->state(), ClientState::kEnabled);
    loop->Play(&path);
    double delay = 0;
    for (int i = 0; i < 140; ++i) {
      const TickRecord r = tick();
      if (std::isfinite(r.delay_s)) delay = r.delay_s;
      if (r.state != ClientState::kMove) break;
    }
    EXPECT_NEAR(delay, (delay_ticks + 1.5) / 30.0, 1.1 / 30) << delay_ticks;
    EXPECT_EQ(loop->state(), delay_ticks == 8 ? ClientState::kHold : ClientState::kMove);
    if (delay_ticks == 8) {
      EXPECT_EQ(loop->cause(), StateCause::kDelayed);
    }
  }
}

TEST(ControlLoopTest, AWayOfItsOwnArrivesAndEnterStopsItAtOnce) {
  Bench bench;
  bench.server_alive = false;  // nobody else is needed
  bench.camera_alive = false;
  bench.Tick(kRequestEnable);
  ArmPath path;
  const ArmVector from = bench.arm.Latest().position;
  for (int i = 1; i <= 60; ++i) {
    path.rows.push_back(from);
    path.rows.back()[2] += 0.3 * i / 60;
  }
  bench.loop->Play(&path);
  int ticks = 0;
  while (bench.Tick().state != ClientState::kEnabled || ticks == 0) ASSERT_LT(++ticks, 120);
  EXPECT_EQ(bench.loop->cause(), StateCause::kArrived);
  EXPECT_NEAR(bench.arm.Latest().position[2], from[2] + 0.3, 0.03);
  EXPECT_EQ(bench.seen.back().episode, -1) << "no episode";
  bench.Ticks(20);

  ArmPath back;
  for (int i = 1; i <= 60; ++i) {
    back.rows.push_back(path.rows.back());
    back.rows.back()[2] -= 0.3 * i / 60;
  }
  bench.loop->Play(&back);
  bench.Ticks(20);
  ASSERT_EQ(bench.loop->state(), ClientState::kMove);
  EXPECT_EQ(bench.Tick(kRequestHold).state, ClientState::kEnabled) << "the very tick";
  bench.Ticks(12);
  const ArmVector rest = bench.arm.last.position;
  bench.Ticks(20);
  EXPECT_EQ(bench.arm.last.position, rest);
}

TEST(ControlLoopTest, AWayThatBeginsElsewhereIsReachedWithinTheLimits) {
  Bench bench;
  bench.Tick(kRequestEnable);
  ArmPath path;
  for (int i = 0; i < 30; ++i) {
    path.rows.push_back(bench.arm.Latest().position);
    path.rows.back()[0] += 0.5;
  }
  bench.loop->Play(&path);
  bench.Ticks(60);
  EXPECT_LE(LargestStep(bench.seen, 0), 1.0 / 30 + 1e-9);
}

TEST(ControlLoopTest, NonsenseFromThePolicyIsNotASilentServer) {
  for (const bool invalid : {false, true}) {
    Bench bench;
    bench.Start();
    bench.Ticks(15);
    if (invalid) {
      bench.policy_offset = std::numeric_limits<double>::quiet_NaN();
    } else {
      bench.loop->NoteRecordFailed();
    }
    int ticks = 0;
    while (bench.Tick().state == ClientState::kRun && ticks < 100) ++ticks;
    EXPECT_LE(ticks, 12) << "the next chunk and a tick";
    EXPECT_EQ(bench.seen.back().cause,
              invalid ? StateCause::kPolicyInvalid : StateCause::kRecordFailed);
  }
}

TEST(ControlLoopTest, TheObserverCorrectsButThePolicysTargetStaysOnRecord) {
  Bench bench({.observer = true});
  bench.policy_speed = 0;
  bench.policy_offset = 0.02;  // the arm is always asked a little further: an error that stays
  bench.Start();
  bench.Ticks(60);
  bool corrected = false;
  for (const TickRecord& r : bench.seen) {
    if (!(r.flags & kTickPlayed)) continue;
    EXPECT_EQ(r.policy, r.requested);
    const double correction = r.corrected[0] - r.blended[0];
    EXPECT_LE(std::abs(correction), 0.05 + 1e-12);
    corrected = corrected || std::abs(correction) > 1e-4;
    EXPECT_EQ(r.corrected[6], r.blended[6]) << "not the gripper";
  }
  EXPECT_TRUE(corrected);
}

TEST(ControlLoopTest, AReaderThatIsTooSlowIsToldSo) {
  Bench bench;
  SpscRing<TickRecord> small(2);
  bench.loop->AddReader(&small);
  bench.Ticks(5);
  TickRecord record;
  ASSERT_TRUE(small.Pop(record));
  EXPECT_EQ(record.tick, 1u);
  bench.Tick();
  ASSERT_TRUE(small.Pop(record));
  ASSERT_TRUE(small.Pop(record));
  EXPECT_EQ(record.tick, 6u);
  EXPECT_TRUE(record.flags & kTickLost);
}

// Somebody who wants J1 elsewhere.
struct LiveFake : LiveTarget {
  void Begin(const ArmVector& command) override { target = command; }
  bool Silent(int64_t) const override { return silent; }
  LiveRow Next(int64_t, const ArmVector&) override {
    LiveRow row{target, target, joining};
    row.wanted[0] += 0.2;
    row.target[0] += 0.1;
    return row;
  }
  ArmVector target{};
  bool silent = false, joining = false;
};

TEST(ControlLoopTest, FollowsALiveTargetUnderItsLimitsUntilAPersonHolds) {
  Bench bench;
  LiveFake live;
  int heard = 0;
  bench.loop->OnTick([&](const TickRecord&) { ++heard; });
  bench.Tick(kRequestEnable);
  bench.loop->Follow(&live);
  TickRecord record = bench.Tick();
  EXPECT_EQ(record.state, ClientState::kMove);
  EXPECT_TRUE(record.flags & kTickLive);
  EXPECT_NEAR(record.requested[0] - live.target[0], 0.2, 1e-12) << "what is wanted";
  EXPECT_NEAR(record.blended[0] - live.target[0], 0.1, 1e-12) << "where it goes now";
  EXPECT_LT(record.sent[0] - live.target[0], 0.01) << "the limiter is last";
  live.joining = true;
  EXPECT_TRUE(bench.Tick().flags & kTickJoining);
  bench.Ticks(60);
  EXPECT_NEAR(bench.arm.last.position[0] - live.target[0], 0.1, 1e-3);
  record = bench.Tick(kRequestHold);
  EXPECT_EQ(record.state, ClientState::kEnabled);
  EXPECT_FALSE(record.flags & kTickLive);
  EXPECT_EQ(heard, 64);
}

TEST(ControlLoopTest, ASilentSourceHoldsTheArmAndDoesNotBegin) {
  Bench bench;
  LiveFake live;
  live.silent = true;
  bench.Tick(kRequestEnable);
  bench.loop->Follow(&live);
  EXPECT_EQ(bench.Tick().state, ClientState::kEnabled);
  EXPECT_EQ(bench.loop->refusal(), Refusal::kHeld);
  live.silent = false;
  bench.loop->Follow(&live);
  EXPECT_EQ(bench.Tick().state, ClientState::kMove);
  live.silent = true;
  const TickRecord record = bench.Tick();
  EXPECT_EQ(record.state, ClientState::kHold);
  EXPECT_EQ(record.cause, StateCause::kInputSilent);
  EXPECT_FALSE(record.flags & kTickLive);
  // A way of the client's own after it is not judged by the source.
  bench.Tick(kRequestEnd);
  const ArmPath path{{bench.loop->seen().position}};
  bench.loop->Play(&path);
  EXPECT_EQ(bench.Tick().state, ClientState::kMove);
}

TEST(ControlLoopTest, AllocatesNothingOnceItRuns) {
  Bench bench({.observer = true});
  bench.latency_ticks = 2;
  bench.Start();
  ArmChunk chunk;
  bench.loop->OnPredictionRequested(nullptr);
  const auto tick = [&bench] {
    bench.clock.Advance(kPeriod_ns);
    bench.cameras.stamp_ns = bench.clock.now_ns();
    count_allocations = true;
    bench.loop->Tick(bench.clock.now_ns());
    count_allocations = false;
    TickRecord record;
    while (bench.records.Pop(record)) {
    }
    bench.Serve();
  };
  allocations = 0;
  for (int i = 0; i < 200; ++i) tick();
  bench.loop->Ask(kRequestHold);
  for (int i = 0; i < 20; ++i) tick();
  bench.loop->Ask(kRequestResume);
  for (int i = 0; i < 20; ++i) tick();
  bench.arm.refuse_send = true;
  for (int i = 0; i < 30; ++i) tick();
  EXPECT_EQ(bench.loop->state(), ClientState::kFault);
  bench.loop->Ask(kRequestQuickStop);
  for (int i = 0; i < 20; ++i) tick();
  EXPECT_EQ(allocations, 0);
}

TEST(ControlLoopTest, KeepsAbsoluteDeadlinesAndSkipsThoseThatPass) {
  // A clock whose time passes while the tick computes: every tenth tick takes 100 ms.
  struct SlowClock : ManualClock {
    using ManualClock::ManualClock;
    void SleepUntil(int64_t deadline) override {
      ManualClock::SleepUntil(deadline);
      deadlines.push_back(deadline);
    }
    std::vector<int64_t> deadlines;
  } clock(5);
  struct SlowArm : FakeArm {
    SlowArm(SlowClock* slow, std::atomic<bool>* stop) : FakeArm(slow), slow(slow), stop(stop) {}
    void Poll() override {
      FakeArm::Poll();
      if (++polls % 10 == 0) slow->Advance(100'000'000);
      if (polls == 40) stop->store(true);
    }
    SlowClock* slow;
    std::atomic<bool>* stop;
    int polls = 0;
  };
  std::atomic<bool> stop{false};
  SlowArm arm(&clock, &stop);
  ASSERT_TRUE(arm.Connect().ok());
  NoCameras cameras;
  auto loop = ControlLoop::Create({}, &arm, &clock, &cameras);
  ASSERT_TRUE(loop.ok());
  (*loop)->Run(stop);
  EXPECT_EQ((*loop)->timing().ticks, 40u);
  EXPECT_EQ((*loop)->timing().missed, 4u);
  EXPECT_EQ((*loop)->timing().skipped, 12u);
  for (const int64_t deadline : clock.deadlines)
    EXPECT_EQ((deadline - clock.deadlines[0]) % kPeriod_ns, 0) << "no drift";
}

TEST(ControlLoopTest, RefusesOptionsThatMakeNoSense) {
  ManualClock clock;
  FakeArm arm(&clock);
  ASSERT_TRUE(arm.Connect().ok());
  NoCameras cameras;
  ControlOptions options;
  options.player.late_steps = 60;
  EXPECT_EQ(ControlLoop::Create(options, &arm, &clock, &cameras).status().code(),
            absl::StatusCode::kInvalidArgument);
  options = {};
  options.rate_hz = 0;
  EXPECT_FALSE(ControlLoop::Create(options, &arm, &clock, &cameras).ok());
}

}  // namespace
}  // namespace robostress
