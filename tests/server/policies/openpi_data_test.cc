// What stands before and after pi0 and pi0.5 and needs no LibTorch: tokenizer, prompts,
// normalisation, transforms, options.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "server/policies/openpi/normalisation.h"
#include "server/policies/openpi/policy_options.h"
#include "server/policies/openpi/prompt.h"
#include "server/policies/openpi/tokenizer.h"
#include "server/policies/openpi/transforms.h"
#include "tests/oracle_file.h"
#include "tests/run_program.h"
#include "tests/server/policies/tiny_tokenizer.h"

namespace robostress::openpi {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;

std::string Message(const absl::Status& status) { return std::string(status.message()); }

std::string TempFile(const std::string& name, const std::string& contents) {
  const auto path = std::filesystem::path(::testing::TempDir()) / name;
  std::ofstream(path, std::ios::binary) << contents;
  return path.string();
}

std::unique_ptr<Tokenizer> LoadTiny() {
  UseBuiltPrograms();
  auto tokenizer = Tokenizer::Load(kTinyTokenizer);
  EXPECT_TRUE(tokenizer.ok()) << tokenizer.status();
  return *std::move(tokenizer);
}

// -------------------------------------------------------------------------------------- tokenizer

TEST(OpenpiTokenizer, GivesTheIdsOfPythonsSentencePiece) {
  const auto tokenizer = LoadTiny();
  EXPECT_EQ(tokenizer->pieces(), 400);
  EXPECT_EQ(tokenizer->bos(), 2);
  EXPECT_THAT(tokenizer->Encode("put the bowl on the plate").value(),
              ElementsAre(278, 262, 275, 270, 262, 276));
  EXPECT_THAT(tokenizer->Encode("\n").value(), ElementsAre(14));
  EXPECT_THAT(tokenizer->Encode("Übergröße_ x").value(),  // bytes where there is no piece
              ElementsAre(199, 160, 372, 303, 107, 377, 199, 186, 199, 163, 365, 99, 363, 390));
  EXPECT_THAT(tokenizer->Encode(" two  spaces ").value(),
              ElementsAre(260, 376, 366, 363, 363, 378, 369, 370, 299, 378, 363));
  EXPECT_TRUE(tokenizer->Encode("").value().empty());
}

TEST(OpenpiTokenizer, AnswersSeveralThreads) {
  const auto tokenizer = LoadTiny();
  std::vector<std::thread> threads;
  std::vector<int> right(4, 0);
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&, i] {
      const std::string text = absl::StrCat("put ", i);
      const auto expected = tokenizer->Encode(text).value();
      for (int k = 0; k < 20; ++k) right[i] += tokenizer->Encode(text).value() == expected;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_THAT(right, ::testing::Each(20));
}

TEST(OpenpiTokenizer, StartsAgainWhenItsProcessDied) {
  const auto tokenizer = LoadTiny();
  const auto before = tokenizer->Encode("put the bowl").value();
  ASSERT_EQ(kill(tokenizer->process_id(), SIGKILL), 0);
  const auto after = tokenizer->Encode("put the bowl");
  ASSERT_TRUE(after.ok()) << after.status();
  EXPECT_EQ(*after, before);
}

TEST(OpenpiTokenizer, RefusesFilesThatAreNoModelWithTheirName) {
  UseBuiltPrograms();
  const std::string foreign = TempFile("foreign.model", "not a model at all");
  EXPECT_THAT(Message(Tokenizer::Load(foreign).status()),
              AllOf(HasSubstr(foreign), HasSubstr("is no SentencePiece model")));
  const std::string whole = ReadFile(kTinyTokenizer).value();
  const std::string cut = TempFile("cut.model", whole.substr(0, whole.size() / 2));
  EXPECT_THAT(Message(Tokenizer::Load(cut).status()), HasSubstr(cut));
  const std::string empty = TempFile("empty.model", "");
  EXPECT_THAT(Message(Tokenizer::Load(empty).status()),
              AllOf(HasSubstr(empty), HasSubstr("has 0 bytes")));
  EXPECT_THAT(Message(Tokenizer::Load("absent.model").status()),
              AllOf(HasSubstr("absent.model"), HasSubstr("paligemma_tokenizer.model")));
  // A sparse file: 1 TiB that nobody reads.
  const std::string huge = TempFile("huge.model", "x");
  std::filesystem::resize_file(huge, uintmax_t{1} << 40);
  EXPECT_THAT(Message(Tokenizer::Load(huge).status()), HasSubstr("must have 1..67108864"));
  std::filesystem::remove(huge);
}

TEST(OpenpiTokenizer, RefusesMorePiecesThanEmbeddingRows) {
  const auto tokenizer = LoadTiny();
  EXPECT_TRUE(CheckPieces(*tokenizer, 400).ok());
  EXPECT_THAT(Message(CheckPieces(*tokenizer, 399)),
              AllOf(HasSubstr("400 pieces"), HasSubstr("399"), HasSubstr(kTinyTokenizer)));
}

TEST(OpenpiTokenizer, RefusesTextThatIsNotUtf8) {
  const auto tokenizer = LoadTiny();
  EXPECT_THAT(Message(tokenizer->Encode("\xff\xfe").status()), HasSubstr("not UTF-8"));
  EXPECT_TRUE(tokenizer->Encode("put").ok());
}

TEST(OpenpiTokenizer, IsLookedForInOptionVariableAndFolder) {
  unsetenv("ROBOSTRESS_TOKENIZER");
  const auto folder = std::filesystem::path(::testing::TempDir()) / "tokenizer_places";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  EXPECT_THAT(Message(FindTokenizer("", folder).status()),
              AllOf(HasSubstr((folder / "paligemma_tokenizer.model").string()),
                    HasSubstr((folder / "tokenizer.model").string()), HasSubstr("gs://big_vision"),
                    HasSubstr("ROBOSTRESS_TOKENIZER")));
  std::ofstream(folder / "tokenizer.model") << "x";
  EXPECT_EQ(FindTokenizer("", folder).value(), folder / "tokenizer.model");
  setenv("ROBOSTRESS_TOKENIZER", kTinyTokenizer, 1);
  EXPECT_EQ(FindTokenizer("", folder).value(), kTinyTokenizer);
  const std::string option = (folder / "tokenizer.model").string();
  EXPECT_EQ(FindTokenizer(option, folder).value(), option);
  // What was asked for is not replaced by something else.
  EXPECT_THAT(Message(FindTokenizer("gone.model", folder).status()),
              AllOf(HasSubstr("gone.model"), HasSubstr("option tokenizer")));
  setenv("ROBOSTRESS_TOKENIZER", "also_gone.model", 1);
  EXPECT_THAT(Message(FindTokenizer("", folder).status()), HasSubstr("also_gone.model"));
  unsetenv("ROBOSTRESS_TOKENIZER");
}

TEST(TokenizeProgram, PrintsIdsLineByLine) {
  const auto [output, code] =
      RunProgram("printf '\"put the bowl\"\\n17\\n' | " TOKENIZE_PROGRAM, kTinyTokenizer);
  EXPECT_EQ(code, 0);
  EXPECT_THAT(output, AllOf(HasSubstr("\"pieces\":400"), HasSubstr("[278,262,275]"),
                            HasSubstr("not a JSON string")));
}

// ----------------------------------------------------------------------------------------- prompt

TEST(OpenpiPrompt, CleansAsOpenpiDoes) {
  EXPECT_EQ(CleanInstruction("  put_the\nbowl \n"), "put the bowl");
  EXPECT_EQ(CleanInstruction("_a_"), " a ");  // stripped before '_' becomes a space
}

TEST(OpenpiPrompt, Pi0HasBosTextAndItsNewlineApart) {
  const auto tokenizer = LoadTiny();
  const Prompt prompt =
      MakePrompt(*tokenizer, PromptFormat::kText, 12, "put the bowl on_the plate\n", {}).value();
  EXPECT_THAT(prompt.ids, ElementsAre(2, 278, 262, 275, 270, 262, 276, 14, 0, 0, 0, 0));
  EXPECT_EQ(prompt.used, 8);
  EXPECT_EQ(prompt.cut, 0);
}

TEST(OpenpiPrompt, Pi05HoldsTheBinsOfTheState) {
  const std::vector<double> state = {-0.90625, -1.5, 2.0};
  EXPECT_EQ(PromptText(PromptFormat::kTextAndState, "turn_on the stove ", state),
            "Task: turn on the stove, State: 12 -1 255;\nAction: ");
  const auto tokenizer = LoadTiny();
  const Prompt prompt =
      MakePrompt(*tokenizer, PromptFormat::kTextAndState, 30, "turn on the stove", state).value();
  // Python: encode("Task: turn on the stove, State: 12 -1 255;\nAction: ", add_bos=True)
  EXPECT_THAT(prompt.ids,
              ElementsAre(2, 338, 384, 260, 375, 314, 270, 262, 291, 391, 358, 384, 363, 383, 379,
                          322, 383, 363, 379, 386, 386, 396, 14, 357, 384, 363, 0, 0, 0, 0));
  EXPECT_EQ(prompt.used, 26);
}

TEST(OpenpiPrompt, CutsWhatDoesNotFitAndSaysHowMuch) {
  const auto tokenizer = LoadTiny();
  const Prompt prompt =
      MakePrompt(*tokenizer, PromptFormat::kText, 5, "put the bowl on the plate", {}).value();
  EXPECT_THAT(prompt.ids, ElementsAre(2, 278, 262, 275, 270));
  EXPECT_EQ(prompt.used, 5);
  EXPECT_EQ(prompt.cut, 3);
}

TEST(OpenpiPrompt, BinsAreThoseOfNumpysDigitize) {
  EXPECT_THAT(StateBins({-1.0, -1.0001, -1e300, 1.0, 1e300, 0.0, -1e-300, 1.0 / 128}),
              ElementsAre(0, -1, -1, 255, 255, 128, 127, 129));
}

TEST(OpenpiPrompt, BinsEqualTheOracles) {
  const std::string path = OracleFile("preprocess.io.safetensors");
  if (path.empty()) GTEST_SKIP() << kNoOracle;
  const SafetensorsFile file = SafetensorsFile::Open(path).value();
  const std::vector<double> state = file.ReadDoubles("inputs/state").value();
  const TensorView expected = file.Get("expected/state_bins").value();
  std::vector<int64_t> bins(expected.num_elements());
  std::memcpy(bins.data(), expected.bytes.data(), expected.bytes.size());
  EXPECT_THAT(StateBins(state), ElementsAreArray(bins));
}

// ---------------------------------------------------------------------------------- normalisation

Normaliser Make(const FieldStats& stats, NormKind kind, NormConvention convention, int64_t dims) {
  auto normaliser = Normaliser::Create("stats.json: 'state'", stats, kind, convention, dims);
  EXPECT_TRUE(normaliser.ok()) << normaliser.status();
  return *std::move(normaliser);
}

Eigen::MatrixXd Read(const SafetensorsFile& file, const std::string& name) {
  const std::vector<double> values = file.ReadDoubles(name).value();
  const std::vector<int64_t> shape = file.Get(name)->shape;
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(values.data(), shape[0], shape[1]);
}

TEST(OpenpiNormalisation, EqualsTheOracles) {
  const std::string path = OracleFile("preprocess.io.safetensors");
  if (path.empty()) GTEST_SKIP() << kNoOracle;
  const SafetensorsFile file = SafetensorsFile::Open(path).value();
  FieldStats stats;
  stats.mean = file.ReadDoubles("inputs/norm.mean").value();
  stats.std = file.ReadDoubles("inputs/norm.std").value();
  stats.q01 = file.ReadDoubles("inputs/norm.q01").value();
  stats.q99 = file.ReadDoubles("inputs/norm.q99").value();
  const Eigen::MatrixXd x = Read(file, "inputs/norm.x"), y = Read(file, "inputs/norm.model_out");
  for (const auto& [kind, name] :
       {std::pair(NormKind::kZScore, "zscore"), std::pair(NormKind::kQuantile, "quantile")}) {
    SCOPED_TRACE(name);
    const Normaliser normaliser = Make(stats, kind, NormConvention::kOpenpi, 8);
    const Eigen::MatrixXd expected = Read(file, absl::StrCat("expected/norm.", name));
    // A dimension without spread divides by 1e-6: compare relatively.
    EXPECT_LT(((normaliser.Normalise(x) - expected).array() / expected.array().abs().max(1.0))
                  .abs()
                  .maxCoeff(),
              1e-12);
    // Ten outputs for eight statistics: the last two are padding. numpy adds 1 to the network's
    // float32 in float32, we in double: half an ulp of 4 times the range.
    EXPECT_LT((normaliser.Unnormalise(y) - Read(file, absl::StrCat("expected/unnorm.", name)))
                  .cwiseAbs()
                  .maxCoeff(),
              kind == NormKind::kQuantile ? 1e-6 : 1e-12);
  }
}

TEST(OpenpiNormalisation, ConventionsDifferInTheirEpsilon) {
  const FieldStats stats = {{2, 5}, {4, 0}, {1, 7}, {3, 7}};
  const Eigen::RowVector2d x(6, 5 + 1e-7);
  const auto z = [&](NormConvention c) { return Make(stats, NormKind::kZScore, c, 2); };
  const auto q = [&](NormConvention c) { return Make(stats, NormKind::kQuantile, c, 2); };
  EXPECT_DOUBLE_EQ(z(NormConvention::kOpenpi).Normalise(x)(0), 4 / (4 + 1e-6));
  EXPECT_DOUBLE_EQ(z(NormConvention::kLerobot).Normalise(x)(0), 4 / (4 + 1e-8));
  EXPECT_DOUBLE_EQ(z(NormConvention::kOpenpi).Unnormalise(x)(0), 6 * (4 + 1e-6) + 2);
  EXPECT_DOUBLE_EQ(z(NormConvention::kLerobot).Unnormalise(x)(0), 26);
  EXPECT_DOUBLE_EQ(q(NormConvention::kOpenpi).Normalise(x)(0), 2 * 5 / (2 + 1e-6) - 1);
  EXPECT_DOUBLE_EQ(q(NormConvention::kLerobot).Normalise(x)(0), 4);
  EXPECT_NEAR(q(NormConvention::kLerobot).Normalise(Eigen::RowVector2d(1, 7 + 1e-8))(1), 1, 1e-6);
  for (const NormConvention convention : {NormConvention::kOpenpi, NormConvention::kLerobot}) {
    EXPECT_LT((q(convention).Unnormalise(q(convention).Normalise(x)) - x).norm(), 1e-9);
  }
}

TEST(OpenpiNormalisation, PadsBeyondTheStatistics) {
  const FieldStats stats = {{2}, {4}, {1}, {3}};
  const Eigen::RowVector2d y(0, 7);
  EXPECT_EQ(Make(stats, NormKind::kQuantile, NormConvention::kOpenpi, 1).Unnormalise(y)(1), 7);
  EXPECT_EQ(Make(stats, NormKind::kZScore, NormConvention::kLerobot, 1).Unnormalise(y)(1), 7);
  EXPECT_DOUBLE_EQ(Make(stats, NormKind::kZScore, NormConvention::kOpenpi, 1).Unnormalise(y)(1),
                   7 * (1 + 1e-6));
  EXPECT_EQ(Normaliser::Identity().Unnormalise(y), y);
  EXPECT_EQ(Normaliser::Identity().Normalise(y), y);
}

TEST(OpenpiNormalisation, ListsEverythingThatIsWrongWithStatistics) {
  const auto message = [](const FieldStats& stats, NormKind kind) {
    return Message(
        Normaliser::Create("stats.json: 'state'", stats, kind, NormConvention::kOpenpi, 3)
            .status());
  };
  EXPECT_THAT(message({{0, 1, NAN}, {1, -2, 1}, {}, {}}, NormKind::kZScore),
              AllOf(HasSubstr("stats.json: 'state'"), HasSubstr("2 problems"),
                    HasSubstr("mean[2] is nan, must be finite"),
                    HasSubstr("std[1] is -2, must be 0 or above")));
  EXPECT_THAT(message({{0, 1}, {1, 1}, {}, {}}, NormKind::kZScore),
              AllOf(HasSubstr("mean has 2 numbers, must have at least 3"), HasSubstr("asset_id")));
  EXPECT_THAT(message({{0, 1, 2}, {1, 1, 1}, {}, {}}, NormKind::kQuantile),
              HasSubstr("q01 or q99 is not recorded, normalisation quantile needs both"));
  EXPECT_THAT(message({{}, {}, {0, 0, 0}, {1, -1, 1}}, NormKind::kQuantile),
              HasSubstr("q99[1] is -1, below q01[1] = 0"));
}

// ------------------------------------------------------------------------------ robots and options

TEST(OpenpiTransforms, DeltaIsRelativeToTheStateAndLeavesTheGripper) {
  Eigen::MatrixXd actions(2, 7);
  actions << 1, 2, 3, 4, 5, 6, 7, 11, 12, 13, 14, 15, 16, 17;
  const Eigen::MatrixXd before = actions;
  const Eigen::VectorXd state = Eigen::VectorXd::LinSpaced(8, 0.5, 4);
  AbsoluteToDelta(state, 6, actions);
  EXPECT_EQ(actions(1, 2), 13 - 1.5);
  EXPECT_EQ(actions.col(6), before.col(6));
  DeltaToAbsolute(state, 6, actions);
  EXPECT_EQ(actions, before);
}

TEST(OpenpiTransforms, AreThoseOfOpenpisConfigurations) {
  const RobotTransform libero = FindRobotTransform("libero").value();
  EXPECT_EQ(libero.state_dim, 8);
  EXPECT_EQ(libero.action_dim, 7);
  EXPECT_TRUE(libero.pi0_delta);    // pi0_libero: extra_delta_transform
  EXPECT_FALSE(libero.pi05_delta);  // pi05_libero: none
  EXPECT_FALSE(libero.pi05_state_in_prompt);
  EXPECT_THAT(libero.cameras, ElementsAre("agentview", "robot0_eye_in_hand", ""));
  const RobotTransform piper = FindRobotTransform("piper").value();
  EXPECT_EQ(piper.delta_dims, 6);  // mask (6, -1)
  EXPECT_EQ(piper.action_dim, 7);
  EXPECT_TRUE(piper.pi0_delta && piper.pi05_delta);
  EXPECT_THAT(Message(FindRobotTransform("droid9").status()),
              AllOf(HasSubstr("droid9"), HasSubstr("plain, libero, piper")));
}

class OpenpiOptions : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) / "policy_options";
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  absl::StatusOr<PolicyOptions> Read(const std::string& yaml,
                                     const std::vector<std::string>& overrides = {}) {
    std::ofstream(folder_ / kPolicyOptionsFile) << yaml;
    return ReadPolicyOptions(folder_.string(), overrides);
  }
  std::filesystem::path folder_;
};

TEST_F(OpenpiOptions, OverridesWinOverTheFile) {
  const auto options = Read("transform: piper\ndelta: false\nhorizon: 10\ncameras: [a, '', b]\n",
                            {"horizon=16", "normalisation=quantile"});
  ASSERT_TRUE(options.ok()) << options.status();
  EXPECT_EQ(options->transform, "piper");
  EXPECT_EQ(options->delta, Setting::kNo);
  EXPECT_EQ(options->horizon, 16);
  EXPECT_EQ(options->normalisation, NormSetting::kQuantile);
  EXPECT_THAT(options->cameras, ElementsAre("a", "", "b"));
  // A weights file has its options beside it.
  EXPECT_EQ(ReadPolicyOptions((folder_ / "model.safetensors").string(), {})->transform, "piper");
}

TEST_F(OpenpiOptions, NameFileKeyAndValueOfWhatIsWrong) {
  EXPECT_THAT(Message(Read("transfrom: piper\n").status()),
              AllOf(HasSubstr(kPolicyOptionsFile), HasSubstr("transfrom")));
  EXPECT_THAT(Message(Read("delta: perhaps\n").status()),
              AllOf(HasSubstr("delta"), HasSubstr("perhaps"), HasSubstr("auto, true, false")));
  EXPECT_THAT(Message(Read("transform: droid9\n").status()), HasSubstr("droid9"));
  EXPECT_THAT(Message(Read("horizon: -3\n").status()), HasSubstr("horizon is -3, must be 0..1024"));
  EXPECT_THAT(Message(Read("cameras: [a]\n").status()), HasSubstr("cameras has 1 names"));
  EXPECT_THAT(Message(Read("", {"eulers=3"}).status()), HasSubstr("eulers"));
}

}  // namespace
}  // namespace robostress::openpi
