#include "robot_client/policy_link.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "robot_client/cameras/faulty_source.h"
#include "robot_client/cameras/synthetic_source.h"
#include "tests/robot_client/fake_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kPeriod_ns = 33'333'333;

// What a server would see.
struct Seen {
  std::vector<Observation> observations;
  std::vector<ExecutedChunk> feedback;
  std::vector<RunningRows> running;
  std::vector<EpisodeKey> episodes;
  int sessions = 0;
  absl::Status predict_status;  // the next predictions fail with it
  absl::Status feedback_status;
  std::function<void(PolicySpec&)> alter;  // what the server's policy is
};

class FakeEndpoint : public PolicyEndpoint {
 public:
  explicit FakeEndpoint(Seen* seen) : seen_(seen) {
    spec_.name = "fake";
    spec_.cameras = {"base"};
    spec_.state_dim = spec_.action_dim = 7;
    spec_.horizon = 50;
    spec_.resizes_images = true;
    if (seen_->alter) seen_->alter(spec_);
    ++seen_->sessions;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey& key) override {
    seen_->episodes.push_back(key);
    return absl::OkStatus();
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int) override {
    if (!seen_->predict_status.ok()) return seen_->predict_status;
    seen_->observations.push_back(observation);
    PredictedChunk chunk;
    chunk.prediction_id = ++predictions_;
    chunk.policy_actions.resize(50, 7);
    for (int i = 0; i < 50; ++i) {
      chunk.policy_actions.row(i) = observation.proprioception.transpose();
      chunk.policy_actions(i, 0) += 0.01f * static_cast<float>(i + 1);
    }
    chunk.actions = chunk.policy_actions;
    return chunk;
  }
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override {
    seen_->running.push_back(running);
    return Predict(observation, chunk);
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    if (absl::IsInvalidArgument(seen_->feedback_status))
      return seen_->feedback_status;  // not taken
    EXPECT_EQ(executed.sequence, ++sequence_);
    EXPECT_LE(executed.prediction_id, predictions_);
    seen_->feedback.push_back(std::move(executed));
    return seen_->feedback_status;
  }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

 private:
  Seen* seen_;
  PolicySpec spec_;
  uint64_t predictions_ = 0, sequence_ = 0;
};

// Client and server in simulated time: a prediction takes none.
struct Bench {
  ManualClock clock{1'000'000'000};
  FakeArm arm{&clock};
  FaultySource camera{std::make_unique<SyntheticSource>(SyntheticSourceOptions{"base"}, &clock),
                      &clock};
  FrameStamps stamps{{&camera}};
  Seen seen;
  std::unique_ptr<ControlLoop> loop;
  std::unique_ptr<PolicyLink> link;

  NoCameras nothing;

  // `watched`: the loop looks at the camera's stamps too, and holds the arm first.
  explicit Bench(bool watched = true, int rtc_rows = 0) {
    if (rtc_rows > 0) seen.alter = [](PolicySpec& spec) { spec.inpaints = true; };
    EXPECT_TRUE(arm.Connect().ok());
    EXPECT_TRUE(camera.Start().ok());
    auto made = ControlLoop::Create({}, &arm, &clock,
                                    watched ? static_cast<CameraStamps*>(&stamps) : &nothing);
    EXPECT_TRUE(made.ok()) << made.status();
    loop = *std::move(made);
    PolicyLinkOptions options;
    options.instruction = "open the drawer";
    options.rtc_rows = rtc_rows;
    link = std::make_unique<PolicyLink>(options, loop.get(), &clock,
                                        std::vector<FrameSource*>{&camera}, [this] {
                                          return absl::StatusOr<std::unique_ptr<PolicyEndpoint>>(
                                              std::make_unique<FakeEndpoint>(&seen));
                                        });
    EXPECT_TRUE(link->Open().ok());
    loop->OnPredictionRequested([this] { link->Serve(); });
  }
  void Tick(uint32_t requests = 0) {
    clock.Advance(kPeriod_ns);
    if (requests != 0) loop->Ask(requests);
    loop->Tick(clock.now_ns());
    link->Serve();
  }
  void Start(const EpisodeKey& key = {2, 5}) {
    if (loop->state() == ClientState::kIdle) Tick(kRequestEnable);
    const auto moves = [this] {
      const ArmVector v = arm.Latest().velocity;
      return std::any_of(v.begin(), v.end(), [](double x) { return std::abs(x) > 0.04; });
    };
    while (moves()) Tick();
    link->StartEpisode(key);
    Tick(kRequestStart);
    EXPECT_EQ(loop->state(), ClientState::kRun);
  }
  void Ticks(int n) {
    for (int i = 0; i < n; ++i) Tick();
  }
};

TEST(PolicyLinkTest, AnArmWithoutAGripperHasNoPolicy) {
  Bench bench;
  RehearsalArmOptions options;
  options.limits.axes.gripper = false;
  FakeArm arm(&bench.clock, options);
  ASSERT_TRUE(arm.Connect().ok());
  auto loop = ControlLoop::Create({}, &arm, &bench.clock, &bench.nothing);
  ASSERT_TRUE(loop.ok()) << loop.status();
  bench.seen.alter = [](PolicySpec& spec) { spec.state_dim = spec.action_dim = 6; };
  PolicyLink link({}, loop->get(), &bench.clock, {&bench.camera}, [&bench] {
    return absl::StatusOr<std::unique_ptr<PolicyEndpoint>>(
        std::make_unique<FakeEndpoint>(&bench.seen));
  });
  EXPECT_THAT(std::string(link.Open().message()),
              HasSubstr("6 joints, and the last of a policy's actions is a gripper's"));
}

TEST(PolicyLinkTest, SaysWhatToTypeForAPolicyThatDoesNotFit) {
  Bench bench;
  bench.seen.alter = [](PolicySpec& spec) { spec.cameras = {"agentview", "wrist"}; };
  EXPECT_THAT(std::string(bench.link->Open().message()),
              testing::AllOf(HasSubstr("wants the cameras [agentview, wrist]"),
                             HasSubstr("the client has [base]"),
                             HasSubstr("--camera agentview=SOURCE --camera wrist=SOURCE")));
  // Another robot's policy: no camera helps, nor that the numbers are as many.
  bench.seen.alter = [](PolicySpec& spec) { spec.control_space = ControlSpace::kEndEffector; };
  EXPECT_THAT(std::string(bench.link->Open().message()),
              HasSubstr("7 actions that move an end effector, this arm 7 of each"));
  bench.seen.alter = [](PolicySpec& spec) {
    spec.cameras = {"agentview", "wrist"};
    spec.state_dim = 8;
  };
  EXPECT_THAT(std::string(bench.link->Open().message()),
              testing::AllOf(HasSubstr("for another robot: it has 8 states and 7 actions"),
                             HasSubstr("robostress serve --policy nano-piper")));
}

// A camera has 640 x 480, nano takes 64 x 64 and resizes nothing.
TEST(PolicyLinkTest, GivesPicturesTheSizeThatThePolicyTakes) {
  Bench bench;
  bench.seen.alter = [](PolicySpec& spec) {
    spec.resizes_images = false;
    spec.image_width = 64;
    spec.image_height = 48;
  };
  ASSERT_TRUE(bench.link->Open().ok());
  bench.Start();
  bench.Ticks(5);
  ASSERT_FALSE(bench.seen.observations.empty());
  const Image& image = bench.seen.observations[0].views[0].image;
  EXPECT_EQ(image.width, 64);
  EXPECT_EQ(image.height, 48);
  EXPECT_EQ(image.data.size(), 3u * 64 * 48);
}

TEST(PolicyLinkTest, ShowsThePolicyTheNewestPictureTheJointsAndTheInstruction) {
  Bench bench;
  bench.Start();
  bench.Ticks(30);
  ASSERT_GE(bench.seen.observations.size(), 3u);
  uint64_t last = 0;
  for (const Observation& observation : bench.seen.observations) {
    EXPECT_EQ(observation.instruction, "open the drawer");
    ASSERT_EQ(observation.views.size(), 1u);
    const absl::StatusOr<uint64_t> sequence = SequenceIn(observation.views[0].image);
    ASSERT_TRUE(sequence.ok()) << sequence.status();
    EXPECT_GT(*sequence, last) << "newer than the one before";
    last = *sequence;
    EXPECT_EQ(observation.proprioception.size(), 7);
    EXPECT_NEAR(observation.proprioception[6], 0.05, 1e-6);
  }
  EXPECT_EQ(bench.seen.episodes.size(), 1u);
  EXPECT_EQ(bench.seen.episodes[0].task, 2);
}

TEST(PolicyLinkTest, AsksThePolicyToGoOnFromTheRowsThatAreLeft) {
  Bench bench(/*watched=*/true, /*rtc_rows=*/3);
  bench.Start();
  bench.Ticks(35);
  ASSERT_GE(bench.seen.observations.size(), 3u);
  ASSERT_EQ(bench.seen.running.size(), bench.seen.observations.size() - 1) << "not the first";
  for (size_t i = 0; i < bench.seen.running.size(); ++i) {
    const RunningRows& running = bench.seen.running[i];
    EXPECT_EQ(running.held, 3);
    ASSERT_EQ(running.actions.rows(), 40) << "ten of fifty were played";
    EXPECT_FLOAT_EQ(running.actions(0, 0), bench.seen.observations[i].proprioception[0] + 0.11f)
        << "the eleventh row of the chunk before";
  }
  bench.seen.alter = nullptr;
  EXPECT_THAT(std::string(bench.link->Open().message()),
              HasSubstr("rtc_rows is 3, and policy 'fake' cannot go on"));
}

TEST(PolicyLinkTest, ReportsEveryTenRowsInOrderWithoutGaps) {
  Bench bench;
  bench.Start();
  bench.Ticks(65);
  bench.Tick(kRequestEnd);
  bench.Ticks(3);
  ASSERT_GE(bench.seen.feedback.size(), 6u);
  for (size_t i = 0; i < bench.seen.feedback.size(); ++i) {
    const ExecutedChunk& chunk = bench.seen.feedback[i];
    EXPECT_EQ(chunk.task, 2);
    EXPECT_EQ(chunk.episode, 5);
    EXPECT_EQ(chunk.chunk, static_cast<int>(i));
    EXPECT_EQ(chunk.sequence, i + 1);
    if (i > 0) {
      EXPECT_LE(chunk.steps.size(), 10u);
    }
  }
  EXPECT_TRUE(bench.seen.feedback.back().last_of_episode);
  EXPECT_GT(bench.link->counters().residual.value(), 0);
}

TEST(PolicyLinkTest, KeepsTheSessionOverEpisodes) {
  Bench bench;
  for (int episode = 0; episode < 25; ++episode) {
    bench.Start({1, episode});
    bench.Ticks(25);
    bench.Tick(kRequestEnd);
    bench.Ticks(2);
  }
  EXPECT_EQ(bench.seen.sessions, 1);
  EXPECT_EQ(bench.link->counters().sessions, 1u);
  ASSERT_EQ(bench.seen.episodes.size(), 25u);
  EXPECT_EQ(bench.seen.episodes.back().episode, 24);
  EXPECT_EQ(bench.seen.feedback.back().sequence, bench.seen.feedback.size());
}

TEST(PolicyLinkTest, AFailedPredictionIsAskedForAgain) {
  Bench bench;
  bench.Start();
  bench.Ticks(20);
  bench.seen.predict_status = absl::UnavailableError("cut");
  bench.Ticks(20);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun) << "the arm holds and waits";
  bench.seen.predict_status = absl::OkStatus();
  bench.Ticks(20);
  EXPECT_TRUE(bench.loop->last_record().flags & kTickPlayed);
  EXPECT_EQ(bench.seen.sessions, 1) << "a network that was cut leaves the session";
  EXPECT_GT(bench.link->counters().failed_predictions, 0u);
  EXPECT_THAT(std::string(bench.link->last_error().message()), HasSubstr("cut"));
}

TEST(PolicyLinkTest, ARestartedServerIsGivenANewSessionAndOldFeedbackIsNotSent) {
  Bench bench;
  bench.Start();
  bench.Ticks(25);
  bench.seen.predict_status = absl::NotFoundError("unknown session");
  bench.Ticks(10);
  bench.seen.predict_status = absl::OkStatus();
  bench.Ticks(30);
  EXPECT_GE(bench.seen.sessions, 2);
  EXPECT_EQ(bench.seen.episodes.back().episode, 5) << "the episode is announced again";
  EXPECT_GE(bench.link->counters().feedback_of_lost_sessions, 1u);
  EXPECT_TRUE(bench.loop->last_record().flags & kTickPlayed);
}

TEST(PolicyLinkTest, FeedbackThatAStreamLostCountsAsSent) {
  Bench bench;
  bench.seen.feedback_status = absl::UnavailableError("kept for later");
  bench.Start();
  bench.Ticks(45);
  EXPECT_GE(bench.seen.feedback.size(), 3u);  // the fake checks that no sequence number repeats
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
}

TEST(PolicyLinkTest, RefusedFeedbackIsNoFailedPrediction) {
  Bench bench;
  bench.seen.feedback_status = absl::InvalidArgumentError("refused");
  bench.Start();
  bench.Ticks(45);
  const PolicyLinkCounters counters = bench.link->counters();
  EXPECT_GE(counters.failed_feedback, 3u);
  EXPECT_EQ(counters.feedback_sent, 0u);
  EXPECT_EQ(counters.failed_predictions, 0u);
  EXPECT_THAT(std::string(bench.link->last_error().message()), HasSubstr("refused"));
}

TEST(PolicyLinkTest, StalePicturesAreNotShownAndTheArmHolds) {
  Bench bench;
  bench.Start();
  bench.Ticks(15);
  bench.camera.Set(CameraFault::kUnplug);
  bench.Ticks(14);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
  bench.Ticks(5);
  EXPECT_EQ(bench.loop->state(), ClientState::kHold);
  EXPECT_EQ(bench.loop->last_record().cause, StateCause::kCameraStale);
  bench.camera.Set(CameraFault::kNone);
  bench.Tick();
  bench.Tick(kRequestResume);
  EXPECT_EQ(bench.loop->state(), ClientState::kRun);
}

TEST(PolicyLinkTest, PicturesFromTheFutureAreNotShown) {
  Bench bench(false);
  bench.Start();
  bench.Ticks(15);
  bench.camera.Set(CameraFault::kFuture, 0.5);
  const size_t before = bench.seen.observations.size();
  bench.Ticks(60);
  EXPECT_EQ(bench.seen.observations.size(), before);
  EXPECT_GT(bench.link->counters().stale_frames, 0u);
  EXPECT_THAT(std::string(bench.link->last_error().message()), HasSubstr("in the future"));
}

TEST(PolicyLinkTest, RecordsTheAgeOfEveryPictureThatAPredictionSaw) {
  Bench bench(false);
  SpscRing<FrameRecord> frames{100};
  bench.link->RecordFrames(&frames, /*pictures=*/true);
  bench.Start();
  bench.Ticks(15);
  std::vector<FrameRecord> shown;
  for (FrameRecord record; frames.Pop(record);) shown.push_back(record);
  ASSERT_EQ(shown.size(), bench.seen.observations.size());
  for (size_t i = 0; i < shown.size(); ++i) {
    EXPECT_EQ(shown[i].use, FrameUse::kShown);
    EXPECT_STREQ(shown[i].camera.data(), "base");
    EXPECT_EQ(shown[i].sequence, *SequenceIn(bench.seen.observations[i].views[0].image));
    EXPECT_EQ(shown[i].prediction_id & 0xffff, i + 1);
    EXPECT_EQ(shown[i].request, i + 1);
    ASSERT_NE(shown[i].picture, nullptr);
    EXPECT_EQ(shown[i].picture->data, bench.seen.observations[i].views[0].image.data);
    const int64_t age_ns = shown[i].observed_ns - shown[i].stamp_ns;
    EXPECT_GE(age_ns, 10'000'000) << "a synthetic picture arrives 10 ms after its exposure";
    EXPECT_LE(age_ns, 10'000'000 + kPeriod_ns);
  }
  bench.camera.Set(CameraFault::kFuture, 0.5);
  bench.Ticks(5);
  FrameRecord refused;
  for (FrameRecord record; frames.Pop(record);) refused = record;
  EXPECT_EQ(refused.use, FrameUse::kFuture);
  EXPECT_EQ(refused.prediction_id, 0u);
  EXPECT_EQ(refused.picture, nullptr);
  EXPECT_LT(refused.observed_ns, refused.stamp_ns);
}

TEST(PolicyLinkTest, RefusesAPolicyThatDoesNotFit) {
  Bench bench;
  PolicyLinkOptions options;
  PolicyLink other(options, bench.loop.get(), &bench.clock, {}, [&bench] {
    return absl::StatusOr<std::unique_ptr<PolicyEndpoint>>(
        std::make_unique<FakeEndpoint>(&bench.seen));
  });
  EXPECT_THAT(std::string(other.Open().message()), HasSubstr("--camera"));
}

}  // namespace
}  // namespace robostress
