// Demonstrations on arms in software, in simulated time: the control loop, its limits, the tap and
// the data set as in robot_client teach; what is left out is the console and the cameras.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "nlohmann/json.hpp"
#include "robot_client/demonstration/lerobot_reader.h"
#include "robot_client/emulator/guiding_hand.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/teach/episode_tap.h"
#include "robot_client/teach/gamepad.h"
#include "robot_client/teach/jog_target.h"
#include "robot_client/teach/leader_arm.h"
#include "robot_client/teach/leader_target.h"
#include "tests/robot_client/arm_world.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr ArmVector kStart = {0, 1.2, -1.0, 0, 0.5, 0, 0.03};
constexpr ArmVector kThere = {0.4, 1.0, -1.2, 0.3, 0.3, -0.4, 0.06};

piper::GuidingHand Hand(std::vector<piper::HandPoint> points) {
  auto hand = piper::GuidingHand::Create(std::move(points));
  EXPECT_TRUE(hand.ok()) << hand.status();
  return *std::move(hand);
}

// A data set without pictures behind the loop of an ArmWorld.
struct Studio {
  ArmWorld& world;
  std::string directory;
  std::unique_ptr<DemonstrationWriter> writer;
  std::unique_ptr<EpisodeTap> tap;
  std::vector<TickRecord> ticks;  // while it records
  bool recording = false;

  Studio(ArmWorld& w, const std::string& name, bool by_hand)
      : world(w), directory(::testing::TempDir() + "/teach_" + name) {
    std::filesystem::remove_all(directory);
    DemonstrationOptions options;
    options.directory = directory;
    options.actions_are_next_states = by_hand;
    auto made = DemonstrationWriter::Create(options, {}, &world.time);
    EXPECT_TRUE(made.ok()) << made.status();
    writer = *std::move(made);
    EpisodeTap::Options tapped;
    tapped.by_hand = by_hand;
    tap = std::make_unique<EpisodeTap>(tapped, writer.get());
    world.loop->OnTick([this](const TickRecord& record) {
      tap->Take(record);
      if (recording && tap->end() == EpisodeTap::End::kGoing) ticks.push_back(record);
    });
  }
  void Begin() {
    ASSERT_TRUE(writer->Begin("move").ok());
    tap->Open();
    recording = true;
  }
  int64_t frames() const {
    std::ifstream file(directory + "/lerobot/meta/info.json");
    return nlohmann::json::parse(file)["total_frames"].get<int64_t>();
  }
};

TEST(TeachEmulatedTest, AnArmThatIsTaughtFollowsTheHandAndGetsNoCommand) {
  ArmWorld::Options options;
  options.emulated.teach = {0, 0};
  options.emulated.hand = Hand({{2, kStart}, {4, kThere}, {6, kStart}});
  ArmWorld world(options);
  ASSERT_TRUE(world.connected.ok()) << world.connected;
  Studio studio(world, "hand", true);
  while (world.time.now_ns() < 2'000'000'000) world.Tick();
  EXPECT_TRUE(world.loop->seen().taught);
  studio.Begin();
  const double t0 = 1e-9 * static_cast<double>(world.time.now_ns());
  world.Ticks(120);
  ASSERT_EQ(studio.ticks.size(), 120u);
  double off = 0;
  for (const TickRecord& record : studio.ticks) {
    const double t = 1e-9 * static_cast<double>(record.stamp_ns);
    const ArmVector hand = options.emulated.hand.At(t).position;
    for (int j = 0; j < piper::kJoints; ++j)
      off = std::max(off, std::abs(record.position[j] - hand[j]));
    EXPECT_EQ(record.state, ClientState::kIdle);
  }
  EXPECT_LT(off, 0.05) << "a hand of 200 Nm/rad on a limp arm";
  EXPECT_NEAR(studio.ticks[60].position[0], options.emulated.hand.At(t0 + 2).position[0], 0.05);
  EXPECT_NEAR(studio.ticks[60].position[piper::kJoints], 0.06, 0.005) << "the gripper too";
  const auto saved = studio.writer->End(true);
  ASSERT_TRUE(saved.ok()) << saved.status();
  EXPECT_EQ(saved->ticks, 120);
  EXPECT_EQ(studio.frames(), 120);
  EXPECT_THAT(saved->text, HasSubstr("no pictures"));
  StampedFrame heard;
  while (world.third->Receive(heard)) {
    const uint16_t id = heard.frame.id;
    EXPECT_FALSE((id >= piper::kStopControl && id <= piper::kLastCommand) ||
                 id == piper::kMotorPower)
        << "a command " << id;
  }
}

TEST(TeachEmulatedTest, TheButtonEndsTheDemonstrationAndTheArmHoldsInStandby) {
  ArmWorld::Options options;
  options.emulated.teach = {0, 4};
  options.emulated.hand = Hand({{0, kStart}, {2, kThere}});
  ArmWorld world(options);
  Studio studio(world, "button", true);
  while (world.time.now_ns() < 2'500'000'000) world.Tick();
  studio.Begin();
  world.Ticks(90);
  EXPECT_EQ(studio.tap->end(), EpisodeTap::End::kLetGo);
  EXPECT_EQ(studio.tap->Spoiled(), "");
  EXPECT_NEAR(static_cast<double>(studio.ticks.size()), 45, 2);
  EXPECT_FALSE(world.loop->seen().taught);
  EXPECT_NEAR(world.loop->seen().position[1], kThere[1], 0.02) << "it does not fall";
  EXPECT_EQ(studio.writer->End(true)->ticks, static_cast<int64_t>(studio.ticks.size()));
}

TEST(TeachEmulatedTest, AnArmThatFallsSilentSpoilsAHandsDemonstration) {
  ArmWorld::Options options;
  options.emulated.teach = {0, 0};
  options.faults = {"silent@3"};
  ArmWorld world(options);
  Studio studio(world, "silent", true);
  while (world.time.now_ns() < 2'000'000'000) world.Tick();
  studio.Begin();
  world.Ticks(60);
  EXPECT_EQ(studio.tap->end(), EpisodeTap::End::kStale);
  EXPECT_THAT(studio.tap->Spoiled(), HasSubstr("not heard"));
}

TEST(TeachEmulatedTest, TeachingIsAFaultForAClientThatCommands) {
  ArmWorld::Options options;
  options.emulated.teach = {5, 0};
  ArmWorld world(options);
  world.Tick(kRequestEnable);
  ASSERT_TRUE(world.loop->enable_status().ok()) << world.loop->enable_status();
  while (world.time.now_ns() < 6'000'000'000) world.Tick();
  EXPECT_EQ(world.loop->state(), ClientState::kFault);
  EXPECT_TRUE(world.loop->last_record().faults & kFaultMode);
}

// A leader with a hand on it, and its follower.
struct LeaderWorld {
  explicit LeaderWorld(const piper::GuidingHand& hand, const std::string& name,
                       const std::vector<std::string>& leader_faults = {},
                       const ArmWorld::Options& follower = {})
      : world(follower), leader_bus(world.time, "leader") {
    piper::EmulatorOptions options;
    options.leader = true;
    options.hand = hand;
    options.start = {0.2, 1.1, -1.0, 0, 0.5, 0};
    options.opening = 0.03;
    for (const std::string& fault : leader_faults)
      options.faults.push_back(*piper::ParseFault(fault));
    auto made = piper::PiperEmulator::Create(options, leader_bus.Attach(), world.time);
    EXPECT_TRUE(made.ok()) << made.status();
    emulator = *std::move(made);
    world.time.Add(emulator.get());
    leader = std::make_unique<LeaderArm>(leader_bus.Attach(), &world.time);
    const absl::Status heard = leader->Connect();
    EXPECT_TRUE(heard.ok()) << heard;
    LeaderOptions joined;
    target = std::make_unique<LeaderTarget>(&leader->newest(), world.arm->limits(), joined);
    studio = std::make_unique<Studio>(world, name, false);
    world.Tick(kRequestEnable);
    EXPECT_TRUE(world.loop->enable_status().ok()) << world.loop->enable_status();
    world.Ticks(10);
    start_s = 1e-9 * static_cast<double>(world.time.now_ns());
  }
  const TickRecord& Tick(uint32_t requests = 0) {
    leader->Poll();
    return world.Tick(requests);
  }
  void Follow() { world.loop->Follow(target.get()); }
  // Until the arm's time `t`; the most of each bound that commands came to meanwhile.
  void Until(double t) {
    while (1e-9 * static_cast<double>(world.time.now_ns()) < t) {
      const TickRecord& record = Tick();
      for (int j = 0; j < piper::kJoints && had; ++j) {
        const double v = 30 * (record.sent[j] - last[j]);
        fastest = std::max(fastest, std::abs(v));
        hardest = std::max(hardest, 30 * std::abs(v - speed[j]));
        speed[j] = v;
      }
      last = record.sent;
      had = record.state == ClientState::kMove;
      if (!had) speed.fill(0);
    }
  }

  ArmWorld world;
  InProcessBus leader_bus;
  std::unique_ptr<piper::PiperEmulator> emulator;
  std::unique_ptr<LeaderArm> leader;
  std::unique_ptr<LeaderTarget> target;
  std::unique_ptr<Studio> studio;
  double start_s = 0;
  ArmVector last{}, speed{};
  bool had = false;
  double fastest = 0, hardest = 0;  // [rad/s], [rad/s^2]
};

constexpr ArmVector kLeads = {0.5, 1.1, -1.1, 0, 0.5, 0, 0.03};

TEST(TeachEmulatedTest, AFollowerJoinsItsLeaderSlowlyAndIsRecordedBehindIt) {
  LeaderWorld pair(Hand({{0, kLeads}, {8, kLeads}, {11, kThere}, {14, kLeads}}), "leader");
  EXPECT_GT(std::abs(pair.world.loop->seen().position[0] - 0.5), 0.3) << "far from its leader";
  pair.Follow();
  pair.Until(pair.start_s + 1.5);
  EXPECT_EQ(pair.world.loop->state(), ClientState::kMove);
  EXPECT_LE(pair.fastest, 0.66) << "home_velocity, and what the limiter adds to catch up";
  EXPECT_GT(pair.fastest, 0.3);
  pair.Until(7.5);
  EXPECT_NEAR(pair.world.loop->seen().position[0], 0.5, 0.02);
  ASSERT_FALSE(pair.studio->tap->joining());
  pair.studio->Begin();
  pair.Until(13.5);
  ASSERT_GE(pair.studio->ticks.size(), 175u);
  double off = 0;
  const auto& ticks = pair.studio->ticks;
  for (size_t i = 0; i < ticks.size(); ++i) {
    EXPECT_TRUE(ticks[i].flags & kTickLive);
    for (int j = 0; j < piper::kJoints; ++j)
      off = std::max(off, std::abs(ticks[i].requested[j] - ticks[i].position[j]));
  }
  EXPECT_LT(off, 0.15) << "the follower is behind by its lag alone";
  // The state is the action of some ticks before.
  const auto apart = [&](size_t shift) {
    double sum = 0;
    for (size_t i = shift; i < ticks.size(); ++i)
      sum += std::pow(ticks[i].position[1] - ticks[i - shift].requested[1], 2);
    return sum / static_cast<double>(ticks.size() - shift);
  };
  size_t best = 0;
  for (size_t shift = 1; shift < 15; ++shift) best = apart(shift) < apart(best) ? shift : best;
  EXPECT_GE(best, 1u) << "actions lead";
  EXPECT_LE(best, 9u);
  const auto saved = pair.studio->writer->End(true);
  ASSERT_TRUE(saved.ok()) << saved.status();
  EXPECT_EQ(saved->ticks, static_cast<int64_t>(ticks.size()));
  const auto actions = LerobotReader::Open(pair.studio->directory + "/lerobot")->ReadActions(0);
  ASSERT_TRUE(actions.ok()) << actions.status();
  ASSERT_EQ(actions->size(), ticks.size());
  for (size_t i = 0; i < ticks.size(); ++i) {
    for (int j = 0; j < piper::kAxes; ++j)
      ASSERT_NEAR((*actions)[i][j], ticks[i].requested[j], 1e-6) << i << " " << j;
  }
}

TEST(TeachEmulatedTest, LimitsHoldWhenTheLeaderJumps) {
  // A hand that throws the leader 1.5 rad within 0.1 s.
  ArmVector far = kLeads;
  far[0] = -1.0;
  LeaderWorld pair(Hand({{0, kLeads}, {8, kLeads}, {8.1, far}}), "jump");
  pair.Follow();
  pair.Until(14);
  EXPECT_EQ(pair.world.loop->state(), ClientState::kMove);
  EXPECT_LE(pair.fastest, 1.0 + 1e-6);
  EXPECT_LE(pair.hardest, 5.0 + 1e-6);
  EXPECT_NEAR(pair.world.loop->seen().position[0], -1.0, 0.05);
}

TEST(TeachEmulatedTest, ALeaderThatFallsSilentHoldsTheFollowerWithACauseOfItsOwn) {
  LeaderWorld pair(Hand({{0, kLeads}, {6, kLeads}, {12, kThere}}), "mute", {"silent@8"});
  pair.Follow();
  pair.Until(7);
  pair.studio->Begin();
  while (pair.world.loop->state() == ClientState::kMove && pair.world.time.now_ns() < 10e9)
    pair.Tick();
  EXPECT_EQ(pair.world.loop->state(), ClientState::kHold);
  EXPECT_EQ(pair.world.loop->cause(), StateCause::kInputSilent);
  const double silent_s = 1e-9 * static_cast<double>(pair.world.loop->last_record().start_ns -
                                                     pair.leader->newest().Load().stamp_ns);
  EXPECT_GT(silent_s, 0.1);
  EXPECT_LT(silent_s, 0.1 + 1.5 / 30) << "the tick after it";
  EXPECT_THAT(pair.studio->tap->Spoiled(), HasSubstr("input_silent"));
  pair.Tick(kRequestEnd);
  pair.Follow();
  pair.Tick();
  EXPECT_EQ(pair.world.loop->state(), ClientState::kEnabled) << "not while it is silent";
  EXPECT_EQ(pair.world.loop->refusal(), Refusal::kHeld);
}

TEST(TeachEmulatedTest, AFollowerWhoseBusDiesIsHeldAndTheDemonstrationIsWorthless) {
  ArmWorld::Options follower;
  follower.faults = {"silent@8"};
  LeaderWorld pair(Hand({{0, kLeads}, {6, kLeads}, {12, kThere}}), "dead", {}, follower);
  pair.Follow();
  pair.Until(7);
  pair.studio->Begin();
  while (pair.world.loop->state() == ClientState::kMove && pair.world.time.now_ns() < 10e9)
    pair.Tick();
  EXPECT_EQ(pair.world.loop->cause(), StateCause::kArmSilent);
  EXPECT_THAT(pair.studio->tap->Spoiled(), HasSubstr("arm_silent"));
}

// What a person jogs, through the loop.
struct JogWorld {
  explicit JogWorld(const std::string& name) : world({}) {
    studio = std::make_unique<Studio>(world, name, false);
    target = std::make_unique<JogTarget>(
        &cell,
        [](const ArmVector& position) {
          piper::JointVector q;
          std::copy_n(position.begin(), piper::kJoints, q.begin());
          return piper::ToolJacobian(q, piper::Zero::kSince_1_6_3);
        },
        world.arm->limits(), JogOptions{});
    world.Tick(kRequestEnable);
    EXPECT_TRUE(world.loop->enable_status().ok());
    world.Ticks(10);
    world.loop->Follow(target.get());
  }
  // Holds an axis for so many ticks.
  void Hold(int axis, double share, int ticks) {
    for (int i = 0; i < ticks; ++i) {
      JogInput input;
      input.stamp_ns = world.time.now_ns();
      input.tool[axis] = share;
      cell.Store(input);
      world.Tick();
    }
  }
  Eigen::Vector3d Tool() {
    piper::JointVector q;
    std::copy_n(world.loop->seen().position.begin(), piper::kJoints, q.begin());
    return piper::ToolPose(q, piper::Zero::kSince_1_6_3).translation();
  }

  ArmWorld world;
  SnapshotCell<JogInput> cell;
  std::unique_ptr<JogTarget> target;
  std::unique_ptr<Studio> studio;
};

TEST(TeachEmulatedTest, AJogMovesTheToolAndIsRecordedWithWhatWasAskedFor) {
  JogWorld jog("jog");
  jog.world.Ticks(2);
  ASSERT_EQ(jog.world.loop->state(), ClientState::kMove);
  const Eigen::Vector3d before = jog.Tool();
  jog.studio->Begin();
  jog.Hold(2, 1, 30);
  jog.world.Ticks(45);  // let go
  const Eigen::Vector3d way = jog.Tool() - before;
  // One second, and the dead man's 0.25 s.
  EXPECT_NEAR(way.z(), 0.125, 0.01);
  EXPECT_LT(way.head<2>().norm(), 0.01);
  EXPECT_LT(std::abs(jog.world.loop->seen().velocity[1]), 0.02) << "it stands";
  jog.world.Tick(kRequestHold);
  jog.world.Tick();
  EXPECT_EQ(jog.studio->tap->end(), EpisodeTap::End::kLetGo);
  EXPECT_EQ(jog.studio->writer->End(true)->ticks, 75);
}

TEST(TeachEmulatedTest, AJogIntoTheTableIsStoppedAboveIt) {
  JogWorld jog("table");
  jog.Hold(2, -1, 240);
  EXPECT_EQ(jog.world.loop->cause(), StateCause::kWorkspace);
  ArmVector q = jog.world.loop->seen().position;
  EXPECT_GT(jog.world.model->ClearanceAt(q)[ArmModel::kTable], -0.005);
}

TEST(TeachEmulatedTest, AGamepadThatIsUnpluggedHoldsTheArm) {
  JogWorld jog("pad");
  jog.Hold(0, 1, 15);
  JogInput gone;
  gone.gone = true;
  jog.cell.Store(gone);
  jog.world.Ticks(2);
  EXPECT_EQ(jog.world.loop->state(), ClientState::kHold);
  EXPECT_EQ(jog.world.loop->cause(), StateCause::kInputSilent);
}

TEST(GuidingHandTest, GoesSmoothlyThroughItsPointsAndNamesWhatIsWrong) {
  const piper::GuidingHand hand = Hand({{1, kStart}, {3, kThere}});
  EXPECT_EQ(hand.At(0).position, kStart);
  EXPECT_NEAR(hand.At(2).position[0], 0.2, 1e-12) << "half way at half time";
  ArmVector velocity;
  hand.At(2, &velocity);
  EXPECT_NEAR(velocity[0], 1.5 * 0.4 / 2, 1e-12) << "the cubic's peak";
  // Through points of one speed it goes at that speed, and nowhere beyond a turn.
  const piper::GuidingHand line =
      Hand({{0, {0.0}}, {1, {0.1}}, {2, {0.2}}, {3, {0.3}}, {4, {0.2}}});
  line.At(1.5, &velocity);
  EXPECT_NEAR(velocity[0], 0.1, 1e-12);
  for (double t = 0; t < 4; t += 0.01) EXPECT_LE(line.At(t).position[0], 0.3 + 1e-12) << t;
  EXPECT_EQ(hand.At(9).position, kThere);
  EXPECT_FALSE(piper::GuidingHand::Create({{1, kStart}, {1, kThere}}).ok());
  const std::string path = ::testing::TempDir() + "/hand.csv";
  std::ofstream(path) << "t,J1,J2,J3,J4,J5,J6,opening\n0,0,1,-1,0,0,0,0.03\n1,0,1,-1,x,0,0,0\n";
  EXPECT_THAT(std::string(piper::GuidingHand::Load(path).status().message()),
              ::testing::AllOf(HasSubstr("hand.csv: line 3"), HasSubstr("eight numbers")));
  EXPECT_EQ(piper::ParseTeachPlan("2+20")->for_s, 20);
  EXPECT_FALSE(piper::ParseTeachPlan("2+").ok());
}

}  // namespace
}  // namespace robostress
