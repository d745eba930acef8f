// The whole circle on a Piper in software: what is hidden in it is found in its recording, and an
// arm with what was found goes where the recorded one went.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "calibration/data/client_recordings.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "nlohmann/json.hpp"
#include "robot_client/client_config.h"
#include "robot_client/motion/excitation.h"
#include "robot_client/recorder.h"
#include "tests/robot_client/arm_world.h"
#include "tests/robot_client/piper/emulated_arm.h"
#include "tests/run_program.h"

namespace robostress::calibration {
namespace {

using piper::EmulatedArm;
using piper::kJoints;
using testing::AllOf;
using testing::HasSubstr;
namespace fs = std::filesystem;

constexpr double kTick_s = 1.0 / 30;

// Every joint sways at its own two frequencies, inside its limits.
piper::JointVector Sway(double t) {
  const piper::JointVector middle = {0, 1.2, -1.2, 0, 0, 0}, most = {0.6, 0.5, 0.5, 0.5, 0.5, 0.6};
  piper::JointVector q;
  for (int j = 0; j < kJoints; ++j) {
    const double slow = 2 * M_PI * (0.11 + 0.023 * j), fast = 2 * M_PI * (0.31 + 0.017 * j);
    q[j] = middle[j] + most[j] * (0.7 * std::sin(slow * t) + 0.3 * std::sin(fast * t + j));
  }
  return q;
}

// Moves an arm of `profile` as Sway says, and returns where its joints were at every tick. Records
// like a client does where `directory` is given.
std::vector<piper::JointVector> Play(const std::string& profile, double seconds,
                                     const std::string& directory) {
  piper::EmulatorOptions options;
  options.profile = profile;
  EmulatedArm world(options);
  EXPECT_TRUE(world.arm->Connect().ok());
  EXPECT_TRUE(world.arm->Enable().ok());
  EXPECT_TRUE(world.Stream(piper::Command(Sway(0)), 3).ok());
  std::unique_ptr<Recorder> recorder;
  if (!directory.empty()) {
    auto made = Recorder::Create(directory);
    EXPECT_TRUE(made.ok()) << made.status();
    recorder = *std::move(made);
    world.arm->AddSampleReader(&recorder->samples());
  }
  std::vector<piper::JointVector> joints;
  for (uint64_t tick = 0; tick < static_cast<uint64_t>(seconds / kTick_s); ++tick) {
    const double t = static_cast<double>(tick) * kTick_s;
    if (recorder != nullptr) {
      TickRecord record;
      record.tick = tick;
      record.start_ns = record.due_ns = record.sent_ns = world.time.now_ns();
      record.state = ClientState::kRun;
      record.episode = 0;
      record.sent = piper::Command(Sway(t)).position;
      recorder->ring().Push(record);
      EXPECT_TRUE(recorder->Drain().ok());
    }
    EXPECT_TRUE(world.Stream(piper::Command(Sway(t)), kTick_s + 1e-6).ok());
    joints.push_back(world.emulator->plant().link_angles());
  }
  if (recorder != nullptr) {
    EXPECT_TRUE(recorder->Finish().ok());
  }
  return joints;
}

double Rms(const std::vector<piper::JointVector>& a, const std::vector<piper::JointVector>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i)
    for (int j = 0; j < kJoints; ++j) sum += std::pow(a[i][j] - b[i][j], 2);
  return std::sqrt(sum / static_cast<double>(a.size() * kJoints));
}

struct PiperCircleTest : public testing::Test {
  PiperCircleTest()
      : root((fs::path(testing::TempDir()) / absl::StrCat("piper_circle_", getpid())).string()) {
    fs::create_directories(root);
  }
  ~PiperCircleTest() override { fs::remove_all(root); }
  std::string root;
};

TEST_F(PiperCircleTest, FindsWhatWasHiddenAndBringsAnArmToTheRecording) {
  constexpr double kSeconds = 24;
  const std::string hidden = root + "/worn.yaml", none = root + "/none.yaml";
  const std::string effect = "[{type: stribeck_friction, Fc: 0.8, Fs: 1.0, vs: 0.1, sigma_v: 0.5}]";
  const std::string absent = "[{type: stribeck_friction, Fc: 0, Fs: 0, vs: 0.1, sigma_v: 0}]";
  for (const auto& [file, effects] : {std::pair(hidden, effect), {none, absent}}) {
    ASSERT_TRUE(
        WriteFileAtomically(file, absl::StrCat("joints: [{name: J3, effects: ", effects, "}]\n"))
            .ok());
  }
  const auto measured = Play(hidden, kSeconds, root + "/run");
  const auto [made, made_code] =
      RunProgram(RECORD_TO_RIG, absl::StrCat(root, "/run --out ", root, "/rig"));
  ASSERT_EQ(made_code, 0) << made;
  EXPECT_THAT(made, HasSubstr("2 fit, 1 held_out"));
  const auto [output, code] = RunProgram(
      CALIBRATE,
      absl::StrCat(
          "--rig ", root, "/rig/rig.yaml --out ", root,
          "/found --map own --surrogates 99 --joints piper_joint3 --max-effects 1 --beam 1"));
  ASSERT_EQ(code, 0) << output;
  const auto text = ReadFile(root + "/found/report.json");
  ASSERT_TRUE(text.ok()) << text.status();
  const auto report = nlohmann::json::parse(*text);
  ASSERT_FALSE(report["effects_added"].empty()) << output;
  EXPECT_EQ(report["effects_added"][0]["type"], "stribeck_friction") << output;
  const double apart = Rms(Play(none, kSeconds, ""), measured);
  const double left = Rms(Play(root + "/found/scenario.yaml", kSeconds, ""), measured);
  EXPECT_LT(left, 0.2 * apart) << output;
  RecordProperty("before_mrad", std::to_string(1e3 * apart));
  RecordProperty("after_mrad", std::to_string(1e3 * left));
}

// With `robostress identify --run` as a person runs it.
TEST_F(PiperCircleTest, FindsHowAHealthyArmAnswersTargets) {
  const auto measured = Play("new", 24, root + "/run");
  const auto [output, code] = RunProgram(
      IDENTIFY, absl::StrCat("--run ", root, "/run --surrogates 99 --out ", root, "/identified"));
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("J6  delay "));
  const auto config = LoadConfig<ClientConfig>(root + "/identified/response.yaml");
  ASSERT_TRUE(config.ok()) << config.status();
  const DisturbanceObserverOptions& observer = config->control.disturbance_observer;
  ASSERT_TRUE(CheckControlOptions(config->control, 6).ok());
  EXPECT_TRUE(config->control.observer && observer.anti_windup);
  EXPECT_EQ(observer.bandwidth, 0.5) << "slower than the arm's own servos";
  // Another motion, in open loop: where the arm is, and where the response says.
  JointResponse response(observer.response);
  const auto sway = [](double t) {
    const piper::JointVector q = Sway(40 + t);
    return JointResponse::Joints(Eigen::Map<const Eigen::Matrix<double, kJoints, 1>>(q.data()));
  };
  EXPECT_LT(measured.size(), 40 / kTick_s);
  piper::EmulatorOptions options;
  options.profile = "new";
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
  ASSERT_TRUE(world.Stream(piper::Command(Sway(40)), 3).ok());
  response.Reset(sway(0));
  double lag = 0, off = 0;
  for (int tick = 0; tick < 300; ++tick) {
    const JointResponse::Joints target = sway(tick * kTick_s);
    piper::JointVector command;
    for (int j = 0; j < kJoints; ++j) command[j] = target[j];
    ASSERT_TRUE(world.Stream(piper::Command(command), kTick_s + 1e-6).ok());
    response.Advance(target, kTick_s);
    for (int j = 0; j < kJoints; ++j) {
      const double q = world.emulator->plant().link_angles()[j];
      lag += std::pow(q - target[j], 2);
      off += std::pow(q - response.position()[j], 2);
    }
  }
  EXPECT_LT(off, 0.04 * lag) << "a fifth of the lag at most";
  std::printf("lag %.2f mrad, unexplained %.2f mrad\n", 1e3 * std::sqrt(lag / 1800),
              1e3 * std::sqrt(off / 1800));
}

// What `robot_client excite` plays where it is given no motion, through the client's own loop.
TEST_F(PiperCircleTest, TheDesignedMotionShowsWhatWasHidden) {
  const std::string hidden = root + "/worn.yaml";
  ASSERT_TRUE(
      WriteFileAtomically(hidden,
                          "joints: [{name: J2, effects: [{type: stribeck_friction, Fc: 0.9, Fs: "
                          "1.2, vs: 0.1, sigma_v: 0.5}]}]\n")
          .ok());
  ArmWorld::Options options;
  options.profile = hidden;
  ArmWorld world(options);
  ASSERT_TRUE(world.connected.ok()) << world.connected;
  auto recorder = Recorder::Create(root + "/run");
  ASSERT_TRUE(recorder.ok()) << recorder.status();
  world.loop->AddReader(&(*recorder)->ring());
  world.arm->AddSampleReader(&(*recorder)->samples());
  const auto tick = [&](uint32_t requests = 0) {
    world.Tick(requests);
    EXPECT_TRUE((*recorder)->Drain().ok());
  };
  for (int i = 0; i < 100 && world.loop->state() != ClientState::kEnabled; ++i)
    tick(i % 10 == 0 ? uint32_t{kRequestEnable} : 0);  // its joints settle on their servos
  ASSERT_EQ(world.loop->state(), ClientState::kEnabled) << world.loop->enable_status();
  ExcitationOptions design;
  design.centre = {0, 1.2, -1.0, 0, 0.5, 0, 0.03};
  design.together_s = 20;
  const auto motion = DesignExcitation(design, world.arm->limits(), world.model.get());
  ASSERT_TRUE(motion.ok()) << motion.status();
  const PlayedMotion played =
      PlayMotion(*motion, 1, world.loop->seen().position, PathLimits{}, ArmWorld::kPeriod_s);
  world.loop->Play(&played.path);
  for (size_t i = 0; i < played.path.rows.size() + 60; ++i) tick();
  EXPECT_EQ(world.loop->cause(), StateCause::kArrived) << "nothing held it";
  ASSERT_TRUE((*recorder)->Finish().ok());
  const auto [made, made_code] =
      RunProgram(RECORD_TO_RIG, absl::StrCat(root, "/run --out ", root, "/rig"));
  ASSERT_EQ(made_code, 0) << made;
  const auto [output, code] = RunProgram(
      CALIBRATE,
      absl::StrCat(
          "--rig ", root, "/rig/rig.yaml --out ", root,
          "/found --map own --surrogates 99 --joints piper_joint2 --max-effects 1 --beam 1"));
  ASSERT_EQ(code, 0) << output;
  const auto text = ReadFile(root + "/found/report.json");
  ASSERT_TRUE(text.ok()) << text.status();
  const auto report = nlohmann::json::parse(*text);
  ASSERT_FALSE(report["effects_added"].empty()) << output;
  const auto& found = report["effects_added"][0];
  EXPECT_EQ(found["type"], "stribeck_friction") << output;
  EXPECT_NEAR(found["parameters"]["Fc"].get<double>(), 0.9, 0.15) << output;
  EXPECT_NEAR(found["parameters"]["sigma_v"].get<double>(), 0.5, 0.25) << output;
  const auto episodes = EpisodesOfClientRun(root + "/run", 1);
  ASSERT_TRUE(episodes.ok()) << episodes.status();
  EXPECT_EQ(episodes->front().command.size(), 6u) << "rows without power have no targets";
}

TEST_F(PiperCircleTest, PartsARecordingWhereSamplesWereLostOrCameLate) {
  std::string samples = "t,sequence";
  for (const char* group : {"q", "dq", "tau"})
    for (int j = 1; j <= 6; ++j) absl::StrAppend(&samples, ",", group, "_J", j);
  double t = 0;
  for (int i = 0, number = 0; i < 900; ++i) {
    t += i == 300 ? 0.03 : 0.005;  // late, though none was lost
    number += i == 600 ? 2 : 1;    // lost, though none was late
    absl::StrAppend(&samples, "\n", t, ",", number);
    for (int k = 0; k < 18; ++k) absl::StrAppend(&samples, ",", 0.001 * i);
  }
  ASSERT_TRUE(WriteFileAtomically(root + "/samples.csv", samples + "\n").ok());
  ASSERT_TRUE(
      WriteFileAtomically(root + "/ticks.csv", "t,state,episode\n0,MOVE,-1\n2,MOVE,-1\n9,MOVE,-1\n")
          .ok());
  const auto episodes = EpisodesOfClientRun(root, 1);
  ASSERT_TRUE(episodes.ok()) << episodes.status();
  ASSERT_EQ(episodes->size(), 3u);
  for (const RecordedEpisode& episode : *episodes) EXPECT_EQ(episode.t.size(), 300u);
}

TEST_F(PiperCircleTest, ARunOfSevenJointsIsReadWholeAndMakesNoRigOfAPiper) {
  std::string samples = "t,sequence", ticks = "t,sent_us,state,episode";
  for (const char* group : {"q", "dq", "tau"})
    for (int j = 1; j <= 7; ++j) absl::StrAppend(&samples, ",", group, "_J", j);
  for (int j = 1; j <= 7; ++j) absl::StrAppend(&ticks, ",sent_J", j);
  for (int i = 0; i < 400; ++i) {
    absl::StrAppend(&samples, "\n", 0.005 * i, ",", i + 1);
    for (int k = 0; k < 21; ++k) absl::StrAppend(&samples, ",", k);
  }
  for (const char* t : {"0", "1.9"}) {
    absl::StrAppend(&ticks, "\n", t, ",20,RUN,0");
    for (int j = 1; j <= 7; ++j) absl::StrAppend(&ticks, ",", j);
  }
  ASSERT_TRUE(WriteFileAtomically(root + "/samples.csv", samples + "\n").ok());
  ASSERT_TRUE(WriteFileAtomically(root + "/ticks.csv", ticks + "\n").ok());
  const auto episodes = EpisodesOfClientRun(root, 1);
  ASSERT_TRUE(episodes.ok()) << episodes.status();
  const RecordedEpisode& episode = episodes->front();
  ASSERT_EQ(episode.q.size(), 7u);
  ASSERT_EQ(episode.command.size(), 7u);
  EXPECT_EQ(episode.q[6][0], 6);
  EXPECT_EQ(episode.tau[6][0], 20);
  EXPECT_EQ(episode.command[6][0], 7);
  EXPECT_EQ(ArmResponse("arm_response", 7).joints.size(), 7u);
  const auto [output, code] =
      RunProgram(RECORD_TO_RIG, absl::StrCat(root, " --out ", root, "/rig"));
  EXPECT_EQ(code, 2);
  EXPECT_THAT(output, AllOf(HasSubstr("an arm of 7 joints"), HasSubstr("a Piper's")));
  // Whose joints are called what, the run says itself.
  EXPECT_FALSE(JointNamesOfClientRun(root)->has_value()) << "a run from before 0.2";
  ASSERT_TRUE(WriteFileAtomically(root + "/arm.json", "{\"joints\":[\"pan\",\"lift\"]}").ok());
  EXPECT_THAT(**JointNamesOfClientRun(root), testing::ElementsAre("pan", "lift"));
  for (const char* damaged : {"", "[]", "{\"joints\":\"pan\"}", "{\"joints\":[1,2]}"}) {
    ASSERT_TRUE(WriteFileAtomically(root + "/arm.json", damaged).ok());
    EXPECT_THAT(std::string(JointNamesOfClientRun(root).status().message()),
                AllOf(HasSubstr("arm.json: has no list of names"), HasSubstr("--joints")))
        << damaged;
  }
}

TEST_F(PiperCircleTest, SaysWhatARunLacks) {
  const auto refusal = [&] {
    const auto [output, code] =
        RunProgram(RECORD_TO_RIG, absl::StrCat(root, " --out ", root, "/rig"));
    EXPECT_EQ(code, 2);
    return output;
  };
  ASSERT_TRUE(WriteFileAtomically(root + "/ticks.csv.partial", "t,state,episode\n").ok());
  EXPECT_THAT(refusal(), HasSubstr("cut off"));
  ASSERT_TRUE(WriteFileAtomically(root + "/ticks.csv", "t,state,episode\n0,RUN,0\n9,RUN,0\n").ok());
  EXPECT_THAT(refusal(), AllOf(HasSubstr("samples.csv"), HasSubstr("older")));
  ASSERT_TRUE(WriteFileAtomically(root + "/samples.csv", "t,sequence,q_J1\n0,1,0.5\n").ok());
  EXPECT_THAT(refusal(), HasSubstr("no column 'dq_J1'"));
  ASSERT_TRUE(WriteFileAtomically(root + "/samples.csv", "t,sequence,q_J1\n0,x,0.5\n").ok());
  EXPECT_THAT(refusal(), AllOf(HasSubstr("samples.csv:2"), HasSubstr("sequence is 'x'")));
  EXPECT_FALSE(fs::exists(root + "/rig/rig.yaml"));
}

}  // namespace
}  // namespace robostress::calibration
