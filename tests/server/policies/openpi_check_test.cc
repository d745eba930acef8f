// policy check: the oracle's files where they are, and files of our own, whole and broken.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <cstdio>
#include <fstream>
#include <set>

#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/policy_check.h"
#include "server/policies/openpi/quantities.h"
#include "tests/oracle_file.h"
#include "tests/run_program.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress::openpi {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

// One run over the oracle's files: suffixes of weights, expected values and adapter.
struct OracleRun {
  std::string name, weights, io, lora;
};

class Oracle : public ::testing::TestWithParam<OracleRun> {};

INSTANTIATE_TEST_SUITE_P(
    Public, Oracle,
    ::testing::Values(OracleRun{"public_pi0", "weights", "io", ""},
                      OracleRun{"public_pi0", "weights", "io", "lora"},
                      OracleRun{"public_pi0", "weights_bf16", "io_bf16w", ""},
                      OracleRun{"public_pi05", "weights", "io", ""},
                      OracleRun{"public_pi05", "weights", "io", "lora"},
                      OracleRun{"public_pi05", "weights_bf16", "io_bf16w", ""}),
    [](const auto& info) { return info.param.name + "_" + info.param.io + info.param.lora; });

TEST_P(Oracle, EveryQuantityIsWithinItsTolerance) {
  const auto file = [](const std::string& kind) {
    return kind.empty() ? "" : OracleFile(GetParam().name + "." + kind + ".safetensors");
  };
  if (file(GetParam().weights).empty()) GTEST_SKIP() << kNoOracle;
  const auto report = CheckPolicy({.weights = file(GetParam().weights),
                                   .io = file(GetParam().io),
                                   .lora = file(GetParam().lora)});
  ASSERT_TRUE(report.ok()) << report.status();
  std::set<std::string> seen;
  for (const QuantityResult& result : report->results) {
    EXPECT_TRUE(result.passed) << result.name << " " << result.error << " " << result.tolerance;
    seen.insert(result.name);
  }
  const auto expected =
      SafetensorsFile::Open(file(GetParam().lora.empty() ? GetParam().io : "lora"));
  ASSERT_TRUE(expected.ok());
  for (const auto& [name, view] : expected->tensors()) {
    if (name.starts_with("expected/")) {
      EXPECT_TRUE(seen.contains(name.substr(9))) << name;
    }
  }
}

// Files of our own, whose expected values are what the network gives.
class OwnFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    Quantities quantities(model_, inputs_, {"action_in_proj.weight"}, 10);
    for (const char* name : {"actions", "v_t0.5", "loss.v_t", "loss.mean", "prefix.pad_mask",
                             "kv.1.value", "grad/action_in_proj.weight"}) {
      const auto value = quantities.Compute(name);
      ASSERT_TRUE(value.ok() && value->defined()) << name;
      io_[std::string("expected/") + name] = value->clone();
    }
  }

  // Writes the tensors as they are now and checks them.
  absl::StatusOr<CheckReport> Check() {
    options_.weights = WriteTensors("own.weights.safetensors", weights_, weights_metadata_);
    options_.io = WriteTensors("own.io.safetensors", io_, io_metadata_);
    if (!lora_.empty())
      options_.lora = WriteTensors("own.lora.safetensors", lora_, {{"scale", "2.0"}});
    return CheckPolicy(options_);
  }
  std::string Error() {
    const auto report = Check();
    return report.ok() ? "(passed)" : std::string(report.status().message());
  }
  std::vector<std::string> Failures() {
    const auto report = Check();
    EXPECT_TRUE(report.ok()) << report.status();
    std::vector<std::string> names;
    for (const QuantityResult& result : report.ok() ? report->results : CheckReport().results) {
      if (!result.passed) names.push_back(result.name);
    }
    return names;
  }

  OpenpiConfig config_ = TinyConfig(true);
  OpenpiModel model_ = RandomOpenpiModel(config_, 5);
  OracleInputs inputs_ = RandomInputs(config_, 2, 2, true, 7);
  TensorMap weights_ = WeightTensors(model_), io_ = InputTensors(inputs_), lora_;
  std::map<std::string, std::string> weights_metadata_ = {{"config", ConfigJson(config_)}};
  std::map<std::string, std::string> io_metadata_ = weights_metadata_;
  CheckOptions options_;
};

TEST_F(OwnFiles, Pass) { EXPECT_THAT(Failures(), ::testing::IsEmpty()); }

TEST_F(OwnFiles, InputsMayLieInAnotherFile) {
  options_.inputs = WriteTensors("other.safetensors", InputTensors(inputs_), {});
  for (const auto& [name, tensor] : InputTensors(inputs_)) io_.erase(name);
  EXPECT_THAT(Failures(), ::testing::IsEmpty());
}

TEST_F(OwnFiles, EmbeddingMayGoByEitherNameOrBoth) {
  weights_[kTiedHeadName] = weights_[kEmbeddingName].clone();
  EXPECT_THAT(Failures(), ::testing::IsEmpty());
  weights_.erase(kEmbeddingName);
  EXPECT_THAT(Failures(), ::testing::IsEmpty());
  weights_[kEmbeddingName] = weights_[kTiedHeadName] + 1;
  EXPECT_THAT(Error(), AllOf(HasSubstr(kTiedHeadName), HasSubstr("different bytes")));
  weights_.erase(kEmbeddingName);
  weights_.erase(kTiedHeadName);
  EXPECT_THAT(Error(), HasSubstr(absl::StrCat("missing: ", kEmbeddingName, " [31, 28]")));
}

TEST_F(OwnFiles, TiedEmbeddingHasOneGradient) {
  Quantities quantities(model_, inputs_, {kEmbeddingName}, 10);
  const torch::Tensor gradient = *quantities.Compute(absl::StrCat("grad/", kEmbeddingName));
  io_[absl::StrCat("expected/grad/", kEmbeddingName)] = gradient;
  io_[absl::StrCat("expected/grad/", kTiedHeadName)] = gradient;
  EXPECT_GT(gradient.abs().max().item<double>(), 1e-5);
  EXPECT_THAT(Failures(), ::testing::IsEmpty());
}

TEST_F(OwnFiles, WidenHalfPrecision) {
  for (const auto type : {torch::kBFloat16, torch::kFloat16}) {
    OpenpiModel rounded = model_;
    struct Round : ParameterVisitor {
      void OnTensor(const std::string&, const std::vector<int64_t>&, torch::Tensor& t) override {
        t = t.to(type).to(torch::kFloat32);
      }
      c10::ScalarType type;
    } round;
    round.type = type;
    VisitParameters(config_, rounded.weights, round);
    for (auto& [name, tensor] : weights_) tensor = tensor.to(type);
    Quantities quantities(rounded, inputs_, {}, 10);
    io_ = InputTensors(inputs_);
    io_["expected/actions"] = *quantities.Compute("actions");
    EXPECT_THAT(Failures(), ::testing::IsEmpty());
    weights_ = WeightTensors(model_);
  }
}

TEST_F(OwnFiles, DeviationsNanAndUnknownQuantitiesFail) {
  io_["expected/actions"][1][2][3] += 2e-4;
  io_["expected/v_t0.5"][0][0][0] = NAN;
  io_["expected/prefix.pad_mask"][0][0] = true;
  io_["expected/prefix.colour"] = at::ones({2});
  io_["expected/grad/no_such.weight"] = at::ones({2});
  io_["expected/kv.3.key"] = at::ones({2});
  EXPECT_THAT(Failures(), ::testing::UnorderedElementsAre(
                              "actions", "v_t0.5", "v_t0.5 (joint pass)", "prefix.pad_mask",
                              "prefix.colour", "grad/no_such.weight", "kv.3.key"));
}

TEST_F(OwnFiles, AllMisfittingTensorsAreNamedAtOnce) {
  weights_.erase("action_in_proj.bias");
  weights_["time_mlp_in.weight"] = at::zeros({3, 3});
  weights_["state_proj.weight"] = at::zeros({16, 10});
  weights_["action_out_proj.bias"] = at::zeros({10}, torch::kInt64);
  EXPECT_THAT(Error(),
              AllOf(HasSubstr("own.weights.safetensors"), HasSubstr("4 problems"),
                    HasSubstr("missing: action_in_proj.bias [16]"),
                    HasSubstr("misshaped: time_mlp_in.weight is [3, 3], the configuration asks "
                              "for [16, 16]"),
                    HasSubstr("unexpected: state_proj.weight [16, 10]"),
                    HasSubstr("action_out_proj.bias is I64")));
}

TEST_F(OwnFiles, WeightsThatAreNotFiniteAreRefused) {
  weights_["action_in_proj.bias"] = weights_["action_in_proj.bias"].clone();
  weights_["action_in_proj.bias"][3] = INFINITY;
  EXPECT_THAT(Error(), AllOf(HasSubstr("action_in_proj.bias"), HasSubstr("holds inf at index 3")));
}

TEST_F(OwnFiles, FilesOfAnotherNetworkAreRefusedWithTheSizesThatDiffer) {
  OpenpiConfig other = config_;
  other.horizon = 9;
  other.pi05 = false;
  io_metadata_["config"] = ConfigJson(other);
  EXPECT_THAT(Error(), AllOf(HasSubstr("own.io.safetensors"), HasSubstr("horizon 9 instead of 7"),
                             HasSubstr("model pi0 instead of pi0.5")));
}

TEST_F(OwnFiles, InputsThatDoNotFitAreNamedAtOnce) {
  io_.erase("inputs/image_mask.base_0_rgb");
  io_["inputs/noise"] = at::zeros({2, 8, 10});
  io_["inputs/tokens"][1][2] = 31;
  io_["inputs/token_mask"] = at::zeros({3, 11}, torch::kBool);
  io_["inputs/loss.time"][1] = NAN;
  EXPECT_THAT(Error(), AllOf(HasSubstr("own.io.safetensors"), HasSubstr("5 problems"),
                             HasSubstr("inputs/image_mask.base_0_rgb is missing, must be [2]"),
                             HasSubstr("inputs/noise has shape [2, 8, 10], must be [2, 7, 10]"),
                             HasSubstr("inputs/tokens holds 31, must be in 0..30"),
                             HasSubstr("inputs/token_mask has shape [3, 11], must be [2, 11]"),
                             HasSubstr("inputs/loss.time' holds nan at index 1")));
}

TEST_F(OwnFiles, ExpectedValuesOfAnotherShapeAreRefused) {
  io_["expected/actions"] = at::zeros({2, 6, 10});
  EXPECT_THAT(Error(), AllOf(HasSubstr("expected/actions"), HasSubstr("[2, 6, 10]"),
                             HasSubstr("[2, 7, 10]")));
}

TEST_F(OwnFiles, SwappedAndEmptyFilesAreRefused) {
  std::swap(weights_, io_);
  EXPECT_THAT(Error(), HasSubstr("give a file with expected values"));
  std::swap(weights_, io_);
  io_ = InputTensors(inputs_);
  EXPECT_THAT(Error(), HasSubstr("holds no expected/*"));
  io_ = {{"expected/actions", at::zeros({2, 7, 10})}};
  options_.inputs = "";
  EXPECT_THAT(Error(), HasSubstr("--inputs"));
  weights_ = {{"some.weight", at::zeros({2})}};
  EXPECT_THAT(Error(), HasSubstr("holds none of the tensors of a pi0.5 network"));
}

TEST_F(OwnFiles, HostileSizesAreRefusedBeforeMemoryIsTaken) {
  const auto with = [&](const std::string& key, int64_t value) {
    nlohmann::json json = nlohmann::json::parse(ConfigJson(config_));
    json[key] = value;
    weights_metadata_["config"] = io_metadata_["config"] = json.dump();
    return Error();
  };
  // 2^24 rows of 28 floats would be 1.9 GB, an MLP of 2^18 a hundred layers deep more.
  EXPECT_THAT(with("vocab", 1 << 24), HasSubstr("misshaped"));
  EXPECT_THAT(with("pm", 1 << 18), HasSubstr("misshaped"));
  EXPECT_THAT(with("depth", 1'000'000'000), HasSubstr("depth is 1000000000, must be"));
  EXPECT_THAT(with("hd", -8), HasSubstr("hd is -8"));
  EXPECT_THAT(with("kv_heads", 4), HasSubstr("heads 6 is no multiple of kv_heads 4"));
  EXPECT_THAT(with("patch", 16), HasSubstr("patch 16 exceeds image 15"));
  weights_metadata_["config"] = R"({"pi05": 1, "image": "wide"})";
  EXPECT_THAT(Error(), AllOf(HasSubstr("pi05 must be true or false"), HasSubstr("vw is missing"),
                             HasSubstr("image is \"wide\"")));
  weights_metadata_.clear();
  EXPECT_THAT(Error(), HasSubstr("metadata has no 'config'"));
}

TEST_F(OwnFiles, APromptThatWouldFillMemoryIsRefused) {
  config_.prompt_tokens = 30000;  // 2 rows of 6 heads over 9e8 pairs
  weights_metadata_["config"] = io_metadata_["config"] = ConfigJson(config_);
  io_["inputs/tokens"] = at::zeros({2, 30000}, torch::kInt64);
  io_["inputs/token_mask"] = at::zeros({2, 30000}, torch::kBool);
  EXPECT_THAT(Error(), HasSubstr("attention matrices"));
}

TEST_F(OwnFiles, AdaptersAreAppliedWithTheirScale) {
  OpenpiLora lora;
  lora.scale = 2;
  const std::string layer = "paligemma_with_expert.gemma_expert.model.layers.1.mlp.up_proj";
  lora.pairs[layer] = {at::randn({5, 16}), at::randn({24, 5})};
  const std::string a = layer + ".lora_A.weight", b = layer + ".lora_B.weight";
  Quantities quantities(WithLora(model_, lora), inputs_, {a, b}, 10);
  for (const std::string& name : {std::string("actions"), "grad/" + a, "grad/" + b})
    lora_["expected/" + name] = quantities.Compute(name)->clone();
  lora_["lora/" + a] = lora.pairs[layer].A;
  lora_["lora/" + b] = lora.pairs[layer].B;
  EXPECT_THAT(Failures(), ::testing::IsEmpty());
  EXPECT_GT((lora_["expected/actions"] - io_["expected/actions"]).abs().max().item<double>(), 1e-2);

  lora_["lora/" + b] = at::zeros({24, 4});
  lora_["lora/action_in_proj.lora_A.weight"] = at::zeros({5, 10});
  lora_["lora/state_proj.lora_A.weight"] = at::zeros({5, 10});
  EXPECT_THAT(Error(), AllOf(HasSubstr("own.lora.safetensors"), HasSubstr("3 problems"),
                             HasSubstr("A [5, 16] and B [24, 4]"),
                             HasSubstr("missing: lora/action_in_proj.lora_B.weight"),
                             HasSubstr("lora/state_proj is no linear layer")));
}

std::pair<std::string, int> RunPolicy(const std::string& arguments) {
  return RunProgram(POLICY_PROGRAM, arguments);
}

TEST_F(OwnFiles, TheProgramTellsFailuresFromBadInput) {
  ASSERT_TRUE(Check().ok());
  const std::string files = absl::StrCat("--weights ", options_.weights, " --io ", options_.io);
  const auto [passed, passed_code] = RunPolicy("check " + files);
  EXPECT_EQ(passed_code, 0) << passed;
  EXPECT_THAT(passed, AllOf(HasSubstr("actions"), HasSubstr("all within tolerance")));

  io_["expected/actions"] = io_["expected/actions"] + 1;
  ASSERT_TRUE(Check().ok());
  const auto [failed, failed_code] = RunPolicy("check --json " + files);
  EXPECT_EQ(failed_code, 1);
  const nlohmann::json json = nlohmann::json::parse(failed);
  EXPECT_EQ(json["passed"], false);
  EXPECT_EQ(json["num_failed"], 1);
  EXPECT_EQ(json["quantities"].size(), 9u);  // v_t0.5 and loss.v_t by both passes

  const auto [help, help_code] = RunPolicy("check --help");
  EXPECT_EQ(help_code, 0);
  EXPECT_THAT(help, HasSubstr("Examples:"));
  EXPECT_EQ(RunPolicy("check --weights x").second, 2);
  EXPECT_EQ(RunPolicy("").second, 2);
}

TEST_F(OwnFiles, TheProgramNamesTruncatedForeignAndMissingFiles) {
  ASSERT_TRUE(Check().ok());
  const std::string io = " --io " + options_.io;
  std::filesystem::resize_file(options_.weights, std::filesystem::file_size(options_.weights) - 9);
  const auto [truncated, truncated_code] = RunPolicy("check --weights " + options_.weights + io);
  EXPECT_EQ(truncated_code, 2);
  EXPECT_THAT(truncated, AllOf(HasSubstr(options_.weights), HasSubstr("may be truncated")));
  std::ofstream(options_.weights) << "not a weights file at all";
  const auto [foreign, foreign_code] = RunPolicy("check --weights " + options_.weights + io);
  EXPECT_EQ(foreign_code, 2);
  EXPECT_THAT(foreign, HasSubstr("not a usable safetensors file"));
  const auto [missing, missing_code] = RunPolicy("check --json --weights absent.safetensors" + io);
  EXPECT_EQ(missing_code, 2);
  EXPECT_THAT(missing, AllOf(HasSubstr("absent.safetensors"), HasSubstr("\"passed\": false")));
}

}  // namespace
}  // namespace robostress::openpi
