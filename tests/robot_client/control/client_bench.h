#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "robot_client/control/control_loop.h"
#include "tests/robot_client/answer_to.h"
#include "tests/robot_client/fake_arm.h"

namespace robostress {

inline constexpr int64_t kPeriod_ns = 33'333'333;

struct FakeStamps : CameraStamps {
  int64_t Oldest() const override { return stamp_ns; }
  int64_t stamp_ns = 0;
};

// A client in simulated time against a fake arm; the policy moves J1 at 0.3 rad/s.
struct ClientBench {
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

  explicit ClientBench(const ControlOptions& options = {}, const ArmModel* model = nullptr) {
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

}  // namespace robostress
