#include <cstdlib>
#include <string>

#include "common/safetensors.h"
#include "common/so3.h"
#include "gtest/gtest.h"
#include "sim_worker/record/expert_demonstration.h"
#include "sim_worker/record/libero_recorder.h"
#include "sim_worker/record/shard.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {
namespace {

std::unique_ptr<EmbeddedTask> MakeTask(const std::string& suite, int task) {
  UnitConfig unit;
  unit.suite = suite;
  absl::StatusOr<std::unique_ptr<EmbeddedTask>> made = EmbeddedTask::Create(unit, task);
  EXPECT_TRUE(made.ok()) << made.status();
  return std::move(made).value();
}

absl::StatusOr<Demonstration> Record(EmbeddedTask& task, int initial_state,
                                     const RecordOptions& options, const StreamKey& key) {
  if (const absl::Status reset = task.Reset(initial_state); !reset.ok()) return reset;
  return RecordExpert(task, task.MakeExpert().value(), options, key);
}

StreamKey TestKey(int index) { return StreamKey("record test").With(index); }

TEST(Record, LabelsAreTheExpertsPathAndRestAfterSuccess) {
  const auto task = MakeTask("tabletop_goal", 4);
  RecordOptions options;
  options.noisy_share = 0;
  const absl::StatusOr<Demonstration> episode = Record(*task, 1000, options, TestKey(0));
  if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
  ASSERT_TRUE(episode.ok()) << episode.status();
  ASSERT_TRUE(episode->success);
  ASSERT_EQ(static_cast<int>(episode->frames.size()), (episode->steps + 1) / 2);
  const DemonstrationFrame& first = episode->frames[0];
  EXPECT_EQ(first.actions.row(2), episode->frames[1].actions.row(0))
      << "frames are two control steps apart";
  const DemonstrationFrame& last = episode->frames.back();
  EXPECT_EQ(last.actions.bottomRows(40).leftCols(6).norm(), 0);
  EXPECT_EQ(last.actions(49, 6), last.actions(0, 6));
}

TEST(Record, NoiseDisturbsWhatIsExecutedNotTheLabels) {
  const auto task = MakeTask("tabletop_goal", 4);
  RecordOptions calm, noisy;
  calm.render = noisy.render = false;
  calm.noisy_share = 0;
  noisy.noisy_share = 1;
  noisy.burst_chance = 1;
  const absl::StatusOr<Demonstration> a = Record(*task, 1001, calm, TestKey(1));
  const absl::StatusOr<Demonstration> b = Record(*task, 1001, noisy, TestKey(1));
  const absl::StatusOr<Demonstration> c = Record(*task, 1001, noisy, TestKey(1));
  ASSERT_TRUE(a.ok() && b.ok() && c.ok());
  EXPECT_NE(a->steps, b->steps);
  EXPECT_EQ(b->steps, c->steps) << "the noise is a function of the stream";
}

TEST(Record, ExecutionNoiseMovesTheArmAndNeitherTheLabelNorTheBursts) {
  const auto task = MakeTask("tabletop_goal", 4);
  RecordOptions clean, randomised;
  clean.render = randomised.render = true;
  clean.stride = randomised.stride = 1;
  randomised.execution_noise = 0.05;
  const absl::StatusOr<Demonstration> a = Record(*task, 1001, clean, TestKey(1));
  if (absl::IsUnavailable(a.status())) GTEST_SKIP() << a.status().message();
  const absl::StatusOr<Demonstration> b = Record(*task, 1001, randomised, TestKey(1));
  const absl::StatusOr<Demonstration> c = Record(*task, 1001, randomised, TestKey(1));
  const absl::StatusOr<Demonstration> other = Record(*task, 1001, randomised, TestKey(2));
  ASSERT_TRUE(a.ok() && b.ok() && c.ok() && other.ok());
  EXPECT_EQ(a->execution_sigma, 0);
  EXPECT_GT(b->execution_sigma, 0);
  EXPECT_LE(b->execution_sigma, 0.05);
  EXPECT_NE(b->execution_sigma, other->execution_sigma);
  // The first label was decided before anything was executed.
  EXPECT_EQ(a->frames[0].actions.row(0), b->frames[0].actions.row(0));
  EXPECT_EQ(a->frames[0].proprioception, b->frames[0].proprioception);
  // Where the arm gets to differs by millimetres: sigma * 0.05 m a step at most.
  const Eigen::Vector3f apart =
      a->frames[4].proprioception.head<3>() - b->frames[4].proprioception.head<3>();
  EXPECT_GT(apart.norm(), 0);
  EXPECT_LT(apart.norm(), 0.02);
  EXPECT_EQ(b->frames[4].proprioception, c->frames[4].proprioception);
}

TEST(Record, BranchLabelIsTheExpertsFutureAndLeavesNoTrace) {
  const auto task = MakeTask("tabletop_spatial", 0), untouched = MakeTask("tabletop_spatial", 0);
  ASSERT_TRUE(task->Reset(1002).ok());
  ASSERT_TRUE(untouched->Reset(1002).ok());
  for (int i = 0; i < 12; ++i) {
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
    ASSERT_TRUE(untouched->Step(untouched->Decide().command).ok());
  }
  const absl::StatusOr<Eigen::MatrixXf> label = BranchLabel(*task, task->MakeExpert().value());
  ASSERT_TRUE(label.ok());
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(label->row(i).transpose(), task->Decide().command) << "row " << i;
    ASSERT_TRUE(task->Step(task->Decide().command).ok());
    ASSERT_TRUE(untouched->Step(untouched->Decide().command).ok());
  }
  EXPECT_EQ(task->Proprioception(), untouched->Proprioception());
}

// Pushes the hand aside for ever, and counts the chunks that it was asked for.
class PushesAside : public PolicyEndpoint {
 public:
  PushesAside() {
    spec_.cameras = {"agentview", "robot0_eye_in_hand"};
    spec_.image_width = spec_.image_height = 16;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int chunk) override {
    EXPECT_EQ(chunk, chunks++);
    PredictedChunk predicted;
    predicted.actions = Eigen::MatrixXf::Zero(50, 7);
    predicted.actions.col(1).setConstant(0.6f);
    predicted.actions.col(6).setConstant(-1);
    return predicted;
  }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }
  int chunks = 0;

 private:
  PolicySpec spec_;
};

absl::StatusOr<Demonstration> RecordPushed(double mix, int stream, int& chunks) {
  const auto task = MakeTask("tabletop_goal", 4);
  if (const absl::Status reset = task->Reset(1003); !reset.ok()) return reset;
  PushesAside policy;
  absl::StatusOr<Demonstration> episode =
      RecordDagger(*task, task->MakeExpert().value(), {4, 1003}, {mix, /*stride=*/2}, policy,
                   RandomStream(TestKey(stream)));
  chunks = policy.chunks;
  return episode;
}

TEST(Record, InDaggerTheExpertsTurnsStartWhereThePolicyGotTo) {
  int chunks = 0, expert_first = 0, policy_first = 0;
  for (int stream = 0; stream < 8; ++stream) {
    const absl::StatusOr<Demonstration> episode = RecordPushed(0.8, stream, chunks);
    if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
    ASSERT_TRUE(episode.ok()) << episode.status();
    ASSERT_FALSE(episode->frames.empty());
    // Five steps a chunk are the policy's, every second one of the expert's has a frame.
    EXPECT_NEAR(5 * chunks + 2 * static_cast<int>(episode->frames.size()), episode->steps, 5);
    EXPECT_GT(chunks, 0);
    (episode->frames.front().step == 0 ? expert_first : policy_first) += 1;
    for (size_t i = 1; i < episode->frames.size(); ++i) {
      const DemonstrationFrame &before = episode->frames[i - 1], &frame = episode->frames[i];
      if (frame.step - before.step == 2) {
        EXPECT_EQ(before.actions.row(2), frame.actions.row(0)) << "stream " << stream;
      } else {
        EXPECT_EQ((frame.step - before.step - 2) % 5, 0) << "whole chunks lie between";
        EXPECT_GT(frame.proprioception[1], before.proprioception[1]) << "the policy pushed";
      }
    }
  }
  EXPECT_GT(expert_first, 0);
  EXPECT_GT(policy_first, 0);
}

// The last frame of a turn is labelled with what the expert would have gone on to do.
TEST(Record, InDaggerALabelReachesBeyondTheTurn) {
  const auto task = MakeTask("tabletop_goal", 4);
  ASSERT_TRUE(task->Reset(1003).ok());
  std::vector<Eigen::VectorXf> path;
  while (static_cast<int>(path.size()) < 90 && !task->Success()) {
    path.push_back(task->Decide().command);
    ASSERT_TRUE(task->Step(path.back()).ok());
  }
  ASSERT_GT(static_cast<int>(path.size()), kExpertTurn + 4);
  int chunks = 0;
  for (int stream = 0; stream < 8; ++stream) {
    const absl::StatusOr<Demonstration> episode = RecordPushed(0.8, stream, chunks);
    if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
    ASSERT_TRUE(episode.ok()) << episode.status();
    if (episode->frames.front().step != 0) continue;
    const DemonstrationFrame& last = episode->frames[kExpertTurn / 2 - 1];
    ASSERT_EQ(last.step, kExpertTurn - 2);
    for (int row = 0; last.step + row < static_cast<int>(path.size()); ++row) {
      EXPECT_EQ(last.actions.row(row).transpose(), path[last.step + row]) << "row " << row;
    }
    return;
  }
  FAIL() << "the expert never drove first";
}

// At an even share the policy's turns are as long as the expert's, in the mean.
TEST(Record, InDaggerTheExpertHasItsShare) {
  double steps = 0, turns = 0;
  for (int stream = 0; stream < 16; ++stream) {
    int chunks = 0;
    const absl::StatusOr<Demonstration> episode = RecordPushed(0.5, stream, chunks);
    if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
    ASSERT_TRUE(episode.ok()) << episode.status();
    steps += 5 * chunks;
    int expert_until = 0;
    for (const DemonstrationFrame& frame : episode->frames) {
      turns += frame.step > expert_until;
      expert_until = frame.step + 2;
    }
  }
  EXPECT_NEAR(steps / turns, kExpertTurn, 12) << turns << " turns";
}

TEST(Record, LiberosFormHoldsTheEpisode) {
  const auto task = MakeTask("tabletop_goal", 4);
  RecordOptions options;
  options.stride = 1;
  options.image_size = 32;
  options.simulator_state = true;
  const absl::StatusOr<Demonstration> episode = Record(*task, 1000, options, TestKey(3));
  if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
  ASSERT_TRUE(episode.ok()) << episode.status();
  const std::string path = ::testing::TempDir() + "/record_test.hdf5";
  auto writer =
      LiberoDemonstrationWriter::Create(path, {"tabletop_goal", task->name(), task->instruction()});
  ASSERT_TRUE(writer.ok()) << writer.status();
  ASSERT_TRUE(writer->Add(ToLibero(*episode, task->mjcf(), /*libero_suite=*/false)).ok());
  ASSERT_TRUE(writer->Publish().ok());
  const auto file = LiberoDemonstrationFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->instruction(), task->instruction());
  ASSERT_EQ(file->steps(0), episode->steps);
  const LiberoColumns columns = file->ReadColumns(0).value();
  for (int t = 0; t < episode->steps; ++t) {
    const DemonstrationFrame& frame = episode->frames[t];
    EXPECT_EQ(static_cast<float>(columns.actions[7 * t + 2]), frame.actions(0, 2));
    // The base stands at the world's origin, and the home hand points straight down.
    const Eigen::Vector3d axis_angle(columns.ee_ori[3 * t], columns.ee_ori[3 * t + 1],
                                     columns.ee_ori[3 * t + 2]);
    const Eigen::Vector3d rotation =
        RotationBetween(Eigen::Quaterniond(0, 1, 0, 0), ExpSo3(axis_angle));
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(columns.ee_pos[3 * t + i], frame.proprioception[i], 1e-6);
      EXPECT_NEAR(rotation[i], frame.proprioception[3 + i], 1e-5) << "step " << t;
    }
    EXPECT_NEAR(columns.gripper_states[2 * t], frame.proprioception[6], 1e-6);
    EXPECT_EQ(static_cast<float>(columns.proprioception[8 * t + 4]), frame.proprioception[4]);
  }
  EXPECT_EQ(file->ReadView(0, LiberoDemonstrationFile::View::kAgent, 5)->data,
            episode->frames[5].views[0].data);
  std::remove(path.c_str());
}

TEST(Shard, NamesTheExecutionNoiseOnlyWhereThereIsSome) {
  Demonstration episode;
  DemonstrationFrame frame;
  frame.views.assign(2, Image{4, 4, std::vector<uint8_t>(48)});
  frame.proprioception = Eigen::VectorXf::Zero(8);
  frame.aux.setZero();
  frame.actions = Eigen::MatrixXf::Zero(kLabelSteps, 7);
  episode.frames.push_back(frame);
  episode.execution_sigma = 0.03;
  const std::string path = ::testing::TempDir() + "/noise_shard_test.safetensors";
  for (const double noise : {0.0, 0.05}) {
    Shard shard("tabletop_goal", 4, "turn on the stove", "{}", noise);
    shard.Add(1000, episode);
    ASSERT_TRUE(shard.Write(path).ok());
    const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_EQ(file->metadata().count("execution_noise"), noise > 0 ? 1u : 0u);
    EXPECT_EQ(file->Get("execution_sigma").ok(), noise > 0);
    if (noise > 0) {
      EXPECT_EQ(file->metadata().at("execution_noise"), "0.05");
      EXPECT_FLOAT_EQ((*file->ReadFloats("execution_sigma", {1}))[0], 0.03f);
    }
  }
  std::remove(path.c_str());
}

TEST(Shard, ReadsBackWithTheShapesThatTrainingExpects) {
  Demonstration episode;
  for (int i = 0; i < 3; ++i) {
    DemonstrationFrame frame;
    frame.views.assign(2, Image{4, 4, std::vector<uint8_t>(48, static_cast<uint8_t>(i))});
    frame.proprioception = Eigen::VectorXf::Constant(8, 0.5f);
    frame.aux.setConstant(static_cast<float>(i));
    frame.actions = Eigen::MatrixXf::Zero(kLabelSteps, 7);
    frame.actions(1, 6) = 7;
    episode.frames.push_back(frame);
  }
  Shard shard("tabletop_goal", 4, "turn on the stove", "{}", /*execution_noise=*/0);
  shard.Add(1000, episode);
  shard.Add(1001, episode);
  const std::string path = ::testing::TempDir() + "/shard_test.safetensors";
  ASSERT_TRUE(shard.Write(path).ok());
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->metadata().at("instruction"), "turn on the stove");
  EXPECT_EQ(file->metadata().at("task"), "4");
  EXPECT_EQ(file->Get("images")->shape, (std::vector<int64_t>{6, 2, 4, 4, 3}));
  EXPECT_EQ(file->Get("images")->bytes[48 * 2], 1);
  EXPECT_EQ(file->Get("actions")->shape, (std::vector<int64_t>{6, 50, 7}));
  EXPECT_EQ((*file->ReadFloats("actions"))[13], 7);
  EXPECT_EQ((*file->ReadFloats("aux"))[8], 1);
  EXPECT_EQ((*file->ReadDoubles("episode"))[3], 1001);
  std::remove(path.c_str());
}

}  // namespace
}  // namespace robostress
