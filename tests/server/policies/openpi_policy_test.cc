// pi0 and pi0.5 as policies: from an observation to actions, from a folder to a server.

#include "server/policies/openpi/openpi_policy.h"

#include <ATen/Parallel.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <torch/types.h>
#include <unistd.h>

#include <thread>

#include "absl/strings/str_split.h"
#include "adapter/lora.h"
#include "common/image_resize.h"
#include "common/rpc/policy_client.h"
#include "server/policies/openpi/checkpoint_generator.h"
#include "server/policies/openpi/images.h"
#include "server/policies/tensor_io.h"
#include "server/sessions/read_spec.h"
#include "tests/adapter/toy_arm.h"
#include "tests/oracle_file.h"
#include "tests/run_program.h"
#include "tests/server/policies/tiny_checkpoint.h"

namespace robostress::openpi {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using torch::Tensor;

std::string Message(const absl::Status& status) { return std::string(status.message()); }

Image Noise(int width, int height, uint64_t seed) {
  Image image{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  RandomStream random(StreamKey("openpi_policy").With(static_cast<int64_t>(seed)));
  for (uint8_t& value : image.data) value = static_cast<uint8_t>(random.UniformInt(256));
  return image;
}

Observation LiberoObservation(int size, uint64_t seed = 0) {
  Observation observation;
  observation.instruction = "put the bowl on_the plate";
  observation.views = {{"agentview", Noise(size, size, 2 * seed)},
                       {"robot0_eye_in_hand", Noise(size, size, 2 * seed + 1)}};
  observation.proprioception = Eigen::VectorXf::LinSpaced(8, -0.5f, 0.9f);
  return observation;
}

double MaxDifference(const Tensor& a, const Tensor& b) {
  return (a - b).abs().max().item<double>();
}

// ----------------------------------------------------------------------------------------- images

// Against openpi's two ways of resizing (Pillow 9.4.0, torch 1.13.1).
TEST(OpenpiImages, EqualTheOracles) {
  const std::string path = OracleFile("preprocess.io.safetensors");
  if (path.empty()) GTEST_SKIP() << kNoOracle;
  const SafetensorsFile file = SafetensorsFile::Open(path).value();
  int compared = 0;
  for (const auto& [name, view] : file.tensors()) {
    const std::vector<std::string> parts = absl::StrSplit(name, '.');
    const bool pillow = parts[0] == "expected/pil_float_nchw";
    if (!pillow && parts[0] != "expected/torch") continue;
    SCOPED_TRACE(name);
    const TensorView input = file.Get("inputs/" + parts[1]).value();
    const Image image{static_cast<int>(input.shape[1]),
                      static_cast<int>(input.shape[0]),
                      {input.bytes.begin(), input.bytes.end()}};
    Tensor expected = ToTensor(name, view).value();
    if (!pillow) expected = expected.permute({0, 3, 1, 2});
    const Tensor tensor = ImageTensor(image, expected.size(2),
                                      pillow ? ResizeFilter::kPillow : ResizeFilter::kInterpolate);
    ASSERT_EQ(tensor.sizes(), expected.sizes());
    // One rounding of a value up to 1: the compiler of torch may fuse, ours may not.
    EXPECT_LE(MaxDifference(tensor, expected), 1.2e-7);
    ++compared;
  }
  EXPECT_EQ(compared, 14);
}

// ------------------------------------------------------------------------------------------ setup

TEST(PolicySetup, FollowsWhoWroteTheCheckpoint) {
  for (const auto layout : {CheckpointLayout::kOpenpi, CheckpointLayout::kLerobot}) {
    for (const bool pi05 : {false, true}) {
      const auto folder = std::filesystem::path(::testing::TempDir()) / "setup_of_layout";
      std::filesystem::remove_all(folder);
      const absl::Status made =
          GenerateCheckpoint({.pi05 = pi05, .layout = layout, .out = folder.string()});
      ASSERT_TRUE(made.ok()) << made;
      PolicyOptions options;
      options.tokenizer = kTinyTokenizer;
      const auto checkpoint = OpenCheckpoint(folder.string(), NetworkOptions(options));
      ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
      const SetupResult resolved = ResolveSetup(*checkpoint, options);
      const PolicySetup& setup = resolved.setup;
      ASSERT_THAT(resolved.problems, ::testing::IsEmpty());
      const bool lerobot = layout == CheckpointLayout::kLerobot;
      EXPECT_EQ(setup.robot.name, "plain");
      EXPECT_EQ(setup.robot.state_dim, 8);
      EXPECT_EQ(setup.robot.action_dim, 7);
      EXPECT_EQ(setup.convention, lerobot ? NormConvention::kLerobot : NormConvention::kOpenpi);
      EXPECT_EQ(setup.state.kind(), pi05 ? NormKind::kQuantile : NormKind::kZScore);
      EXPECT_EQ(setup.actions.kind(), setup.state.kind());
      EXPECT_EQ(setup.resize, lerobot ? ResizeFilter::kInterpolate : ResizeFilter::kPillow);
      EXPECT_EQ(setup.prompt, pi05 ? PromptFormat::kTextAndState : PromptFormat::kText);
      EXPECT_EQ(setup.prompt_has_padded_state, lerobot);
      EXPECT_EQ(setup.prompt_tokens, pi05 ? 200 : 48);
      EXPECT_FALSE(setup.delta);
      // libero: a delta too many in openpi's pi0, none in LeRobot's; no state in pi05's prompt.
      options.transform = "libero";
      const PolicySetup libero = ResolveSetup(*checkpoint, options).setup;
      EXPECT_EQ(libero.delta, !lerobot && !pi05);
      EXPECT_EQ(libero.prompt, pi05 && lerobot ? PromptFormat::kTextAndState : PromptFormat::kText);
      std::filesystem::remove_all(folder);
    }
  }
}

// ------------------------------------------------------------------------- before and after

struct Served {
  bool pi05;
  std::string device;
};

class OpenpiPolicyTest : public ::testing::TestWithParam<Served> {
 protected:
  void SetUp() override {
    UseBuiltPrograms();
    unsetenv("ROBOSTRESS_TOKENIZER");
    folder_ = WriteTinyCheckpoint(GetParam().pi05 ? "served_pi05" : "served_pi0", GetParam().pi05);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::unique_ptr<FlowPolicy> Load(std::vector<std::string> options = {}) {
    options.insert(options.begin(), "device=" + GetParam().device);
    auto policy = LoadFlowPolicy(folder_.string(), options);
    EXPECT_TRUE(policy.ok()) << policy.status();
    return *std::move(policy);
  }
  std::string LoadError(const std::vector<std::string>& options = {}) {
    return Message(LoadFlowPolicy(folder_.string(), options).status());
  }

  std::filesystem::path folder_;
};

std::vector<Served> EachOnEveryDevice() {
  std::vector<Served> all;
  for (const std::string& device : Devices())
    for (const bool pi05 : {false, true}) all.push_back({pi05, device});
  return all;
}

INSTANTIATE_TEST_SUITE_P(All, OpenpiPolicyTest, ::testing::ValuesIn(EachOnEveryDevice()),
                         [](const auto& info) {
                           return (info.param.pi05 ? "pi05_" : "pi0_") + info.param.device;
                         });

TEST_P(OpenpiPolicyTest, SaysWhatItWants) {
  const auto policy = Load();
  const PolicySpec& spec = policy->spec();
  EXPECT_EQ(spec.name, folder_.string());
  EXPECT_EQ(spec.model_hash.size(), 64u);
  EXPECT_THAT(spec.cameras, ElementsAre("agentview", "robot0_eye_in_hand"));
  EXPECT_EQ(spec.image_width, 15);
  EXPECT_EQ(spec.state_dim, 8);
  EXPECT_EQ(spec.action_dim, 7);
  EXPECT_EQ(spec.horizon, 7);
  EXPECT_EQ(spec.execute_steps, 5);
  EXPECT_TRUE(spec.adaptable);
  EXPECT_EQ(policy->model_action_dim(), 10);
  EXPECT_EQ(policy->lora_targets().size(), 7u * 3);
  EXPECT_EQ(policy->lora_targets()[7 + 6].name,
            "paligemma_with_expert.gemma_expert.model.layers.1.mlp.down_proj");
  EXPECT_EQ(policy->lora_targets()[7 + 6].in_features, 24);
  EXPECT_EQ(policy->lora_targets()[7 + 6].out_features, 16);
  // Whatever changes the actions changes the hash.
  EXPECT_NE(Load({"euler_steps=4"})->spec().model_hash, spec.model_hash);
  EXPECT_EQ(Load()->spec().model_hash, spec.model_hash);
}

// The whole way by hand, with the absent camera as openpi has it: a black image that is masked.
TEST_P(OpenpiPolicyTest, PredictsWhatTheNetworkGivesForOpenpisInputs) {
  const auto policy = Load();
  const OpenpiModel model = RandomOpenpiModel(TinyServedConfig(GetParam().pi05), 5);
  const Observation observation = LiberoObservation(15);
  const FieldStats s = TinyStats(8, 0), a = TinyStats(7, 0.3);

  ModelInputs inputs;
  for (int slot = 0; slot < 3; ++slot) {
    inputs.images.push_back(
        slot < 2 ? ImageTensor(observation.views[slot].image, 15, ResizeFilter::kPillow)
                 : at::full({1, 3, 15, 15}, -1.0f));
    inputs.image_masks.push_back(at::full({1}, slot < 2, torch::kBool));
  }
  std::vector<int64_t> ids = {2, 278, 262, 275, 270, 262, 276, 14};  // pi05_libero: no state either
  const auto used = static_cast<int64_t>(ids.size());
  ids.resize(model.config.prompt_tokens, 0);
  inputs.tokens = torch::tensor(ids, torch::kInt64).unsqueeze(0);
  inputs.token_mask = (at::arange(model.config.prompt_tokens) < used).unsqueeze(0);
  inputs.state = at::zeros({1, 10});
  for (int i = 0; i < 8; ++i) {
    const double x = observation.proprioception[i];
    inputs.state[0][i] = GetParam().pi05 ? 2 * (x - s.q01[i]) / (s.q99[i] - s.q01[i] + 1e-6) - 1
                                         : (x - s.mean[i]) / (s.std[i] + 1e-6);
  }
  const Tensor noise = at::randn({1, 7, 10}, at::detail::createCPUGenerator(1));
  const Tensor expected =
      IntegrateEuler(model, EncodePrefix(model, EmbedPrefix(model, inputs), inputs.state), noise,
                     10)
          .xs.back();

  const auto context = policy->Encode(observation);
  ASSERT_TRUE(context.ok()) << context.status();
  const Tensor chunk = policy->Sample(*context, noise, nullptr);
  // The masked camera is summed with weight zero there and absent here.
  EXPECT_LT(MaxDifference(chunk, expected), 2e-5);
  EXPECT_LT(MaxDifference(context->state.cpu(), inputs.state), 1e-6);

  const Eigen::MatrixXf actions = policy->ToEnvironment(chunk[0], context->state);
  ASSERT_EQ(actions.rows(), 7);
  ASSERT_EQ(actions.cols(), 7);
  for (int i = 0; i < 7; ++i) {
    for (int j = 0; j < 7; ++j) {
      const double y = chunk[0][i][j].item<double>();
      const double x = GetParam().pi05 ? (y + 1) / 2 * (a.q99[j] - a.q01[j] + 1e-6) + a.q01[j]
                                       : y * (a.std[j] + 1e-6) + a.mean[j];
      // pi0_libero adds the state at the chunk's start, pi05_libero does not; the gripper never.
      const double state = !GetParam().pi05 && j < 6 ? observation.proprioception[j] : 0;
      EXPECT_NEAR(actions(i, j), x + state, 2e-6) << i << " " << j;
    }
  }
  const Tensor back = policy->ToModel(actions, context->state);
  EXPECT_LT(MaxDifference(back, chunk[0].narrow(1, 0, 7)), 1e-5);
}

TEST_P(OpenpiPolicyTest, ResizesImagesOfAnySize) {
  const auto policy = Load();
  Observation large = LiberoObservation(40), small = large;
  for (size_t i = 0; i < small.views.size(); ++i)
    small.views[i].image = ResizeWithPad(large.views[i].image, 15, 15);
  const PolicyContext a = policy->Encode(large).value(), b = policy->Encode(small).value();
  EXPECT_TRUE(torch::equal(a.keys.back(), b.keys.back()));
  const PolicyContext c = Load({"resize=interpolate"})->Encode(large).value();
  EXPECT_FALSE(torch::equal(a.keys.back(), c.keys.back()));
}

TEST_P(OpenpiPolicyTest, LoraWithoutBHasNoEffectAndTrainsThroughTheVelocity) {
  const auto policy = Load();
  const PolicyContext context = policy->Encode(LiberoObservation(15)).value();
  const Tensor noise = at::randn({1, 7, 10}, at::detail::createCPUGenerator(2));
  LoraWeights lora =
      InitialLora(policy->lora_targets(), LoraKind::kPerHead, 4, 0.01, StreamKey("test"));
  EXPECT_TRUE(
      torch::equal(policy->Sample(context, noise, &lora), policy->Sample(context, noise, nullptr)));
  for (const Tensor& parameter : Parameters(lora)) parameter.requires_grad_(true);
  const PolicyContext two = StackContexts({&context, &context});
  policy->Velocity(two, at::cat({noise, noise * 0.5}), torch::tensor({0.3f, 0.8f}), &lora)
      .square()
      .mean()
      .backward();
  for (size_t i = 0; i < lora.B.size(); ++i)
    EXPECT_GT(lora.B[i].grad().abs().max().item<double>(), 0) << policy->lora_targets()[i].name;
}

TEST_P(OpenpiPolicyTest, ServesBf16WithGradientsNearThoseOfFloat32) {
  const auto wide = Load(), narrow = Load({"precision=bf16"});
  EXPECT_NE(narrow->spec().model_hash, wide->spec().model_hash);
  const Observation observation = LiberoObservation(15);
  const PolicyContext stored = narrow->Encode(observation).value();
  EXPECT_EQ(stored.keys.back().scalar_type(), torch::kBFloat16);
  const Tensor noise = at::randn({1, 7, 10}, at::detail::createCPUGenerator(2));
  const Tensor expected = wide->Sample(wide->Encode(observation).value(), noise, nullptr);
  const Tensor actions = narrow->Sample(stored, noise, nullptr);
  EXPECT_EQ(actions.scalar_type(), torch::kFloat32);
  EXPECT_LT((actions - expected).square().mean().sqrt().item<double>(),
            0.03 * expected.square().mean().sqrt().item<double>());

  const auto gradients = [&](const FlowPolicy& policy) {
    LoraWeights lora =
        InitialLora(policy.lora_targets(), LoraKind::kPerHead, 4, 0.01, StreamKey("test"));
    for (const Tensor& parameter : Parameters(lora)) parameter.requires_grad_(true);
    const PolicyContext context = policy.Encode(observation).value();
    const Tensor velocity = policy.Velocity(context, noise, torch::tensor({0.3f}), &lora);
    EXPECT_EQ(velocity.scalar_type(), torch::kFloat32);
    velocity.square().mean().backward();
    std::vector<Tensor> flat;
    for (const Tensor& B : lora.B) flat.push_back(B.grad().flatten());
    return at::cat(flat);
  };
  const Tensor a = gradients(*wide), b = gradients(*narrow);
  EXPECT_LT((a - b).norm().item<double>(), 0.05 * a.norm().item<double>());
}

TEST_P(OpenpiPolicyTest, ThreadsOfAPredictionAreItsOwnAndLeaveTheHash) {
  const auto one = Load(), two = Load({"threads=2", "device=cpu"});
  EXPECT_EQ(two->spec().model_hash, one->spec().model_hash);
  const Observation observation = LiberoObservation(15);
  const int before = at::get_num_threads();
  std::thread([&] {  // a count belongs to a thread
    EXPECT_TRUE(two->Encode(observation).ok());
    EXPECT_EQ(at::get_num_threads(), 2);
  })
      .join();
  EXPECT_TRUE(one->Encode(observation).ok());
  EXPECT_EQ(at::get_num_threads(), before);
}

TEST_P(OpenpiPolicyTest, RefusesPrecisionsDevicesAndThreadsThatAreNotThere) {
  EXPECT_THAT(LoadError({"precision=fp8"}),
              AllOf(HasSubstr("precision"), HasSubstr("fp8"), HasSubstr("float32, bf16")));
  EXPECT_THAT(LoadError({"device=gpu"}),
              HasSubstr("--policy-options: policy option device is 'gpu', must be cpu, cuda or"));
  EXPECT_THAT(LoadError({"device=cuda:99"}),
              AllOf(HasSubstr("device 'cuda:99' is not there"), HasSubstr("use cpu")));
  EXPECT_THAT(LoadError({"threads=0"}), HasSubstr("threads is 0, must be 1..1024"));
  WriteText(folder_ / kPolicyOptionsFile, "threads: 4096\n");
  EXPECT_THAT(LoadError(), AllOf(HasSubstr((folder_ / kPolicyOptionsFile).string()),
                                 HasSubstr("threads is 4096, must be 1..1024")));
  const auto [text, code] =
      RunProgram(POLICY_PROGRAM, "inspect " + folder_.string() +
                                     " --policy-options threads=2 precision=bf16 device=cuda:99");
  EXPECT_EQ(code, 1);
  EXPECT_THAT(text, AllOf(HasSubstr("problems (1)"), HasSubstr("device 'cuda:99' is not there"),
                          HasSubstr("bf16")));
}

TEST_P(OpenpiPolicyTest, RefusesObservationsThatDoNotFit) {
  const auto policy = Load();
  const auto message = [&](auto change) {
    Observation observation = LiberoObservation(15);
    change(observation);
    return Message(policy->Encode(observation).status());
  };
  EXPECT_THAT(message([](Observation& o) { o.views.pop_back(); }),
              AllOf(HasSubstr("robot0_eye_in_hand"), HasSubstr("given: agentview")));
  EXPECT_THAT(message([](Observation& o) { o.views[0].image.data.pop_back(); }),
              HasSubstr("agentview' is 15 x 15 and has 674 bytes"));
  EXPECT_THAT(message([](Observation& o) { o.views[1].image = {}; }), HasSubstr("0 x 0"));
  EXPECT_THAT(message([](Observation& o) { o.proprioception.conservativeResize(7); }),
              HasSubstr("proprioception has 7 numbers, transform libero takes 8"));
  EXPECT_THAT(message([](Observation& o) { o.proprioception[3] = NAN; }),
              HasSubstr("proprioception[3] is nan"));
  EXPECT_THAT(message([](Observation& o) { o.instruction = "\xff"; }), HasSubstr("not UTF-8"));
}

TEST_P(OpenpiPolicyTest, PiperHasAbsoluteJointsOfSixDeltasAndAGripper) {
  WriteText(folder_ / kPolicyOptionsFile,
            "name: arm\ntransform: piper\ncameras: [front, '', hand]\nexecute_steps: 3\n");
  const auto policy = Load();
  EXPECT_EQ(policy->spec().name, "arm");
  EXPECT_THAT(policy->spec().cameras, ElementsAre("front", "hand"));
  EXPECT_EQ(policy->spec().state_dim, 7);
  EXPECT_EQ(policy->spec().execute_steps, 3);
  Observation observation = LiberoObservation(15);
  observation.views[0].camera = "front";
  observation.views[1].camera = "hand";
  observation.proprioception.conservativeResize(7);
  const auto context = policy->Encode(observation);
  ASSERT_TRUE(context.ok()) << context.status();
  const auto plain = Load({"delta=false"});
  const Tensor chunk = at::randn({7, 10}, at::detail::createCPUGenerator(3));
  Eigen::MatrixXf difference =
      policy->ToEnvironment(chunk, context->state) - plain->ToEnvironment(chunk, context->state);
  EXPECT_LT((difference.leftCols(6).rowwise() - observation.proprioception.head(6).transpose())
                .cwiseAbs()
                .maxCoeff(),
            1e-6);
  EXPECT_EQ(difference.col(6).cwiseAbs().maxCoeff(), 0);
}

TEST_P(OpenpiPolicyTest, ListsAllProblemsBeforeItTakesMemory) {
  std::filesystem::remove(folder_ / "tokenizer.model");
  FieldStats bad = TinyStats(8, 0);
  bad.std.resize(5), bad.mean.resize(5), bad.q01.resize(5), bad.q99.resize(5);
  WriteText(folder_ / kTinyAsset, absl::StrCat("{\"norm_stats\": {\"state\": ", StatsJson(bad),
                                               ", \"actions\": ", StatsJson(bad), "}}"));
  EXPECT_THAT(LoadError({"execute_steps=9"}),
              AllOf(HasSubstr("4 problems"), HasSubstr("norm_stats.json: 'state'"),
                    HasSubstr("has 5 numbers, must have at least 8"),
                    HasSubstr("has 5 numbers, must have at least 7"),
                    HasSubstr("no SentencePiece tokenizer"),
                    HasSubstr("execute_steps is 9, a chunk has 7")));
  const std::string half = (folder_ / "half.json").string();
  WriteText(half, absl::StrCat("{\"norm_stats\": {\"state\": ", StatsJson(TinyStats(8, 0)), "}}"));
  EXPECT_THAT(LoadError({"norm_stats=" + half}),
              AllOf(HasSubstr(half), HasSubstr("no statistics of 'actions'")));
  // Wrong statistics are refused by the one that reads them.
  WriteText(folder_ / kTinyAsset, "{\"norm_stats\": {\"state\": 3}}");
  EXPECT_THAT(LoadError({absl::StrCat("tokenizer=", kTinyTokenizer)}),
              AllOf(HasSubstr("norm_stats.json"), HasSubstr("state")));
  EXPECT_THAT(LoadError({"normalisation=none", "tokenizer=gone.model"}),
              AllOf(HasSubstr("1 problem"), HasSubstr("gone.model")));
}

TEST_P(OpenpiPolicyTest, TakesNormStatsFromElsewhereOrNone) {
  const std::string moved = (folder_ / "elsewhere.json").string();
  std::filesystem::rename(folder_ / kTinyAsset, moved);
  EXPECT_THAT(LoadError(), HasSubstr("norm_stats.json"));
  EXPECT_EQ(Load({"norm_stats=" + moved, "transform=libero"})->spec().state_dim, 8);
  const auto bare = Load({"normalisation=none", "transform=libero", "delta=false"});
  const Tensor chunk = at::randn({7, 10}, at::detail::createCPUGenerator(3));
  const Eigen::MatrixXf actions = bare->ToEnvironment(chunk, {});
  EXPECT_FLOAT_EQ(actions(2, 3), chunk[2][3].item<float>());
}

TEST_P(OpenpiPolicyTest, DiscreteStateBelongsToPi05) {
  if (!GetParam().pi05) {
    EXPECT_THAT(LoadError({"discrete_state=true"}), HasSubstr("pi0 takes its state as a token"));
    return;
  }
  const auto with = Load({"discrete_state=true"}), without = Load();
  Observation a = LiberoObservation(15), b = a;
  b.proprioception[2] += 0.5f;
  const auto keys = [](const FlowPolicy& policy, const Observation& observation) {
    return policy.Encode(observation).value().keys.back();
  };
  EXPECT_FALSE(torch::equal(keys(*with, a), keys(*with, b)));
  EXPECT_TRUE(torch::equal(keys(*without, a), keys(*without, b)));
}

// ---------------------------------------------------------------------------------------- inspect

TEST_P(OpenpiPolicyTest, InspectSaysWhatItIsAndExpects) {
  const auto [text, code] = RunProgram(POLICY_PROGRAM, "inspect " + folder_.string());
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr(GetParam().pi05 ? "pi0.5" : "pi0"), HasSubstr("libero"),
                          HasSubstr("agentview"), HasSubstr("absent, masked"),
                          HasSubstr(GetParam().pi05 ? "quantile (openpi)" : "z_score (openpi)"),
                          HasSubstr(kTinyAsset), HasSubstr("tokenizer.model"),
                          HasSubstr("embed_tokens"), HasSubstr("can be served")));
  const auto [json, json_code] = RunProgram(POLICY_PROGRAM, "inspect --json " + folder_.string());
  EXPECT_EQ(json_code, 0);
  const auto parsed = nlohmann::json::parse(json, nullptr, false);
  ASSERT_TRUE(parsed.is_object()) << json;
  int64_t parameters = 0;
  for (const auto& [name, tensor] :
       WeightTensors(RandomOpenpiModel(TinyServedConfig(GetParam().pi05), 5)))
    parameters += tensor.numel();
  EXPECT_EQ(parsed["is"]["parameters"], parameters);
  EXPECT_EQ(parsed["is"]["tokenizer"]["pieces"], 400);
  EXPECT_EQ(parsed["expects"]["prompt_tokens"], GetParam().pi05 ? 60 : 14);
  EXPECT_EQ(parsed["expects"]["horizon"], 7);
  EXPECT_EQ(parsed["problems"].size(), 0u);
}

TEST_P(OpenpiPolicyTest, InspectListsAllProblemsAndFails) {
  std::filesystem::remove(folder_ / "tokenizer.model");
  std::filesystem::remove(folder_ / kTinyAsset);
  const auto [text, code] = RunProgram(POLICY_PROGRAM, "inspect " + folder_.string());
  EXPECT_EQ(code, 1);
  EXPECT_THAT(text, AllOf(HasSubstr("problems (2)"), HasSubstr("no SentencePiece tokenizer"),
                          HasSubstr("no normalisation statistics"), HasSubstr("horizon"),
                          Not(HasSubstr("can be served"))));
  // Even of a file that is no checkpoint all is said that can be.
  WriteText(folder_ / "model.safetensors", "not a weights file at all");
  const auto [foreign, foreign_code] =
      RunProgram(POLICY_PROGRAM, "inspect --policy-options delta=perhaps -- " + folder_.string());
  EXPECT_EQ(foreign_code, 1);
  EXPECT_THAT(foreign, AllOf(HasSubstr("problems (3)"), HasSubstr("model.safetensors"),
                             HasSubstr("perhaps"), HasSubstr("no SentencePiece tokenizer")));
}

TEST(PolicyInspect, KnowsNano) {
  const auto [text, code] = RunProgram(POLICY_PROGRAM, "inspect nano");
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text,
              AllOf(HasSubstr("after pi0\n"), HasSubstr("64 x 64"), HasSubstr("can be served")));
  EXPECT_THAT(RunProgram(POLICY_PROGRAM, "inspect nano-pi05").first,
              AllOf(HasSubstr("after pi0.5\n"), HasSubstr("as words of the prompt")));
  EXPECT_EQ(RunProgram(POLICY_PROGRAM, "inspect absent_folder").second, 1);
  EXPECT_EQ(RunProgram(POLICY_PROGRAM, "inspect").second, 2);
}

// ------------------------------------------------------------------------------------- over gRPC

// A robostress-serve of its own; ends with the test.
class ServeProcess {
 public:
  explicit ServeProcess(const std::vector<std::string>& arguments) {
    const auto port_file =
        std::filesystem::path(::testing::TempDir()) / absl::StrCat("openpi-port-", getpid());
    std::filesystem::remove(port_file);
    std::vector<std::string> all = {SERVE_PROGRAM, "--threads", "1", "--port-file",
                                    port_file.string()};
    all.insert(all.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& argument : all) argv.push_back(argument.data());
    argv.push_back(nullptr);
    child_ = fork();
    if (child_ == 0) {
      execv(SERVE_PROGRAM, argv.data());
      _exit(127);
    }
    std::string port;
    for (int i = 0; i < 1200 && port.empty() && waitpid(child_, nullptr, WNOHANG) == 0; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      std::ifstream(port_file) >> port;
    }
    options_.address = absl::StrCat("127.0.0.1:", port);
  }
  ~ServeProcess() {
    kill(child_, SIGTERM);
    waitpid(child_, nullptr, 0);
  }
  const PolicyClientOptions& options() const { return options_; }

 private:
  pid_t child_ = -1;
  PolicyClientOptions options_;
};

TEST_P(OpenpiPolicyTest, IsServedPredictsLearnsAndReports) {
  ServeProcess server({"--policy", folder_.string(), "--policy-options", "execute_steps=4",
                       "device=" + GetParam().device, "--min-update-interval", "1"});
  SessionSpec spec;
  spec.suite = "libero_goal";
  spec.scenario = "clean";
  spec.policy = folder_.string();
  spec.method = *MakeMethod(
      "ours", {"buffer_chunks=2", "batch=2", "update_interval=1", "learning_rate=0.01"});
  auto client = GrpcPolicyClient::Connect(server.options(), RequestOf(spec));
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ((*client)->spec().execute_steps, 4);
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  ToyArm arm(0.6);
  std::vector<Eigen::MatrixXf> actions;
  for (int i = 0; i < 4; ++i) {
    // Cameras need not have the network's size: the server resizes, as openpi's client does.
    const auto prediction = (*client)->Predict(LiberoObservation(i % 2 == 0 ? 15 : 40, 1), i);
    ASSERT_TRUE(prediction.ok()) << prediction.status();
    ASSERT_EQ(prediction->actions.rows(), 7);
    ASSERT_EQ(prediction->actions.cols(), 7);
    actions.push_back(prediction->actions);
    EXPECT_EQ(prediction->adapter_version, i < 2 ? 0u : static_cast<uint64_t>(i - 1));
    ExecutedChunk executed = arm.Execute(*prediction, 4);
    executed.sequence = static_cast<uint64_t>(i) + 1;
    executed.chunk = i;
    const absl::Status sent = (*client)->SendFeedback(executed);
    ASSERT_TRUE(sent.ok()) << sent;
  }
  const auto stats = (*client)->Stats();
  ASSERT_TRUE(stats.ok()) << stats.status();
  EXPECT_EQ(stats->updates_applied, 3u);
  EXPECT_GT(stats->adapter_distance, 0);
  EXPECT_TRUE(std::isfinite(stats->last_loss));
}

}  // namespace
}  // namespace robostress::openpi
