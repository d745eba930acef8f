// The kernel of calibration against the simulator of the Panda: from a recorded episode's torques
// alone, the other joints moving as recorded, a joint's free run stays where the simulator went;
// and an effect that is added to the model and fitted has the parameters that were simulated.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/measured_log.h"
#include "calibration/data/sim_recordings.h"
#include "calibration/search/joint_fit.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress::calibration {
namespace {

namespace fs = std::filesystem;

// The expert in task 1 of tabletop_goal, from initial state 40 + episode, under effects.
JointLog Record(const std::vector<ScenarioEffect>& effects, int episode) {
  UnitConfig unit;
  unit.suite = "tabletop_goal";
  auto task = EmbeddedTask::Create(unit, 1);
  EXPECT_TRUE(task.ok()) << task.status();
  Scenario scenario;
  scenario.name = "hidden";
  scenario.effects = effects;
  JointLog log;
  log.suite = unit.suite;
  log.episode = episode;
  PandaSim& sim = (*task)->sim();
  sim.SetScenario(scenario, (*task)->horizon());
  sim.OnJointSample([&](const JointSample& sample) { log.samples.push_back(sample); });
  EXPECT_TRUE((*task)->Reset(40 + episode).ok());
  for (int i = 0; i < 60 && !(*task)->Success(); ++i) {
    const Eigen::VectorXf action = (*task)->Decide().command;
    EXPECT_TRUE((*task)->Step(action).ok());
  }
  return log;
}

// Logs of a rig that declares nothing of the effects.
struct RecordedArmTest : public testing::Test {
  void Simulate(const std::vector<ScenarioEffect>& effects, double encoder_noise) {
    std::vector<RecordedEpisode> episodes;
    for (int i = 0; i < 3; ++i) {
      auto episode = EpisodeOfJointLog(Record(effects, i), 500);
      ASSERT_TRUE(episode.ok()) << episode.status();
      episodes.push_back(*std::move(episode));
    }
    RecordedRigOptions options;
    options.encoder_noise = encoder_noise;
    const auto summary = WriteRecordedRig(PandaOfRecordings("panda"), episodes, options, out);
    ASSERT_TRUE(summary.ok()) << summary.status();
    auto read = ReadRig(summary->rig_file);
    ASSERT_TRUE(read.ok()) << read.status();
    rig = *std::move(read);
    auto loaded = Plant::Load(rig);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    plant = *std::move(loaded);
    for (const RigLog& entry : rig.logs) {
      auto log = ReadMeasuredLog(rig, entry);
      ASSERT_TRUE(log.ok()) << log.status();
      logs.push_back(*std::move(log));
    }
  }
  ~RecordedArmTest() override { fs::remove_all(out); }
  std::vector<JointTrack> Tracks(int joint) const { return MakeTracks(*plant, logs, joint); }
  // Fits one effect at a joint; its values.
  std::vector<double> FitEffect(int joint, const std::string& type) const {
    JointProblem problem(rig.joints[joint].name, Tracks(joint), 125);
    const SignalScales scales = MeasureScales(rig.joints[joint], problem.tracks());
    const auto model = DeclaredModel(rig, *plant, joint);
    const auto declared = DeclaredHypothesis(rig.joints[joint], *model, scales, 5);
    problem.LinearizeStarts(*model);
    const JointFit found = Settle(
        problem, Try(problem, WithEffect(*declared, **FindEffect(type), scales), problem.All()),
        problem.All());
    const JointFit fit = Minimise(problem, found.best, problem.All());
    return ModelAt(fit.best, fit.best.x).effects.back().values;
  }

  std::string out =
      (fs::path(testing::TempDir()) / absl::StrCat("simulated_arm_", getpid())).string();
  Rig rig;
  std::unique_ptr<Plant> plant;
  std::vector<MeasuredLog> logs;
};

TEST_F(RecordedArmTest, FreeRunsOfAQuarterSecondStayWithTheSimulator) {
  Simulate({}, 0);
  for (int joint = 0; joint < 7; ++joint) {
    const JointProblem problem(rig.joints[joint].name, Tracks(joint), 125);
    const auto model = DeclaredModel(rig, *plant, joint);
    ASSERT_TRUE(model.ok()) << model.status();
    // Joints travel up to 0.4 rad; the effects of interest move them by 1e-3 and more.
    EXPECT_LT(problem.Rms(*model, problem.All()), 2e-4) << joint;
  }
}

TEST_F(RecordedArmTest, FitsFindWhatWasSimulated) {
  Simulate({{3, "stribeck_friction", {1.0, 1.5, 0.1, 0.3}},
            {1, "transport_delay", {0.012}},
            {5, "deadzone", {0.4}}},
           2e-5);
  const std::vector<double> friction = FitEffect(3, "stribeck_friction");
  EXPECT_NEAR(friction[0], 1.0, 0.1);
  EXPECT_NEAR(friction[1], 1.5, 0.2);
  EXPECT_NEAR(friction[3], 0.3, 0.1);
  EXPECT_NEAR(FitEffect(1, "transport_delay")[0], 0.012, 0.001);
  EXPECT_NEAR(FitEffect(5, "deadzone")[0], 0.4, 0.04);
}

}  // namespace
}  // namespace robostress::calibration
