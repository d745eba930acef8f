// The whole client against an arm in software, over an in-process bus in simulated time: the same
// classes as on a real arm, one thread, results that do not depend on the machine.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "robot_client/can/in_process_bus.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/piper/piper_arm.h"
#include "robot_client/simulated_client.h"

namespace robostress {
namespace {

// A policy of joint targets: off the rest, on which J2 and J3 stand at their limits, within two
// seconds; from then on a sway of J1 and J4.
class SwayPolicy : public PolicyEndpoint {
 public:
  SwayPolicy() {
    spec_.name = "sway";
    spec_.state_dim = spec_.action_dim = piper::kAxes;
    spec_.horizon = 50;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override {
    first_.resize(0);
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override {
    if (first_.size() == 0) first_ = observation.proprioception;
    PredictedChunk out;
    out.prediction_id = ++predictions_;
    out.actions.resize(50, piper::kAxes);
    for (int i = 0; i < 50; ++i) {
      const double t = (10 * chunk + i + 1) / 30.0;
      out.actions.row(i) = first_.transpose();
      out.actions(i, 0) += 0.2f * static_cast<float>(std::sin(2 * M_PI * 0.3 * t));
      out.actions(i, 3) += 0.2f * static_cast<float>(std::sin(2 * M_PI * 0.3 * t));
      const float lift = 0.4f * static_cast<float>(1 - std::cos(M_PI * std::min(t / 2, 1.0))) / 2;
      out.actions(i, 1) = 0.05f + lift;
      out.actions(i, 2) = -0.05f - lift;
      out.actions(i, 4) = std::clamp(out.actions(i, 4), -1.1f, 1.1f);
      out.actions(i, 6) = 0.04f;
    }
    out.policy_actions = out.actions;
    return out;
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    EXPECT_EQ(executed.sequence, ++sequence_);
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

 private:
  PolicySpec spec_;
  Eigen::VectorXf first_;
  uint64_t predictions_ = 0, sequence_ = 0;
};

struct Bench {
  piper::EmulatedTime time;
  InProcessBus bus{time};
  std::unique_ptr<piper::PiperEmulator> emulator;
  std::unique_ptr<piper::PiperArm> arm;
  std::unique_ptr<SimulatedClient> client;

  explicit Bench(const std::string& profile, const SimulatedClientOptions& options = {},
                 const std::vector<std::string>& faults = {}) {
    piper::EmulatorOptions emulated;
    emulated.profile = profile;
    for (const std::string& fault : faults) emulated.faults.push_back(*piper::ParseFault(fault));
    auto made = piper::PiperEmulator::Create(emulated, bus.Attach(), time);
    EXPECT_TRUE(made.ok()) << made.status();
    emulator = *std::move(made);
    time.Add(emulator.get());
    arm = std::make_unique<piper::PiperArm>(bus.Attach(), time);
    const absl::Status connected = arm->Connect();
    EXPECT_TRUE(connected.ok()) << connected;
    auto opened = SimulatedClient::Create(
        options, arm.get(), &time, {}, []() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
          return std::unique_ptr<PolicyEndpoint>(std::make_unique<SwayPolicy>());
        });
    EXPECT_TRUE(opened.ok()) << opened.status();
    client = *std::move(opened);
    const absl::Status enabled = client->Enable();
    EXPECT_TRUE(enabled.ok()) << enabled;
    client->Wait(1);
  }
  SimulatedEpisode Run(double seconds, int episode = 0) {
    auto ran = client->RunEpisode({0, episode}, seconds, {});
    EXPECT_TRUE(ran.ok()) << ran.status();
    return ran.ok() ? *ran : SimulatedEpisode{};
  }
};

TEST(EmulatedClientTest, PlaysAnEpisodeOnAnArmInSoftware) {
  Bench bench("new");
  double reached = 0;
  const double start = bench.client->loop().last_record().position[0];
  auto episode = bench.client->RunEpisode({0, 0}, 6, [&](const TickRecord& record) {
    reached = std::max(reached, record.position[0] - start);
    return false;
  });
  ASSERT_TRUE(episode.ok()) << episode.status();
  EXPECT_EQ(episode->state, ClientState::kRun);
  EXPECT_NEAR(episode->ticks, 180, 2);
  EXPECT_NEAR(reached, 0.2, 0.03) << "J1 follows";
  EXPECT_GE(episode->link.feedback_sent, 16u);
  EXPECT_GT(episode->link.feedback.steps, 150u);
  EXPECT_LT(episode->link.feedback.steps_masked, 30u) << "only while the limiter leaves the rest";
  EXPECT_GT(episode->link.residual.value(), 0.02);
  EXPECT_LT(episode->link.residual.value(), 1.5);
}

TEST(EmulatedClientTest, GivesTheSameBitsEveryTime) {
  const auto run = [] {
    Bench bench("used_one_year", {.latency_ticks = 2});
    bench.Run(2);
    return bench.client->loop().last_record().position;
  };
  EXPECT_EQ(run(), run());
}

TEST(EmulatedClientTest, TheObserverBringsAWornArmNearerToItsTargets) {
  const auto error = [](bool observer) {
    SimulatedClientOptions options;
    options.control.observer = observer;
    Bench bench("used_one_year", options);
    double sum = 0;
    int n = 0;
    auto episode = bench.client->RunEpisode({0, 0}, 10, [&](const TickRecord& r) {
      if ((r.flags & kTickPlayed) && r.tick > 90) {
        sum += std::abs(r.position[0] - r.policy[0]);
        ++n;
      }
      return false;
    });
    EXPECT_TRUE(episode.ok()) << episode.status();
    return sum / std::max(n, 1);
  };
  EXPECT_LT(error(true), 0.95 * error(false));
}

TEST(EmulatedClientTest, ACollisionInMidMotionIsAFaultAtOnce) {
  Bench bench("new", {}, {"collision:J2@6"});
  const SimulatedEpisode episode = bench.Run(20);
  EXPECT_EQ(episode.state, ClientState::kFault);
  EXPECT_EQ(episode.cause, StateCause::kArmFault);
  EXPECT_TRUE(bench.client->loop().last_record().faults & kFaultCollision);
}

TEST(EmulatedClientTest, ASilentArmIsHeldWithinTwoTicks) {
  Bench bench("new", {}, {"silent@6"});
  const SimulatedEpisode episode = bench.Run(20);
  EXPECT_EQ(episode.state, ClientState::kHold);
  EXPECT_EQ(episode.cause, StateCause::kArmSilent);
  const TickRecord& last = bench.client->loop().last_record();
  EXPECT_LE(static_cast<double>(last.start_ns - last.stamp_ns) * 1e-9, 0.05 + 3.0 / 30);
}

TEST(EmulatedClientTest, ForeignCommandsAreAFault) {
  Bench bench("new", {}, {"foreign@6"});
  const SimulatedEpisode episode = bench.Run(20);
  EXPECT_EQ(episode.state, ClientState::kFault);
  EXPECT_TRUE(bench.client->loop().last_record().faults & kFaultForeignCommand);
}

}  // namespace
}  // namespace robostress
