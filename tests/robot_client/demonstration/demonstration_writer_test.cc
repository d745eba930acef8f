#include "robot_client/demonstration/demonstration_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>

#include "common/libero/demonstrations.h"
#include "common/safetensors.h"
#include "robot_client/cameras/faulty_source.h"
#include "robot_client/cameras/synthetic_source.h"
#include "robot_client/piper/kinematics.h"
#include "tests/common/lerobot/read_back.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

Pose ToolOf(const ArmVector& position) {
  piper::JointVector q;
  for (int j = 0; j < piper::kJoints; ++j) q[j] = position[j];
  const Eigen::Isometry3d pose = piper::ToolPose(q, piper::Zero::kSince_1_6_3);
  return {pose.translation(), Eigen::Quaterniond(pose.rotation())};
}

// Two cameras in real time; the control thread is this one, five times as fast as an arm's.
struct Bench {
  MonotonicClock clock;
  FaultySource base{
      std::make_unique<SyntheticSource>(SyntheticSourceOptions{"base", 128, 96, 30, 0.001}, &clock),
      &clock};
  FaultySource wrist{
      std::make_unique<SyntheticSource>(SyntheticSourceOptions{"wrist", 64, 64, 30, 0.001}, &clock),
      &clock};
  std::string directory;
  std::unique_ptr<DemonstrationWriter> writer;

  explicit Bench(const std::string& name, DemonstrationOptions options = {})
      : directory(::testing::TempDir() + "/demonstration_" + name) {
    fs::remove_all(directory);
    EXPECT_TRUE(base.Start().ok() && wrist.Start().ok());
    clock.SleepUntil(clock.now_ns() + 20'000'000);
    options.directory = directory;
    options.libero_tool = ToolOf;
    Open(options);
  }
  void Open(const DemonstrationOptions& options) {
    auto made = DemonstrationWriter::Create(options, {&base, &wrist}, &clock);
    EXPECT_TRUE(made.ok()) << made.status();
    writer = *std::move(made);
  }
  void Ticks(int n) {
    for (int i = 0; i < n; ++i) {
      DemonstrationTick tick;
      tick.stamp_ns = clock.now_ns();
      tick.state = {0.1, 0.5, -0.5, 0.01 * i, 0.2, 0, 0.04};
      tick.action = tick.state;
      tick.action[3] += 0.01;
      EXPECT_TRUE(writer->Add(tick));
      clock.SleepUntil(clock.now_ns() + 6'000'000);
    }
  }
  bool Holds(const std::string& file) const { return fs::exists(directory + "/" + file); }
};

TEST(DemonstrationWriterTest, WritesAnEpisodeInThreeFormsThatAreReadBack) {
  Bench bench("whole");
  ASSERT_TRUE(bench.writer->Begin("open the drawer").ok());
  bench.Ticks(50);
  const auto saved = bench.writer->End(true);
  ASSERT_TRUE(saved.ok()) << saved.status();
  EXPECT_TRUE(saved->saved);
  EXPECT_EQ(saved->ticks, 50);
  EXPECT_LT(saved->oldest_frame_ms, 500);
  EXPECT_THAT(saved->text, HasSubstr("demonstration 0 saved (success): 50 ticks"));
  EXPECT_EQ(bench.writer->episodes(), 1);

  const auto shard = SafetensorsFile::Open(bench.directory + "/shards/episode_000000.safetensors");
  ASSERT_TRUE(shard.ok()) << shard.status();
  EXPECT_EQ(shard->metadata().at("instruction"), "open the drawer");
  EXPECT_EQ(shard->Get("images")->shape, (std::vector<int64_t>{13, 2, 64, 64, 3}));
  const auto actions = shard->ReadFloats("actions", {13, 50, 7});
  ASSERT_TRUE(actions.ok()) << actions.status();
  const auto action = [&](int frame, int row) { return (*actions)[(frame * 50 + row) * 7 + 3]; };
  EXPECT_NEAR(action(2, 5), 0.01 * (8 + 5 + 1), 1e-6);
  EXPECT_NEAR(action(12, 49), 0.5, 1e-6) << "after its end the last target stays";
  EXPECT_NEAR(shard->ReadFloats("state", {13, 7})->at(2 * 7 + 3), 0.08, 1e-6);

  const auto libero =
      LiberoDemonstrationFile::Open(bench.directory + "/libero/episode_000000.hdf5");
  ASSERT_TRUE(libero.ok()) << libero.status();
  EXPECT_EQ(libero->instruction(), "open the drawer");
  EXPECT_TRUE(libero->has_proprioception());
  const auto columns = libero->ReadColumns(0);
  ASSERT_TRUE(columns.ok()) << columns.status();
  EXPECT_EQ(columns->steps, 50);
  EXPECT_NEAR(columns->actions[7 * 20 + 3], 0.21, 1e-12);
  const Eigen::Vector3d tool = ToolOf({0.1, 0.5, -0.5, 0.2, 0.2, 0, 0.04}).p_base_tool;
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(columns->ee_pos[3 * 20 + i], tool[i], 1e-12);
  const auto view = libero->ReadView(0, LiberoDemonstrationFile::View::kEyeInHand, 10);
  ASSERT_TRUE(view.ok());
  EXPECT_EQ(view->width, 128);
  EXPECT_TRUE(SequenceIn(*view).ok()) << "the top row is up";

  if (!ReaderFailure().empty())
    GTEST_SKIP() << "not read with LeRobot's libraries and h5py: " << ReaderFailure();
  const auto [output, code] =
      ReadBack(bench.directory + "/lerobot " + bench.directory + "/libero/episode_000000.hdf5");
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("episode 0: 'open the drawer' length 50 success True state 0.100"));
  EXPECT_THAT(output, HasSubstr("hdf5: 'open the drawer' length 50 state 0.100"));
}

TEST(DemonstrationWriterTest, SevenJointsAndAGripperAreEightNumbers) {
  DemonstrationEpisode episode;
  episode.axes = {7, true};
  episode.instruction = "wave";
  episode.ticks.resize(3);
  for (DemonstrationTick& tick : episode.ticks) {
    tick.state = {0, 1, 2, 3, 4, 5, 6, 0.07};
    tick.action = {10, 11, 12, 13, 14, 15, 16, 0.08};
  }
  const std::string path = ::testing::TempDir() + "/seven.safetensors";
  ASSERT_TRUE(WriteShard(episode, 0, 8, 1, 2, path).ok());
  const auto shard = SafetensorsFile::Open(path);
  ASSERT_TRUE(shard.ok()) << shard.status();
  const auto state = shard->ReadFloats("state", {3, 8});
  const auto actions = shard->ReadFloats("actions", {3, 2, 8});
  ASSERT_TRUE(state.ok() && actions.ok()) << state.status() << actions.status();
  EXPECT_EQ(state->at(8 + 6), 6);
  EXPECT_FLOAT_EQ(static_cast<float>(state->at(8 + 7)), 0.07f);
  EXPECT_EQ(actions->at(8 + 6), 16);
  episode.cameras = {"base", "wrist"};
  EXPECT_THAT(std::string(WriteLiberoEpisode(episode, ToolOf, path).message()),
              HasSubstr("7 numbers in an action, this arm 7 joints and a gripper"));
}

TEST(DemonstrationWriterTest, AFailureIsKeptOnlyWhereAskedAndNeverForTraining) {
  for (const bool keep : {false, true}) {
    DemonstrationOptions options;
    options.keep_failures = keep;
    Bench bench("failure", options);
    ASSERT_TRUE(bench.writer->Begin("open the drawer").ok());
    bench.Ticks(5);
    const auto ended = bench.writer->End(false);
    ASSERT_TRUE(ended.ok()) << ended.status();
    EXPECT_EQ(ended->saved, keep);
    EXPECT_EQ(bench.writer->episodes(), keep ? 1 : 0);
    EXPECT_EQ(bench.Holds("lerobot/meta/info.json"), keep);
    EXPECT_FALSE(bench.Holds("shards/episode_000000.safetensors"));
    EXPECT_FALSE(bench.Holds("libero/episode_000000.hdf5"));
  }
}

TEST(DemonstrationWriterTest, ACameraThatStopsSpoilsTheEpisodeAndTheNextOneIsRefused) {
  DemonstrationOptions options;
  options.max_frame_age_s = 0.1;
  Bench bench("stale", options);
  ASSERT_TRUE(bench.writer->Begin("open the drawer").ok());
  bench.Ticks(10);
  bench.wrist.Set(CameraFault::kUnplug);
  bench.Ticks(30);
  const auto ended = bench.writer->End(true);
  EXPECT_THAT(std::string(ended.status().message()),
              HasSubstr("camera 'wrist' gave no fresh picture: camera 'wrist' was unplugged"));
  EXPECT_FALSE(bench.Holds("lerobot/meta/info.json"));
  EXPECT_FALSE(bench.writer->Begin("again").ok());
  bench.wrist.Set(CameraFault::kNone);
  EXPECT_TRUE(bench.writer->Begin("again").ok());
  bench.Ticks(5);
  EXPECT_TRUE(bench.writer->End(true).ok());
}

TEST(DemonstrationWriterTest, AddNeverWaitsAndLostTicksSpoilTheEpisode) {
  Bench bench("lost");
  EXPECT_FALSE(bench.writer->Add({})) << "outside of episodes";
  ASSERT_TRUE(bench.writer->Begin("open the drawer").ok());
  const int64_t start = bench.clock.now_ns();
  int refused = 0;
  for (int i = 0; i < 20000; ++i) refused += bench.writer->Add({}) ? 0 : 1;
  EXPECT_LT(bench.clock.now_ns() - start, 1'000'000'000) << "20,000 pictures take far longer";
  EXPECT_GT(refused, 1000);
  EXPECT_THAT(std::string(bench.writer->End(true).status().message()), HasSubstr("were lost"));
  EXPECT_EQ(bench.writer->episodes(), 0);
}

TEST(DemonstrationWriterTest, RefusesWhatIsOutOfTurnAndNumbersThatAreNone) {
  Bench bench("turn");
  EXPECT_FALSE(bench.writer->End(true).ok());
  EXPECT_FALSE(bench.writer->Discard().ok());
  EXPECT_THAT(std::string(bench.writer->Begin("").message()), HasSubstr("instruction"));
  ASSERT_TRUE(bench.writer->Begin("one").ok());
  EXPECT_THAT(std::string(bench.writer->Begin("two").message()), HasSubstr("under way"));
  EXPECT_THAT(std::string(bench.writer->End(true).status().message()), HasSubstr("no ticks"));
  ASSERT_TRUE(bench.writer->Begin("one").ok());
  DemonstrationTick tick;
  tick.action[2] = std::numeric_limits<double>::quiet_NaN();
  bench.writer->Add(tick);
  EXPECT_THAT(std::string(bench.writer->End(true).status().message()), HasSubstr("finite"));
  ASSERT_TRUE(bench.writer->Begin("one").ok());
  bench.Ticks(3);
  EXPECT_TRUE(bench.writer->Discard().ok());
  ASSERT_TRUE(bench.writer->Begin("two").ok());
  bench.Ticks(4);
  EXPECT_EQ(bench.writer->End(true)->ticks, 4) << "nothing of what was discarded";
}

}  // namespace
}  // namespace robostress
