// The experiments on emulated arms: table, expert, demonstrations, and units with a policy that
// stands in for a server's; all in simulated time.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <functional>
#include <set>

#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/safetensors.h"
#include "common/suites.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/study/client_method.h"
#include "robot_client/study/demonstration_recorder.h"
#include "robot_client/study/live_player.h"
#include "robot_client/study/piper_player.h"

namespace robostress::piper {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// Without EGL there are no pictures and so no demonstrations.
#define SKIP_WITHOUT_EGL(made) \
  if (absl::IsUnavailable((made).status())) GTEST_SKIP() << (made).status().message()

std::unique_ptr<PiperPlant> MakePlant() {
  auto plant = PiperPlant::Create(ComposePiperScene(MakeTableScene(kObjectVariants[0])),
                                  *MakeWearProfile("new"));
  EXPECT_TRUE(plant.ok()) << plant.status();
  return *std::move(plant);
}

void MoveBowl(PiperPlant& plant, const Eigen::Vector3d& to) {
  const int joint = mj_name2id(&plant.model(), mjOBJ_JOINT, "bowl_free");
  std::copy_n(to.data(), 3, plant.data().qpos + plant.model().jnt_qposadr[joint]);
  mj_step1(&plant.model(), &plant.data());
}

TEST(TableScene, InitialStatesAreDrawnOnceAndForAll) {
  const auto plant = MakePlant();
  for (const TableTask& task : kTableTasks) {
    auto scene = TableScene::Create(plant.get(), task);
    ASSERT_TRUE(scene.ok()) << scene.status();
    std::set<double> places;
    for (int state = 0; state < 25; ++state) {
      scene->Place(state);
      const TableState first = scene->Look();
      EXPECT_FALSE(scene->Done(first)) << task.name << " state " << state;
      scene->Place(state + 100);
      scene->Place(state);
      EXPECT_EQ(scene->Look().bowl, first.bowl);
      EXPECT_EQ(scene->Look().plate, first.plate);
      places.insert(first.bowl.x());
      EXPECT_GT((first.bowl - first.plate).head<2>().norm(), kPlateRadius + kBowlRadius - 0.02);
    }
    EXPECT_EQ(places.size(), 25u) << task.name;
  }
}

TEST(TableScene, JudgesABowlByWhereItStandsAndWhetherItWasLetGo) {
  const auto plant = MakePlant();
  plant->Reset({}, kGripperOpening);
  auto scene = TableScene::Create(plant.get(), kTableTasks[0]);
  ASSERT_TRUE(scene.ok()) << scene.status();
  scene->Place(0);
  const Eigen::Vector3d plate = scene->Look().plate;
  MoveBowl(*plant, plate + Eigen::Vector3d(0.03, 0, kPlateHeight + 0.001));
  TableState state = scene->Look();
  EXPECT_TRUE(scene->Done(state));
  state.opening = 0.006;
  EXPECT_FALSE(scene->Done(state)) << "still held";
  MoveBowl(*plant, plate + Eigen::Vector3d(0.03, 0, kPlateHeight + 0.03));
  EXPECT_FALSE(scene->Done(scene->Look())) << "in the air";
  MoveBowl(*plant, plate + Eigen::Vector3d(0.06, 0, kPlateHeight + 0.001));
  EXPECT_FALSE(scene->Done(scene->Look())) << "over the edge";
  auto drawer = TableScene::Create(plant.get(), kTableTasks[3]);
  ASSERT_TRUE(drawer.ok()) << drawer.status();
  state = drawer->Look();
  state.drawer = TableScene::kDrawerOpen;
  EXPECT_TRUE(drawer->Done(state));
  state.drawer -= 1e-3;
  EXPECT_FALSE(drawer->Done(state));
}

TEST(TableTasks, NamesAreChecked) {
  EXPECT_EQ(*FindTableTask("open_drawer"), 3);
  EXPECT_THAT(std::string(FindTableTask("fold_towel").status().message()),
              HasSubstr("bowl_on_cabinet"));
  EXPECT_THAT(std::string(FindObjectVariant("gold").status().message()), HasSubstr("light_blue"));
}

class Recording : public ::testing::TestWithParam<std::tuple<const char*, int>> {};

TEST_P(Recording, TheExpertDoesTheTaskAndItsCommandsAreTheActions) {
  const auto [arm, task] = GetParam();
  const std::string path = ::testing::TempDir() + "/study_demo.safetensors";
  RecorderOptions options;
  options.episodes = 1;
  StudyBenchOptions bench;
  bench.arm = arm;
  bench.task = task;
  bench.image_size = 32;
  auto recorder = DemonstrationRecorder::Create(options, bench);
  SKIP_WITHOUT_EGL(recorder);
  ASSERT_TRUE(recorder.ok()) << recorder.status();
  const absl::Status recorded = (*recorder)->Record(path);
  ASSERT_TRUE(recorded.ok()) << recorded;
  EXPECT_EQ((*recorder)->attempts(), 1);

  const auto file = SafetensorsFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->metadata().at("instruction"), kTableTasks[static_cast<size_t>(task)].instruction);
  const auto state = file->Get("state"), actions = file->Get("actions"),
             images = file->Get("images");
  ASSERT_TRUE(state.ok() && actions.ok() && images.ok());
  const int64_t frames = state->shape[0];
  EXPECT_GT(frames, 20);
  EXPECT_EQ(actions->shape, (std::vector<int64_t>{frames, 50, piper::kAxes}));
  EXPECT_EQ(images->shape, (std::vector<int64_t>{frames, 2, 32, 32, 3}));
  // Absolute targets: the arm is near the first row of its frame, and where the last one of a
  // chunk's executed rows leads when that many steps have passed.
  const auto* q = reinterpret_cast<const float*>(state->bytes.data());
  const auto* a = reinterpret_cast<const float*>(actions->bytes.data());
  const int apart = 12 / options.stride;
  double followed = 0;
  for (int64_t f = 0; f + apart < frames; ++f) {
    for (int j = 0; j < piper::kJoints; ++j) {
      EXPECT_NEAR(a[f * 350 + j], q[f * 7 + j], 0.3);
      followed += std::abs(q[(f + apart) * 7 + j] - a[f * 350 + 9 * 7 + j]);
    }
    const float opening = a[f * 350 + piper::kJoints];
    EXPECT_TRUE(opening == 0.0f || opening == 0.07f) << opening;
  }
  EXPECT_LT(followed / static_cast<double>((frames - apart) * piper::kJoints), 0.06);
}

INSTANTIATE_TEST_SUITE_P(ArmsAndTasks, Recording,
                         ::testing::Values(std::tuple{"new", 0}, std::tuple{"used_one_year", 3}));

// Stays where it is, and remembers what it was asked.
class StandingPolicy : public PolicyEndpoint {
 public:
  StandingPolicy() {
    spec_.name = "standing";
    spec_.state_dim = spec_.action_dim = piper::kAxes;
    spec_.horizon = 50;
    spec_.image_width = spec_.image_height = 16;
    spec_.cameras = {"base", "wrist"};
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey& key) override {
    episodes.push_back(key.episode);
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int) override {
    instructions.insert(observation.instruction);
    pictures.insert(observation.views[0].image.data);
    PredictedChunk out;
    out.prediction_id = ++predictions_;
    out.actions = observation.proprioception.transpose().replicate(50, 1);
    out.actions.col(0).array() += 0.1f;
    out.policy_actions = out.actions;
    return out;
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    sequences.push_back(executed.sequence);
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

  std::vector<int> episodes;
  std::set<std::string> instructions;
  std::set<std::vector<uint8_t>> pictures;
  std::vector<uint64_t> sequences;

 private:
  PolicySpec spec_;
  uint64_t predictions_ = 0;
};

UnitConfig ShortUnit() {
  UnitConfig unit;
  unit.robot = "piper";
  unit.suite = "piper_unseen";
  unit.scenario = "new";
  unit.policy = "standing";
  unit.tasks = {0, 1};  // wooden, plum
  unit.episodes = 2;
  unit.client.episode_s = 0.7;
  return unit;
}

// What a unit leaves, and the policy that played it, which lives as long as the player.
struct Played {
  absl::Status status;
  std::string rows, config, done;
  std::vector<std::string> said;
};

class PiperUnit : public ::testing::Test {
 protected:
  Played Play(const UnitConfig& unit, const std::function<void(StandingPolicy&)>& look = {}) {
    Played played;
    const auto resolved = ResolvePiperUnit(unit);
    EXPECT_TRUE(resolved.ok()) << resolved.status();
    StandingPolicy* policy = nullptr;
    PiperPlayer player(*resolved, [&]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
      auto made = std::make_unique<StandingPolicy>();
      policy = made.get();
      return std::unique_ptr<PolicyEndpoint>(std::move(made));
    });
    UnitRunOptions options;
    options.out = folder_;
    options.progress = [&](std::string_view line) { played.said.emplace_back(line); };
    played.status = RunUnit(*resolved, options, player);
    played.rows = ReadFile(folder_ + "/episodes.jsonl").value_or("");
    played.config = ReadFile(folder_ + "/config.yaml").value_or("");
    played.done = ReadFile(folder_ + "/DONE").value_or("");
    if (look && policy != nullptr) look(*policy);
    return played;
  }
  void SetUp() override {
    folder_ = ::testing::TempDir() + "/piper_unit_" +
              ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::remove_all(folder_);
  }
  std::string folder_;
};

TEST_F(PiperUnit, KeepsOneSessionOverEpisodesAndObjectVariants) {
  std::set<std::vector<uint8_t>> pictures;
  const Played played = Play(ShortUnit(), [&](StandingPolicy& policy) {
    EXPECT_EQ(policy.episodes, (std::vector<int>{0, 1, 2, 3})) << "the way home is none of them";
    EXPECT_EQ(policy.instructions, (std::set<std::string>{kObjectVariants[1].instruction,
                                                          kObjectVariants[2].instruction}));
    ASSERT_GE(policy.sequences.size(), 8u);
    for (size_t i = 0; i < policy.sequences.size(); ++i) EXPECT_EQ(policy.sequences[i], i + 1);
    pictures = policy.pictures;
  });
  SKIP_WITHOUT_EGL(
      absl::StatusOr<int>(played.status.ok() ? absl::StatusOr<int>(0) : played.status));
  ASSERT_TRUE(played.status.ok()) << played.status;
  const std::vector<std::string> rows = absl::StrSplit(played.rows, '\n', absl::SkipEmpty());
  ASSERT_EQ(rows.size(), 4u);
  EXPECT_THAT(rows[0], AllOf(HasSubstr("the wooden bowl"), HasSubstr("\"task\":0")));
  EXPECT_THAT(rows[3], AllOf(HasSubstr("the plum-colored bowl"), HasSubstr("\"task\":1"),
                             HasSubstr("\"initial_state\":3"), HasSubstr("\"success\":false"),
                             HasSubstr("\"power_cycles\":0"), HasSubstr("\"scenario\":\"new\"")));
  EXPECT_THAT(played.done, HasSubstr("episodes_sha256"));
  EXPECT_THAT(played.config, AllOf(HasSubstr("robot: piper"), HasSubstr("episode_s: 0.7")));

  // A finished unit is left alone; the same unit elsewhere gives the same bits.
  EXPECT_THAT(Play(ShortUnit()).said.at(0), HasSubstr("already complete"));
  std::filesystem::remove_all(folder_);
  EXPECT_EQ(
      Play(ShortUnit(), [&](StandingPolicy& again) { EXPECT_EQ(again.pictures, pictures); }).rows,
      played.rows);
}

TEST_F(PiperUnit, BeginsAnewWhereItWasStopped) {
  const Played whole = Play(ShortUnit());
  SKIP_WITHOUT_EGL(absl::StatusOr<int>(whole.status.ok() ? absl::StatusOr<int>(0) : whole.status));
  std::filesystem::remove(folder_ + "/DONE");
  const std::string first = whole.rows.substr(0, whole.rows.find('\n') + 1);
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/episodes.jsonl", first).ok());
  const Played again = Play(ShortUnit(), [](StandingPolicy& policy) {
    EXPECT_EQ(policy.episodes, (std::vector<int>{0, 1, 2, 3})) << "the arm stands elsewhere";
  });
  EXPECT_THAT(again.said.at(0), HasSubstr("starting over: an episode of this robot depends"));
  EXPECT_EQ(again.rows, whole.rows);
  EXPECT_EQ(again.done, whole.done);
}

TEST(PiperUnitConfig, RefusesWhatDoesNotFit) {
  const auto refused = [](const std::function<void(UnitConfig&)>& change) {
    UnitConfig unit = ShortUnit();
    change(unit);
    return std::string(ResolvePiperUnit(unit).status().message());
  };
  EXPECT_EQ(refused([](UnitConfig&) {}), "");
  EXPECT_THAT(refused([](UnitConfig& u) { u.suite = "juggle"; }), HasSubstr("piper_4_open_drawer"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.robot = "panda"; }), HasSubstr("tabletop_spatial"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.scenario = "rusty"; }), HasSubstr("used_one_year"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.episodes = 0; }), HasSubstr("episodes"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.policy = "expert"; }), HasSubstr("expert"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.videos = 1; }), HasSubstr("videos"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.client.episode_s = -1; }), HasSubstr("episode_s"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.client.moved_bound = 0; }), HasSubstr("moved_bound"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.client.latency_ticks = 31; }),
              HasSubstr("latency_ticks"));
  EXPECT_THAT(refused([](UnitConfig& u) { u.client.direct = u.client.real_time = true; }),
              HasSubstr("client.direct is true with client.real_time"));
}

TEST(PiperUnitConfig, EverySuiteOfThePiperIsOnTheTable) {
  for (const std::string& suite : SuitesOf("piper")) {
    const auto table = FindTableSuite(suite);
    ASSERT_TRUE(table.ok()) << table.status();
    EXPECT_EQ(static_cast<int>(table->variants.size()), FindSuite(suite)->num_tasks) << suite;
  }
  EXPECT_THAT(std::string(FindTableSuite("tabletop_goal").status().message()),
              HasSubstr("piper_unseen"));
}

TEST(PiperUnitConfig, TheObserverIsTheClientsAndTheSessionThatOfTheMethodWithoutIt) {
  UnitConfig unit = ShortUnit();
  unit.method = *MakeMethod("dob_ours", {"learning_rate=3e-5"});
  PolicyConnectionOptions session = SessionOf(unit, "host:1");
  EXPECT_EQ(DumpConfig(session.method), DumpConfig(*MakeMethod("ours", {"learning_rate=3e-5"})));
  EXPECT_EQ(session.suite, "piper_table") << "one noise for all suites";
  EXPECT_EQ(session.robot, "piper_new");
  unit.method = *MakeMethod("dob");
  EXPECT_EQ(DumpConfig(SessionOf(unit, "host:1").method), DumpConfig(*MakeMethod("base")));
}

TEST(PiperUnitConfig, TheClientFollowsAHealthyArmAndTheServerCorrectsNothing) {
  UnitConfig unit = ShortUnit();
  for (const char* name : {"ours_following_step", "ours_replanning", "smooth_fewer_rows"}) {
    unit.method = *MakeMethod(name);
    EXPECT_EQ(DumpConfig(SessionOf(unit, "host:1").method), DumpConfig(*MakeMethod("base")))
        << name;
  }
  ControlOptions control;
  UseMethod(*MakeMethod("ours_replanning"), Follow::kDirect, control);
  EXPECT_TRUE(control.observer);
  EXPECT_TRUE(control.disturbance_observer.response.on());
  EXPECT_EQ(control.smoothing, 0.4);
  EXPECT_EQ(control.player.execute_steps, 2);
  EXPECT_TRUE(CheckControlOptions(control, 6).ok());
  control = ControlOptions();
  UseMethod(*MakeMethod("dob"), Follow::kPlanned, control);
  EXPECT_TRUE(control.observer);
  EXPECT_FALSE(control.disturbance_observer.response.on()) << "the paper's";
  control = ControlOptions();
  UseMethod(*MakeMethod("fewer_rows"), Follow::kPlanned, control);
  EXPECT_FALSE(control.observer);
}

// How far the joint is from rest at the end, over where a push left it: an arm that answers `gain`
// times as strongly as the healthy one and is seen `late` ticks late.
double WhatIsLeft(Follow follow, double gain, int late) {
  const DisturbanceObserverOptions options = FollowingObserver(follow);
  DisturbanceObserver observer(options);
  JointResponse arm(options.response);
  using Joints = DisturbanceObserver::Joints;
  arm.Reset(Joints::Zero(6));
  constexpr double kTick_s = 1.0 / 30, kPush = 0.001;
  std::deque<Joints> seen(static_cast<size_t>(late) + 1, Joints::Zero(6));
  double last = 0;
  for (int tick = 0; tick < 3000; ++tick) {
    arm.Advance(observer.Correct(Joints::Zero(6), seen.front(), kTick_s), kTick_s);
    // The push goes after ten seconds, and leaves what the loop makes of it.
    seen.push_back(gain * arm.position() + Joints::Constant(6, tick < 300 ? kPush : 0));
    seen.pop_front();
    if (tick >= 2700) last = std::max(last, seen.back().cwiseAbs().maxCoeff());
  }
  return last / kPush;
}

TEST(FollowingObserver, SettlesWithAMarginOfTwoInGainAndHalfASecondOfDelay) {
  for (const Follow follow : {Follow::kPlanned, Follow::kDirect}) {
    double gain = 1;
    while (gain < 64 && WhatIsLeft(follow, gain * 1.05, 0) < 0.05) gain *= 1.05;
    int late = 0;
    while (late < 60 && WhatIsLeft(follow, 1, late + 1) < 0.05) ++late;
    std::printf("%s: settles up to %.1f times the arm's gain, and %d ticks late\n",
                follow == Follow::kDirect ? "direct" : "planned", gain, late);
    EXPECT_GT(gain, 2);
    EXPECT_GE(late, 3);
  }
}

TEST(LivePlayer, LeavesTheObjectVariantsToSimulatedTime) {
  EXPECT_EQ(LivePlayer::Create(ShortUnit(), "s", ::testing::TempDir()).status().code(),
            absl::StatusCode::kUnimplemented);
}

}  // namespace
}  // namespace robostress::piper
