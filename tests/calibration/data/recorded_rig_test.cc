#include "calibration/data/recorded_rig.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/measured_log.h"
#include "calibration/data/sim_recordings.h"
#include "common/csv_table.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

// A pendulum that swings for 2 s.
RecordedEpisode Episode(const std::string& name, const std::string& group) {
  RecordedEpisode episode;
  episode.name = name;
  episode.group = group;
  episode.rate_hz = 250;
  episode.q.resize(1), episode.dq.resize(1), episode.tau.resize(1);
  for (int i = 0; i < 500; ++i) {
    const double t = i / 250.0;
    episode.t.push_back(t);
    episode.q[0].push_back(std::sin(3 * t));
    episode.dq[0].push_back(3 * std::cos(3 * t));
    episode.tau[0].push_back(std::cos(t));
    episode.contact_N.push_back(0);
  }
  return episode;
}

RecordedArm Pendulum() {
  RecordedArm arm;
  arm.name = "pendulum";
  arm.model_file = "pendulum.xml";
  arm.mjcf = R"(<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.1" pos="0 0 0.3"/></body></worldbody></mujoco>)";
  arm.joints = {"hinge"};
  return arm;
}

struct RecordedRigTest : public testing::Test {
  RecordedRigTest()
      : out((fs::path(testing::TempDir()) / absl::StrCat("recorded_rig_", getpid())).string()) {}
  ~RecordedRigTest() override { fs::remove_all(out); }
  std::string out;
};

// As calibrate would refuse the log, and with it the rig.
TEST_F(RecordedRigTest, APieceInWhichAJointStandsStillIsLeftOut) {
  std::vector<RecordedEpisode> episodes;
  for (int i = 0; i < 4; ++i) episodes.push_back(Episode(absl::StrCat("episode", i), "task"));
  for (double& q : episodes[1].q[0]) q = 0.3 + 1e-4 * q;
  RecordedRigOptions options;
  options.encoder_noise = 2e-5;
  const auto summary = WriteRecordedRig(Pendulum(), episodes, options, out);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(summary->pieces, 3);
  EXPECT_EQ(summary->seconds_left_out, 2);
  EXPECT_FALSE(fs::exists(out + "/episode1_0.csv"));
}

// Three joints were moved, the rig knows the third and the first.
TEST_F(RecordedRigTest, AnotherArmsModelIsTakenOver) {
  std::vector<RecordedEpisode> episodes;
  for (int i = 0; i < 4; ++i) {
    episodes.push_back(Episode(absl::StrCat("episode", i), "run"));
    RecordedEpisode& episode = episodes.back();
    episode.contact_N.clear();
    const std::vector<double> q = episode.q[0];
    for (auto channels : {&episode.q, &episode.dq, &episode.tau, &episode.command})
      channels->assign(3, q);
    for (double& command : episode.command[2]) command += 0.5;
    for (double& angle : episode.q[2]) angle += 0.25;
  }
  Rig rig;
  rig.file = "lab/rig.yaml";
  rig.name = "lab";
  rig.model = out + "/../lab.urdf";
  rig.gravity = {{0, 0, 0}};
  rig.joints.resize(2);
  rig.joints[0].name = "elbow";
  rig.joints[0].servo = {.kp = 30, .kd = 2};
  rig.joints[0].fit = {"servo.kp"};
  rig.joints[1].name = "pan";
  rig.joints[1].servo = {.kp = 40, .kd = 3};

  const auto refusal = [&](const std::vector<std::string>& names) {
    std::vector<RecordedEpisode> copy = episodes;
    return std::string(ArmOfRig(rig, names, &copy).status().message());
  };
  EXPECT_THAT(refusal({}), HasSubstr("the run is of 3 joints, the names are 2 (elbow, pan)"));
  EXPECT_THAT(refusal({"pan", "lift", "flex"}), HasSubstr("must hold every joint of lab/rig.yaml"));
  EXPECT_THAT(refusal({"pan", "pan", "elbow"}), HasSubstr("'pan' twice"));
  rig.joints[1].input = JointInput::kTorque;
  EXPECT_THAT(refusal({"pan", "lift", "elbow"}), HasSubstr("one for all of them"));
  rig.joints[0].input = JointInput::kTorque;
  std::vector<RecordedEpisode> with = episodes, without = episodes;
  EXPECT_TRUE(ArmOfRig(rig, {"pan", "lift", "elbow"}, &with).ok());
  for (RecordedEpisode& episode : without) episode.tau[2].assign(episode.t.size(), 0);
  EXPECT_THAT(std::string(ArmOfRig(rig, {"pan", "lift", "elbow"}, &without).status().message()),
              HasSubstr("the run has no torques of elbow"));
  for (RigJoint& joint : rig.joints) joint.input = JointInput::kPositionTarget;

  const auto arm = ArmOfRig(rig, {"pan", "lift", "elbow"}, &episodes);
  ASSERT_TRUE(arm.ok()) << arm.status();
  const auto summary = WriteRecordedRig(*arm, episodes, {}, out);
  ASSERT_TRUE(summary.ok()) << summary.status();
  const auto written = ReadRig(summary->rig_file);
  ASSERT_TRUE(written.ok()) << written.status();
  EXPECT_EQ(fs::weakly_canonical(written->model), fs::weakly_canonical(rig.model));
  EXPECT_EQ(written->gravity, rig.gravity);
  EXPECT_EQ(written->rate_hz, 250);
  ASSERT_EQ(written->joints.size(), 2u);
  EXPECT_EQ(written->joints[0].name, "pan");
  EXPECT_EQ(written->joints[0].servo.kp, 40);
  EXPECT_EQ(written->joints[1].name, "elbow");
  EXPECT_THAT(written->joints[1].fit, ::testing::ElementsAre("servo.kp"));
  const auto csv = CsvTable::Read(written->logs[0].file);
  ASSERT_TRUE(csv.ok()) << csv.status();
  EXPECT_NEAR(*csv->Number(100, *csv->Column("q_cmd_elbow")), std::sin(3 * 0.4) + 0.5, 1e-6);
  EXPECT_NEAR(*csv->Number(100, *csv->Column("q_elbow")), std::sin(3 * 0.4) + 0.25, 1e-3);
  EXPECT_NEAR(*csv->Number(100, *csv->Column("q_pan")), std::sin(3 * 0.4), 1e-3);
  EXPECT_FALSE(csv->Has("q_lift"));
}

TEST_F(RecordedRigTest, NoEpisodeIsBothFittedAndHeldOut) {
  std::vector<RecordedEpisode> episodes;
  for (int task = 0; task < 3; ++task)
    for (int i = 0; i < 4; ++i)
      episodes.push_back(
          Episode(absl::StrCat("task", task, "_episode", i), absl::StrCat("task ", task)));
  const auto summary = WriteRecordedRig(Pendulum(), episodes, {}, out);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(summary->logs_of_role, (std::array<int, 3>{6, 2, 4}));
  const auto rig = ReadRig(summary->rig_file);
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_EQ(rig->folds, Folds::kCondition);
  for (const RigLog& log : rig->logs) {
    const LogRole expected = log.condition.rfind("task2", 0) == 0 ? LogRole::kTransfer
                             : log.condition.back() == '2'        ? LogRole::kHeldOut
                                                                  : LogRole::kFit;
    EXPECT_EQ(log.role, expected) << log.condition;
  }
}

TEST_F(RecordedRigTest, LeavesOutWhatIsNearContacts) {
  std::vector<RecordedEpisode> episodes;
  for (int i = 0; i < 3; ++i) {
    episodes.push_back(Episode(absl::StrCat("task0_episode", i), "task 0"));
    for (int k = 300; k < 320; ++k) episodes.back().contact_N[k] = 5;
    for (double& tau : episodes.back().tau[0]) tau += 0.1 * i;  // copies of a log are refused
    episodes.back().contact_N[100] = 0.5;                       // below the limit
  }
  RecordedRigOptions options;
  options.encoder_noise = 0;
  const auto summary = WriteRecordedRig(Pendulum(), episodes, options, out);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_EQ(summary->pieces, 6);
  const auto rig = ReadRig(summary->rig_file);
  ASSERT_TRUE(rig.ok());
  const auto before = ReadMeasuredLog(*rig, rig->logs[0]),
             after = ReadMeasuredLog(*rig, rig->logs[1]);
  ASSERT_TRUE(before.ok()) << before.status();
  ASSERT_TRUE(after.ok()) << after.status();
  // 0.05 s margin on both sides: 13 rows, rounded.
  EXPECT_EQ(before->rows, 300 - 13);
  EXPECT_EQ(after->rows, 500 - 320 - 13);
  EXPECT_EQ(before->condition, after->condition);
  EXPECT_NEAR(before->joints[0].dq[10], 3 * std::cos(3 * 10 / 250.0), 1e-7);
}

TEST_F(RecordedRigTest, AddsTheSameNoiseForTheSameSeed) {
  std::vector<RecordedEpisode> episodes;
  for (int i = 0; i < 3; ++i)
    episodes.push_back(Episode(absl::StrCat("task0_episode", i), "task 0"));
  std::vector<std::vector<double>> readings;
  for (const uint64_t seed : {1, 1, 2}) {
    RecordedRigOptions options;
    options.encoder_noise = 1e-4;
    options.seed = seed;
    const auto summary = WriteRecordedRig(Pendulum(), episodes, options, out);
    ASSERT_TRUE(summary.ok()) << summary.status();
    const auto rig = ReadRig(summary->rig_file);
    const auto log = ReadMeasuredLog(*rig, rig->logs[0]);
    ASSERT_TRUE(log.ok()) << log.status();
    EXPECT_NEAR(log->joints[0].noise, 1e-4, 2e-5);
    readings.push_back(log->joints[0].q);
  }
  EXPECT_EQ(readings[0], readings[1]);
  EXPECT_NE(readings[0], readings[2]);
}

TEST_F(RecordedRigTest, RefusesARunThatIsAllContact) {
  std::vector<RecordedEpisode> episodes = {Episode("task0_episode0", "task 0")};
  for (double& force : episodes[0].contact_N) force = 3;
  const auto summary = WriteRecordedRig(Pendulum(), episodes, {}, out);
  EXPECT_EQ(summary.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(summary.status().message()), HasSubstr("without contact"));
  EXPECT_FALSE(fs::exists(out + "/rig.yaml"));
}

JointLog SmallLog() {
  JointLog log;
  log.suite = "tabletop_goal";
  log.scenario = "worn";
  log.policy = "expert";
  log.task = 2;
  log.episode = 1;
  log.initial_state = 41;
  for (int i = 0; i < 9; ++i) {
    JointSample sample;
    sample.t = 0.002 * i;
    sample.q.setConstant(i);
    sample.dq.setConstant(500);
    sample.tau.setConstant(i * i);
    sample.contact_N = i == 3 ? 7 : 0;
    log.samples.push_back(sample);
  }
  log.actions.push_back(Eigen::VectorXf::LinSpaced(7, 0, 1));
  for (int i = 0; i < 2; ++i) {
    RobotState state;
    state.q = Eigen::VectorXd::Constant(7, i);
    state.tool.p_base_tool = {0.1, 0.2, 0.3 + i};
    log.states.push_back(state);
  }
  return log;
}

TEST_F(RecordedRigTest, ARowsTorqueIsTheTrapezoidalMeanOverIt) {
  const auto episode = EpisodeOfJointLog(SmallLog(), 125);  // 4 sub-steps a row
  ASSERT_TRUE(episode.ok()) << episode.status();
  ASSERT_EQ(episode->t.size(), 2u);
  EXPECT_DOUBLE_EQ(episode->tau[3][0], (0.0 / 2 + 1 + 4 + 9 + 16.0 / 2) / 4);
  EXPECT_DOUBLE_EQ(episode->q[3][1], 4);
  EXPECT_EQ(episode->contact_N[0], 7);
  EXPECT_EQ(episode->contact_N[1], 0);
  EXPECT_THAT(std::string(EpisodeOfJointLog(SmallLog(), 300).status().message()),
              HasSubstr("does not divide"));
}

TEST_F(RecordedRigTest, AJointLogIsReadBackAsItWasWritten) {
  fs::create_directories(out + "/joints");
  const JointLog log = SmallLog();
  const std::string file = out + "/joints/task2_episode1.safetensors";
  ASSERT_TRUE(WriteJointLog(log, file).ok());
  const auto files = FindJointLogs(out, "");
  ASSERT_TRUE(files.ok()) << files.status();
  ASSERT_EQ(files->size(), 1u);
  const auto read = ReadJointLog(files->front());
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->suite, log.suite);
  EXPECT_EQ(read->initial_state, 41);
  ASSERT_EQ(read->samples.size(), log.samples.size());
  EXPECT_EQ(read->samples[3].tau, log.samples[3].tau);
  EXPECT_EQ(read->samples[3].contact_N, 7);
  EXPECT_EQ(read->actions[0], log.actions[0]);
  EXPECT_EQ(read->states[1].tool.p_base_tool, log.states[1].tool.p_base_tool);
  fs::remove_all(out);
  EXPECT_THAT(std::string(FindJointLogs(out, "").status().message()), HasSubstr("no such"));
  fs::create_directories(out);
  EXPECT_THAT(std::string(FindJointLogs(out, "").status().message()), HasSubstr("--record-joints"));
}

}  // namespace
}  // namespace robostress::calibration
