#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include <filesystem>
#include <fstream>
#include <map>

#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "common/libero/demonstrations.h"
#include "common/safetensors.h"
#include "nlohmann/json.hpp"
#include "server/policies/policy.h"
#include "server/training/flow_objective.h"
#include "server/training/libero_shards.h"
#include "server/training/trainer.h"
#include "server/training/worst_case_actions.h"
#include "tests/server/training/toy_world.h"

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

// A model on the toy's frames, and one batch of them.
struct Scene {
  Demonstrations demonstrations;
  NanoModel model;
  DemoBatch batch;
};

Scene MakeScene(const TrainOptions& options, int rows) {
  Scene scene{Demonstrations::Open(options.data, options.network, 0.2).value(),
              RandomNanoModel(options.network, 1),
              {}};
  scene.demonstrations.MeasureNormalisation(scene.model);
  scene.model.vocabulary = scene.demonstrations.CollectWords({}).value();
  RandomStream random(StreamKey("scene"));
  const std::vector<int64_t>& all = scene.demonstrations.training();
  scene.batch =
      scene.demonstrations.Fill(absl::MakeSpan(all).subspan(0, rows), scene.model, {}, random)
          .value();
  return scene;
}

TEST_F(Training, SeesAbsoluteTargetsAsDisplacementsFromTheStateOfTheirFrame) {
  NanoConfig config = SmallOptions(Path("toy"), "").network;
  const Demonstrations absolute = Demonstrations::Open({Path("toy")}, config, 0).value();
  config.displacement_channels = 6;
  const Demonstrations counted = Demonstrations::Open({Path("toy")}, config, 0).value();
  NanoModel model = RandomNanoModel(config, 1);  // identity normalisation
  model.vocabulary = absolute.CollectWords({}).value();
  const std::vector<int64_t> frames = {0, 3, 7};
  RandomStream random(StreamKey("unused"));
  const DemoBatch a = absolute.Fill(frames, model, {}, random).value();
  const DemoBatch b = counted.Fill(frames, model, {}, random).value();
  EXPECT_TRUE(torch::equal(a.state, b.state));
  const torch::Tensor origin = a.state.narrow(1, 0, 6).unsqueeze(1);
  EXPECT_LT(
      (a.actions.narrow(2, 0, 6) - origin - b.actions.narrow(2, 0, 6)).abs().max().item<float>(),
      1e-5f);
  EXPECT_TRUE(torch::equal(a.actions.narrow(2, 6, 2), b.actions.narrow(2, 6, 2)));

  // Normalisation is that of the displacements; a graft of another meaning leaves it alone.
  TrainOptions first = SmallOptions(Path("toy"), Path("absolute"));
  first.steps = 1;
  ASSERT_TRUE(RunTraining(first, false).ok());
  TrainOptions options = SmallOptions(Path("toy"), Path("displacements"));
  options.steps = 1;
  options.graft = Path("absolute") + "/nano.safetensors";
  options.network.displacement_channels = 6;
  const absl::Status status = RunTraining(options, false);
  ASSERT_TRUE(status.ok()) << status;
  const NanoModel donor = LoadNanoModel(options.graft).value();
  const NanoModel grafted = LoadNanoModel(Path("displacements") + "/nano.safetensors").value();
  EXPECT_EQ(grafted.config.displacement_channels, 6);
  EXPECT_NE(grafted.actions.mean, donor.actions.mean);
  EXPECT_EQ(grafted.vocabulary.words(), donor.vocabulary.words());
}

TEST_F(Training, GraftsThePrefixOfOneArchitectureOnTheOther) {
  const TrainOptions first = SmallOptions(Path("toy"), Path("graft_from"));
  ASSERT_TRUE(RunTraining(first, false).ok());
  TrainOptions options = SmallOptions(Path("toy"), Path("graft_to"));
  options.graft = Path("graft_from") + "/nano.safetensors";
  options.network.architecture = NanoArchitecture::kPi05;
  options.lr = options.final_lr = 0;  // what is published is where it began
  absl::Status status = RunTraining(options, false);
  ASSERT_TRUE(status.ok()) << status;
  const NanoModel donor = LoadNanoModel(options.graft).value();
  const NanoModel grafted = LoadNanoModel(Path("graft_to") + "/nano.safetensors").value();
  EXPECT_TRUE(grafted.config.pi05());
  EXPECT_EQ(grafted.state.mean, donor.state.mean);
  const NanoParameters a = AssembleNano(donor.config, donor.tensors),
                       b = AssembleNano(grafted.config, grafted.tensors);
  EXPECT_TRUE(torch::equal(a.words, b.words));
  EXPECT_TRUE(torch::equal(a.cameras[1].conv_weight[2], b.cameras[1].conv_weight[2]));
  EXPECT_TRUE(torch::equal(a.prefix[0].qkv_proj, b.prefix[0].qkv_proj));
  EXPECT_TRUE(b.expert[0].input_norm.dense.defined());

  options.out = Path("graft_learns");
  options.lr = 3e-3;
  ASSERT_TRUE(RunTraining(options, false).ok());
  const auto policy = LoadFlowPolicy(Path("graft_learns") + "/nano.safetensors");
  ASSERT_TRUE(policy.ok()) << policy.status();
  const auto log = ReadLog(Path("graft_learns"));
  EXPECT_LT(log[log.size() - 2].at("flow").get<double>(), log[0].at("flow").get<double>());

  options.out = Path("graft_both");
  options.init = options.graft;
  status = RunTraining(options, false);
  EXPECT_THAT(std::string(status.message()), HasSubstr("init and graft are both given"));
}

TEST_F(Training, FlowTimesFollowOpenpisBeta) {
  const FlowDraw draw = DrawFlow(20000, 2, SmallOptions("", "").network, 5);
  const torch::Tensor t = draw.t.to(torch::kFloat64);
  // t = 0.999 Beta(1.5, 1) + 0.001: mean 0.6, second moment 3/7 of the Beta.
  EXPECT_NEAR(t.mean().item<double>(), 0.999 * 0.6 + 0.001, 2e-3);
  EXPECT_NEAR(((t - 0.001) / 0.999).square().mean().item<double>(), 1.5 / 3.5, 2e-3);
  EXPECT_GE(t.min().item<double>(), 0.001);
  EXPECT_LE(t.max().item<double>(), 1.0);
  // The distribution function of Beta(1.5, 1) is x^1.5.
  EXPECT_NEAR((t < 0.5).to(torch::kFloat64).mean().item<double>(),
              std::pow((0.5 - 0.001) / 0.999, 1.5), 5e-3);
}

// t = 1 is the noise, t = 0 the demonstrated chunk (openpi's direction of time).
TEST_F(Training, FlowBeginsInTheNoiseAndEndsInTheDemonstratedChunk) {
  const Scene scene = MakeScene(SmallOptions(Path("toy"), ""), 2);
  const NanoNetwork network(scene.model.config,
                            AssembleNano(scene.model.config, scene.model.tensors));
  const NanoNetwork::Prefix prefix =
      network.EncodePrefix(scene.batch.images, scene.batch.words, scene.batch.state, false);
  const torch::Tensor weights = torch::ones({50, 1});
  const torch::Tensor& a = scene.batch.actions;
  for (const double t : {0.0, 0.25, 1.0}) {
    FlowDraw draw = DrawFlow(a.size(0), 1, scene.model.config, 3);
    draw.t.fill_(t);
    const torch::Tensor v =
        network.Velocity(prefix.context, a + t * (draw.noise - a), draw.t, nullptr);
    EXPECT_NEAR(FlowLoss(network, prefix.context, a, draw, weights).item<double>(),
                (v - (draw.noise - a)).square().mean().item<double>(), 1e-5)
        << t;
  }
}

TEST_F(Training, WorstCaseStaysInTheBallAndRaisesTheLoss) {
  const TrainOptions options = SmallOptions(Path("toy"), "");
  const Scene scene = MakeScene(options, 6);
  const NanoNetwork network(scene.model.config,
                            AssembleNano(scene.model.config, scene.model.tensors));
  const NanoNetwork::Prefix prefix =
      network.EncodePrefix(scene.batch.images, scene.batch.words, scene.batch.state, false);
  const FlowDraw draw = DrawFlow(6, 2, scene.model.config, 3);
  const torch::Tensor weights = torch::ones({50, 1});
  const double clean =
      FlowLoss(network, prefix.context, scene.batch.actions, draw, weights).item<double>();
  for (const PgdOptions pgd : {PgdOptions{}, PgdOptions{0.03, 1, 0.5}, PgdOptions{0.2, 5, 0.1}}) {
    const WorstCase worst =
        FindWorstCaseActions(network, prefix.context, scene.batch.actions, draw, weights, pgd);
    const torch::Tensor delta = worst.actions - scene.batch.actions;
    EXPECT_LE(delta.abs().max().item<double>(), pgd.epsilon + 1e-6);
    EXPECT_GT(delta.abs().max().item<double>(), 0.9 * pgd.epsilon);
    EXPECT_EQ(delta.narrow(2, 7, 1).abs().max().item<double>(), 0) << "the padding channel";
    EXPECT_EQ(worst.clean_loss, clean);
    EXPECT_GT(FlowLoss(network, prefix.context, worst.actions, draw, weights).item<double>(),
              clean);
    EXPECT_FALSE(worst.actions.requires_grad());
  }
  const WorstCase none = FindWorstCaseActions(network, prefix.context, scene.batch.actions, draw,
                                              weights, {.steps = 0});
  EXPECT_TRUE(torch::equal(none.actions, scene.batch.actions));
}

TEST_F(Training, GradientInTheActionsIsThatOfFiniteDifferences) {
  const Scene scene = MakeScene(SmallOptions(Path("toy"), ""), 2);
  const NanoNetwork network(scene.model.config,
                            AssembleNano(scene.model.config, scene.model.tensors));
  const NanoNetwork::Prefix prefix =
      network.EncodePrefix(scene.batch.images, scene.batch.words, scene.batch.state, false);
  const FlowDraw draw = DrawFlow(2, 2, scene.model.config, 3);
  const torch::Tensor weights = torch::ones({50, 1});
  const auto loss = [&](const torch::Tensor& actions) {
    return FlowLoss(network, prefix.context, actions, draw, weights);
  };
  const torch::Tensor actions = scene.batch.actions.clone().set_requires_grad(true);
  const torch::Tensor gradient = torch::autograd::grad({loss(actions)}, {actions})[0];
  // Along random directions: one number of size 1 each, where single entries would drown in
  // float32's rounding. The step's error is of second order, the rounding's 1e-7 / h.
  for (int i = 0; i < 4; ++i) {
    torch::manual_seed(i);
    const torch::Tensor direction = torch::randn_like(scene.batch.actions);
    const double h = 3e-3;
    const double difference = (loss(scene.batch.actions + h * direction).item<double>() -
                               loss(scene.batch.actions - h * direction).item<double>()) /
                              (2 * h);
    const double exact = (gradient * direction).sum().item<double>();
    EXPECT_NEAR(difference, exact, 2e-3 * std::max(1.0, std::abs(exact)));
  }
}

TEST_F(Training, RobustWithoutStepsIsBehaviourCloningToTheBit) {
  TrainOptions cloning = SmallOptions(Path("toy"), Path("bc"));
  TrainOptions robust = SmallOptions(Path("toy"), Path("robust0"));
  robust.objective = Objective::kRobust;
  robust.robust.steps = 0;
  ASSERT_TRUE(RunTraining(cloning, false).ok());
  ASSERT_TRUE(RunTraining(robust, false).ok());
  EXPECT_EQ(ReadFile(Path("bc") + "/nano.safetensors").value(),
            ReadFile(Path("robust0") + "/nano.safetensors").value());
}

TEST_F(Training, RobustTrainsOnAHarderLossAndResumesToTheSameBits) {
  TrainOptions options = SmallOptions(Path("toy"), Path("robust"));
  options.objective = Objective::kRobust;
  options.threads = 1;
  ASSERT_TRUE(RunTraining(options, false).ok());
  for (const nlohmann::json& line : ReadLog(Path("robust"))) {
    if (!line.contains("flow")) continue;
    EXPECT_GT(line.at("flow").get<double>(), line.at("clean_flow").get<double>());
    EXPECT_GE(line.at("data_share").get<double>(), 0);
    EXPECT_LT(line.at("data_share").get<double>(), 1);
  }
  EXPECT_THAT(ReadFile(Path("robust") + "/config.yaml").value(),
              AllOf(HasSubstr("objective: robust"), HasSubstr("epsilon: 0.03"),
                    HasSubstr("steps: 3"), HasSubstr("step_size: 0.015")));
  // As if killed after half of the steps: an evaluation command that fails there ends the run.
  TrainOptions cut = options;
  cut.out = Path("robust_cut");
  cut.evaluate_command =
      "test {step} != 6 && mkdir -p {out}/units/u && "
      "echo '{\"success\": true}' > {out}/units/u/episodes.jsonl";
  const absl::Status killed = RunTraining(cut, false);
  EXPECT_THAT(std::string(killed.message()),
              AllOf(HasSubstr("step 6"), HasSubstr("exit code 1"), HasSubstr("--resume")));
  cut.evaluate_command = options.evaluate_command;
  ASSERT_TRUE(RunTraining(cut, true).ok());
  EXPECT_EQ(ReadFile(Path("robust") + "/nano.safetensors").value(),
            ReadFile(Path("robust_cut") + "/nano.safetensors").value());
}

TEST_F(Training, LogsTheSuccessThatACommandMeasures) {
  TrainOptions options = SmallOptions(Path("toy"), Path("measured"));
  options.evaluate_command =
      "test -s {weights} && mkdir -p {out}/units/u && printf '{\"success\": true}\\n{\"success\": "
      "false}\\n' > {out}/units/u/episodes.jsonl";
  ASSERT_TRUE(RunTraining(options, false).ok());
  std::vector<int> steps;
  for (const nlohmann::json& line : ReadLog(Path("measured"))) {
    if (!line.contains("successes")) continue;
    steps.push_back(line.at("step"));
    EXPECT_EQ(line.at("successes"), 1);
    EXPECT_EQ(line.at("episodes"), 2);
  }
  EXPECT_THAT(steps, testing::ElementsAre(6, 12));
  options.out = Path("unmeasured");
  options.evaluate_command = "true";
  EXPECT_THAT(std::string(RunTraining(options, false).message()),
              HasSubstr("left no episodes.jsonl"));
  options.out = Path("nonsense");
  options.evaluate_command = "mkdir -p {out} && echo '{\"won\": 1}' > {out}/episodes.jsonl";
  EXPECT_THAT(std::string(RunTraining(options, false).message()),
              AllOf(HasSubstr("episodes.jsonl:1"), HasSubstr("'success'")));
}

TEST_F(Training, RefusesPgdOutOfRange) {
  TrainOptions options = SmallOptions(Path("toy"), Path("bad_pgd"));
  options.robust.epsilon = -1;
  EXPECT_THAT(std::string(RunTraining(options, false).message()),
              AllOf(HasSubstr("robust.epsilon is -1"), HasSubstr("0 to 10")));
  options.robust = {.step_size = 0};
  EXPECT_THAT(std::string(RunTraining(options, false).message()), HasSubstr("robust.step_size"));
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

// A file of two demonstrations of 60 and 61 steps whose left image half is dark.
void WriteLibero(const std::string& path, bool ours, bool absolute = false) {
  auto writer =
      LiberoDemonstrationWriter::Create(path, {"toy", "push", "push the block", 20, absolute});
  ASSERT_TRUE(writer.ok()) << writer.status();
  for (const int64_t steps : {60, 61}) {
    LiberoDemonstration demonstration;
    LiberoColumns& columns = demonstration.columns;
    columns.steps = steps;
    const auto ramp = [&](double base, int64_t width) {
      std::vector<double> values;
      for (int64_t i = 0; i < steps * width; ++i) {
        const int64_t step = i / width;
        values.push_back(base + 0.001 * static_cast<double>(step));
      }
      return values;
    };
    columns.actions = ramp(0.1, 7);
    columns.states = ramp(0, 20);
    columns.robot_states = ramp(0, 9);
    columns.ee_pos = ramp(0.2, 3);
    columns.ee_ori = ramp(0.3, 3);
    columns.gripper_states = ramp(0.4, 2);
    columns.joint_states = ramp(0.5, 7);
    if (ours) {
      columns.proprioception = ramp(0.6, 8);
      columns.aux = ramp(0.7, 8);
    }
    Image image{128, 128, std::vector<uint8_t>(3 * 128 * 128)};
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = i / 3 % 128 < 64 ? 0 : static_cast<uint8_t>(100 + i / (3 * 128));
    demonstration.agentview.assign(steps, image);
    demonstration.eye_in_hand.assign(steps, image);
    ASSERT_TRUE(writer->Add(demonstration).ok());
  }
  ASSERT_TRUE(writer->Publish().ok());
}

TEST_F(Training, AnArmThatHoldsTargetsStaysAtTheLastOne) {
  const std::string path = Path("absolute.hdf5"), shard_path = Path("absolute.safetensors");
  WriteLibero(path, true, true);
  ASSERT_TRUE(ConvertLiberoFile(path, TrainOptions().network, 2, shard_path).ok());
  const std::vector<float> actions =
      SafetensorsFile::Open(shard_path)->ReadFloats("actions", {61, 50, 7}).value();
  const float* last = &actions[29 * 350];  // of step 58 of 60
  for (int row = 1; row < 50; ++row) {
    for (int axis = 0; axis < 7; ++axis) EXPECT_FLOAT_EQ(last[7 * row + axis], 0.159f) << row;
  }
}

TEST_F(Training, AnotherTryWithOtherDataOrStrideConvertsAnew) {
  const NanoConfig network = TrainOptions().network;
  const std::string one = Path("one.hdf5"), other = Path("other.hdf5"), shards = Path("shards");
  WriteLibero(one, true);
  WriteLibero(other, false);
  const auto prepared = [&](const std::vector<std::string>& data, int stride) {
    EXPECT_TRUE(PrepareShards(data, network, stride, shards).ok());
    std::map<std::string, std::string> made;  // file, and when
    for (const auto& entry : fs::directory_iterator(shards)) {
      const auto file = SafetensorsFile::Open(entry.path().string());
      EXPECT_TRUE(file.ok()) << file.status();
      made[entry.path().filename()] =
          absl::StrCat(file->metadata().at("source"), " ", file->metadata().at("stride"), " ",
                       fs::last_write_time(entry).time_since_epoch().count());
    }
    return made;
  };
  const auto first = prepared({one, other}, 2);
  EXPECT_EQ(first.size(), 2u);
  EXPECT_EQ(prepared({one, other}, 2), first) << "what is the same is kept";
  const auto less = prepared({other}, 2);
  ASSERT_EQ(less.size(), 1u) << "nothing of the try before is trained on";
  EXPECT_THAT(less.at("000_other.safetensors"), HasSubstr("other.hdf5 2 "));
  EXPECT_THAT(prepared({other}, 3).at("000_other.safetensors"), HasSubstr("other.hdf5 3 "));
  fs::copy(one, other, fs::copy_options::overwrite_existing);
  const auto changed = prepared({other}, 3);
  EXPECT_TRUE(SafetensorsFile::Open(shards + "/000_other.safetensors")->tensors().contains("aux"))
      << "other.hdf5 holds something else now";
  fs::remove_all(shards);
}

TEST_F(Training, ReadsDemonstrationsInLiberosForm) {
  for (const bool ours : {true, false}) {
    const std::string name = ours ? "ours" : "libero";
    fs::create_directories(Path(name));
    WriteLibero(Path(name) + "/push_demo.hdf5", ours);
    TrainOptions options = SmallOptions(Path(name) + "/push_demo.hdf5", Path(name + "_run"));
    options.validation_share = 0;
    options.steps = 2;
    const absl::Status trained = RunTraining(options, false);
    if (!ours) {
      EXPECT_THAT(std::string(trained.message()),
                  AllOf(HasSubstr("push_demo"), HasSubstr("aux_weight=0")));
      options.aux_weight = 0;
    }
    const absl::Status status = ours ? trained : RunTraining(options, true);
    ASSERT_TRUE(status.ok()) << status;
    const auto shard =
        SafetensorsFile::Open(Path(name + "_run") + "/data/000_push_demo.safetensors");
    ASSERT_TRUE(shard.ok()) << shard.status();
    EXPECT_EQ(shard->metadata().at("instruction"), "push the block");
    const std::vector<float> state = shard->ReadFloats("state", {61, 8}).value();
    EXPECT_FLOAT_EQ(state[8], ours ? 0.602f : 0.202f) << "step 2 is the second frame";
    EXPECT_FLOAT_EQ(state[8 + 6], ours ? 0.602f : 0.402f);
    const std::vector<float> actions = shard->ReadFloats("actions", {61, 50, 7}).value();
    const float* last = &actions[29 * 350];  // of step 58 of 60
    EXPECT_FLOAT_EQ(last[0], 0.158f);
    EXPECT_FLOAT_EQ(last[7], 0.159f);
    EXPECT_EQ(last[14], 0) << "no motion after the end";
    EXPECT_FLOAT_EQ(last[14 + 6], 0.159f) << "the last gripper command";
    EXPECT_EQ(shard->ReadDoubles("episode", {61}).value()[30], 1);
    // Top row first; LIBERO's own files are mirrored, as the policy will see that suite.
    const uint8_t* image = shard->Get("images")->bytes.data();
    EXPECT_EQ(image[ours ? 0 : 3 * 63], 0);
    EXPECT_EQ(image[ours ? 3 * 63 : 0], 101);
    EXPECT_EQ(image[3 * 64 * 63 + (ours ? 3 * 63 : 0)], 227);
  }
}

TEST_F(Training, DoesNotOverwriteARun) {
  const TrainOptions options = SmallOptions(Path("toy"), Path("once"));
  ASSERT_TRUE(RunTraining(options, false).ok());
  EXPECT_THAT(std::string(RunTraining(options, false).message()), HasSubstr("--resume"));
}

TEST(EmbeddedPolicies, ThatAreComparedDescendFromTheSameWeights) {
  const std::string folder = "server/models/weights/";  // tests run in the source folder
  const NanoModel start = LoadNanoModel(folder + "nano.safetensors").value();
  for (const std::string name : {"nano-bc", "nano-dr", "nano-robust"}) {
    ASSERT_TRUE(IsEmbeddedPolicy(name));
    const auto policy = LoadFlowPolicy(name);
    ASSERT_TRUE(policy.ok()) << policy.status();
    EXPECT_EQ((*policy)->spec().name, name);
    const NanoModel model = LoadNanoModel(folder + name + ".safetensors").value();
    EXPECT_EQ(model.actions.mean, start.actions.mean);
    EXPECT_EQ(model.state.std, start.state.std);
    EXPECT_EQ(model.vocabulary.words(), start.vocabulary.words());
    // A short fine-tuning moves every weight a little.
    double moved = 0, size = 0;
    for (size_t i = 0; i < model.tensors.size(); ++i) {
      moved += (model.tensors[i] - start.tensors[i]).square().sum().item<double>();
      size += start.tensors[i].square().sum().item<double>();
    }
    EXPECT_GT(moved, 0);
    EXPECT_LT(std::sqrt(moved / size), 0.3);
  }
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
