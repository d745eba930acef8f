#include "robot_client/control/control_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <new>

#include "tests/robot_client/control/client_bench.h"

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

double LargestStep(const std::vector<TickRecord>& records, size_t first) {
  double largest = 0;
  for (size_t i = first + 1; i < records.size(); ++i)
    largest = std::max(largest, std::abs(records[i].sent[0] - records[i - 1].sent[0]));
  return largest;
}

TEST(ControlLoopTest, SendsNothingBeforeAPersonEnables) {
  ClientBench bench;
  bench.Ticks(30);
  bench.Tick(kRequestStart | kRequestResume);
  EXPECT_EQ(bench.arm.sends, 0);
  EXPECT_EQ(bench.arm.enables, 0);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
}

TEST(ControlLoopTest, TheFirstCommandIsWhereTheArmStands) {
  ClientBench bench;
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
  ClientBench bench;
  bench.arm.refuse_enable = true;
  bench.Tick(kRequestEnable);
  EXPECT_EQ(bench.loop->state(), ClientState::kIdle);
  EXPECT_THAT(std::string(bench.loop->enable_status().message()), ::testing::HasSubstr("no power"));
}

TEST(ControlLoopTest, PlaysTenRowsOfEachPredictionAndRecordsEveryStage) {
  ClientBench bench;
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
  ClientBench bench;
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
  ClientBench bench;
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
  ClientBench bench;
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
  ClientBench bench;
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
    ClientBench bench;
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
  ClientBench bench({.observer = true});
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
  ClientBench bench;
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
  ClientBench bench;
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
  ClientBench bench;
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
  ClientBench bench({.observer = true});
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
