#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <filesystem>
#include <fstream>

#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "nlohmann/json.hpp"
#include "server/policy.h"
#include "server/training/trainer.h"
#include "tests/training/toy_world.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

namespace fs = std::filesystem;

// Small enough for a second of training.
TrainOptions SmallOptions(const std::string& data, const std::string& out) {
  TrainOptions options;
  options.data = {data};
  options.out = out;
  options.steps = 12;
  options.batch = 8;
  options.draws = 2;
  options.warmup = 2;
  options.validation_share = 0.2;
  options.validation_frames = 8;
  options.log_every = 2;
  options.evaluate_every = 6;
  options.checkpoint_every = 6;
  NanoConfig& network = options.network;
  network.conv_channels = {4, 6, 8, 8};
  network.readout_tokens = 2;
  network.layers = 2;
  network.heads = 2;
  network.head_dim = 8;
  network.prefix_width = 16;
  network.prefix_mlp = 24;
  network.expert_width = 16;
  network.expert_mlp = 24;
  return options;
}

class Training : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    root_ = fs::path(testing::TempDir()) / "robostress_training_test";
    fs::remove_all(root_);
    ASSERT_TRUE(
        WriteToyDemonstrations(Path("toy"), /*episodes=*/20, /*stride=*/10, /*seed=*/1).ok());
  }
  static void TearDownTestSuite() { fs::remove_all(root_); }
  static std::string Path(const std::string& name) { return (root_ / name).string(); }

  static fs::path root_;
};

fs::path Training::root_;

std::vector<nlohmann::json> ReadLog(const std::string& out) {
  std::vector<nlohmann::json> lines;
  std::ifstream stream(out + "/train.jsonl");
  for (std::string line; std::getline(stream, line);) lines.push_back(nlohmann::json::parse(line));
  return lines;
}

TEST_F(Training, PublishesWeightsThatTheServerLoads) {
  const TrainOptions options = SmallOptions(Path("toy"), Path("publish"));
  const absl::Status status = RunTraining(options, false);
  ASSERT_TRUE(status.ok()) << status;
  EXPECT_TRUE(fs::exists(Path("publish") + "/DONE"));
  const auto policy = LoadFlowPolicy(Path("publish") + "/nano.safetensors");
  ASSERT_TRUE(policy.ok()) << policy.status();
  ToyWorld world{RandomStream(StreamKey("x"))};
  const PolicyContext context = (*policy)->Encode(world.Observe()).value();
  const torch::Tensor chunk = (*policy)->Sample(context, torch::zeros({1, 50, 8}), nullptr);
  EXPECT_TRUE(torch::isfinite(chunk).all().item<bool>());
  const auto log = ReadLog(Path("publish"));
  ASSERT_EQ(log.size(), 6u + 2u);  // six windows of losses, two evaluations
  EXPECT_GT(log[0].at("samples_per_s").get<double>(), 0);
  EXPECT_GT(log.back().at("target_error_mm").get<double>(), 0);
}

TEST_F(Training, LearnsToReproduceAFewFrames) {
  TrainOptions options = SmallOptions(Path("toy"), Path("learn"));
  options.steps = 120;
  options.batch = 16;
  options.lr = 3e-3;
  options.shift_px = 0;
  options.colour_jitter = options.state_noise = 0;
  const Demonstrations demonstrations =
      Demonstrations::Open(options.data, options.network, 0.2).value();
  NanoModel model = RandomNanoModel(options.network, 1);
  demonstrations.MeasureNormalisation(model);
  model.vocabulary = demonstrations.CollectWords({}).value();
  Trainer trainer(options, model, demonstrations);
  double first = 0, last = 0;
  for (int i = 0; i < 120; ++i) {
    const TrainLosses losses = trainer.Step().value();
    if (i < 5) first += losses.flow / 5;
    if (i >= 115) last += losses.flow / 5;
  }
  // Predicting zero gives 2, the variances of noise and action together.
  EXPECT_GT(first, 1.9);
  EXPECT_LT(last, 0.75 * first);
}

TEST_F(Training, ResumedRunEndsWithTheBitsOfAnUninterruptedOne) {
  TrainOptions options = SmallOptions(Path("toy"), Path("whole"));
  options.threads = 1;
  ASSERT_TRUE(RunTraining(options, false).ok());
  const Demonstrations demonstrations =
      Demonstrations::Open(options.data, options.network, 0.2).value();
  NanoModel model = RandomNanoModel(options.network, options.seed);
  demonstrations.MeasureNormalisation(model);
  model.vocabulary = demonstrations.CollectWords({}).value();
  fs::create_directories(Path("cut"));
  {
    Trainer trainer(options, model, demonstrations);  // stops after 6 of 12 steps, as if killed
    for (int i = 0; i < 6; ++i) ASSERT_TRUE(trainer.Step().ok());
    ASSERT_TRUE(trainer.SaveCheckpoint(Path("cut") + "/checkpoint.safetensors").ok());
    ASSERT_TRUE(SaveNanoModel(trainer.Published(), Path("cut") + "/nano.safetensors").ok());
  }
  options.out = Path("cut");
  ASSERT_TRUE(RunTraining(options, true).ok());
  EXPECT_EQ(ReadFile(Path("cut") + "/nano.safetensors").value(),
            ReadFile(Path("whole") + "/nano.safetensors").value());
}

TEST_F(Training, ThreadsShareTheWorkOfOneBatch) {
  TrainOptions options = SmallOptions(Path("toy"), Path("threads"));
  const Demonstrations demonstrations =
      Demonstrations::Open(options.data, options.network, 0.2).value();
  NanoModel model = RandomNanoModel(options.network, 1);
  demonstrations.MeasureNormalisation(model);
  model.vocabulary = demonstrations.CollectWords({}).value();
  options.threads = 2;
  Trainer a(options, model, demonstrations), b(options, model, demonstrations);
  for (int i = 0; i < 3; ++i) {
    const TrainLosses la = a.Step().value(), lb = b.Step().value();
    EXPECT_EQ(la.flow, lb.flow);  // whichever thread comes first
  }
  const NanoModel pa = a.Published(), pb = b.Published();
  for (size_t i = 0; i < pa.tensors.size(); ++i)
    EXPECT_TRUE(torch::equal(pa.tensors[i], pb.tensors[i]));
}

TEST_F(Training, GoesOnFromWeightsWithNewWordsAndTheOldNormalisation) {
  TrainOptions options = SmallOptions(Path("toy"), Path("base"));
  ASSERT_TRUE(RunTraining(options, false).ok());
  ASSERT_TRUE(WriteToyDemonstrations(Path("more"), 6, 10, 77).ok());
  TrainOptions more = SmallOptions(Path("more"), Path("continued"));
  more.init = Path("base") + "/nano.safetensors";
  const absl::Status status = RunTraining(more, false);
  ASSERT_TRUE(status.ok()) << status;
  const NanoModel before = LoadNanoModel(more.init).value();
  const NanoModel after = LoadNanoModel(Path("continued") + "/nano.safetensors").value();
  EXPECT_EQ(before.actions.mean, after.actions.mean);
  ASSERT_GE(after.vocabulary.words().size(), before.vocabulary.words().size());
  for (size_t i = 0; i < before.vocabulary.words().size(); ++i) {
    EXPECT_EQ(before.vocabulary.words()[i], after.vocabulary.words()[i]);
  }
}

TEST_F(Training, HoldsOutWholeEpisodes) {
  const TrainOptions options = SmallOptions(Path("toy"), "");
  const Demonstrations demonstrations =
      Demonstrations::Open(options.data, options.network, 0.3).value();
  EXPECT_EQ(demonstrations.episodes(), 20);
  EXPECT_FALSE(demonstrations.validation().empty());
  for (const int64_t frame : demonstrations.validation()) {
    EXPECT_THAT(demonstrations.training(), testing::Not(testing::Contains(frame)));
  }
}

TEST_F(Training, AugmentationShiftsImagesAndLeavesLabelsAlone) {
  const TrainOptions options = SmallOptions(Path("toy"), "");
  const Demonstrations demonstrations =
      Demonstrations::Open(options.data, options.network, 0.2).value();
  NanoModel model = RandomNanoModel(options.network, 1);
  model.vocabulary = demonstrations.CollectWords({}).value();
  RandomStream random(StreamKey("augment"));
  const std::vector<int64_t> frames(8, demonstrations.training()[0]);
  const DemoBatch plain = demonstrations.Fill(frames, model, {}, random).value();
  const DemoBatch moved = demonstrations.Fill(frames, model, {.shift_px = 2}, random).value();
  EXPECT_TRUE(torch::equal(plain.actions, moved.actions));
  EXPECT_TRUE(torch::equal(plain.state, moved.state));
  const torch::Tensor middle = plain.images[0][0].narrow(1, 4, 56).narrow(2, 4, 56);
  int found = 0;  // every row is the original shifted by -2 .. 2 pixels
  for (int row = 0; row < 8; ++row) {
    for (int dy = -2; dy <= 2; ++dy) {
      for (int dx = -2; dx <= 2; ++dx) {
        found +=
            torch::equal(moved.images[0][row].narrow(1, 4 - dy, 56).narrow(2, 4 - dx, 56), middle);
      }
    }
  }
  EXPECT_GE(found, 8);
  EXPECT_LE(plain.images[0].max().item<float>(), 1.0f);
  EXPECT_GE(plain.images[0].min().item<float>(), -1.0f);
}

TEST_F(Training, RefusesWhatIsNotAShardOrDoesNotFit) {
  const auto message = [&](const std::string& name, auto change) {
    const std::string directory = Path("bad_" + name);
    fs::create_directories(directory);
    SafetensorsWriter writer;
    writer.SetMetadata("instruction", "pick up the block");
    std::vector<float> actions(50 * 7), state(8), aux(8);
    change(writer, actions);
    const std::vector<uint8_t> images(2 * 64 * 64 * 3);
    writer.Add("images", DType::kU8, {1, 2, 64, 64, 3}, images.data(), images.size());
    writer.AddFloats("state", {1, 8}, state);
    writer.AddFloats("actions", {1, static_cast<int64_t>(actions.size()) / 7, 7}, actions);
    writer.AddFloats("aux", {1, 8}, aux);
    writer.AddInts("episode", {1}, std::vector<int64_t>{0});
    EXPECT_TRUE(writer.Write(directory + "/shard.safetensors").ok());
    return std::string(RunTraining(SmallOptions(directory, Path("bad_out")), false).message());
  };
  EXPECT_THAT(message("horizon", [](auto&, auto& actions) { actions.resize(10 * 7); }),
              AllOf(HasSubstr("actions is F32 [1,10,7]"), HasSubstr("must be F32 [1,50,7]"),
                    HasSubstr("shard.safetensors")));
  EXPECT_THAT(message("nan", [](auto&, auto& actions) { actions[9] = std::nanf(""); }),
              HasSubstr("actions holds nan at 9"));
  EXPECT_THAT(message("words", [](auto& writer, auto&) { writer.SetMetadata("instruction", ""); }),
              HasSubstr("'instruction' is missing"));
  EXPECT_THAT(
      std::string(RunTraining(SmallOptions(Path("nowhere"), Path("bad_out")), false).message()),
      HasSubstr("nowhere"));
  TrainOptions odd = SmallOptions(Path("toy"), Path("bad_out"));
  odd.batch = 9;
  EXPECT_THAT(std::string(RunTraining(odd, false).message()),
              AllOf(HasSubstr("batch is 9"), HasSubstr("threads, 2")));
  EXPECT_FALSE(fs::exists(Path("bad_out") + "/DONE"));
}

TEST_F(Training, DoesNotOverwriteARun) {
  const TrainOptions options = SmallOptions(Path("toy"), Path("once"));
  ASSERT_TRUE(RunTraining(options, false).ok());
  EXPECT_THAT(std::string(RunTraining(options, false).message()), HasSubstr("--resume"));
}

TEST(ToyWorld, ExpertSucceeds) {
  int successes = 0;
  for (int i = 0; i < 20; ++i) {
    ToyWorld world{RandomStream(StreamKey("toy-test").With(i))};
    for (int step = 0; step < 150 && !world.success(); ++step)
      world.Step(world.ExpertChunk().row(0).transpose());
    successes += world.success();
  }
  EXPECT_EQ(successes, 20);
}

}  // namespace
}  // namespace robostress
