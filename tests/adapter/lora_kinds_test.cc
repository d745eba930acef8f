// The two ways of factoring an adapter, and adapters in PEFT's form.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "adapter/peft.h"
#include "common/safetensors.h"
#include "nlohmann/json.hpp"
#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// q (outputs by head), o (inputs by head), and one without heads.
const std::vector<LoraTarget> kTargets = {
    {"q_proj", 10, 12, 3}, {"o_proj", 12, 10, 1, 3}, {"up_proj", 10, 7}};

LoraWeights RandomLora(LoraKind kind, uint64_t seed, int64_t rank = 2) {
  torch::manual_seed(static_cast<int64_t>(seed));
  LoraWeights lora;
  for (const LoraTarget& target : kTargets) {
    const LoraShape shape = LoraShapeOf(target, kind, rank);
    lora.A.push_back(torch::randn(shape.A));
    lora.B.push_back(torch::randn(shape.B));
  }
  return lora;
}

double MaxDifference(const torch::Tensor& a, const torch::Tensor& b) {
  return (a - b).abs().max().item<double>();
}

TEST(LoraKinds, PerMatrixIsPlainLoraBitForBit) {
  // The draws and products of before there were two kinds, written out.
  const LoraWeights lora =
      InitialLora(kTargets, LoraKind::kPerMatrix, 4, 0.01, StreamKey("session"));
  RandomStream stream(StreamKey("session").With("lora_init").With("q_proj"));
  const auto draws = lora.A[0].accessor<float, 2>();
  for (int r = 0; r < 4; ++r) {
    for (int i = 0; i < 10; ++i) ASSERT_EQ(draws[r][i], static_cast<float>(0.01 * stream.Normal()));
  }
  const LoraWeights some = RandomLora(LoraKind::kPerMatrix, 1);
  const torch::Tensor x = torch::randn({2, 5, 10});
  EXPECT_TRUE(BitEqual(LoraDelta(x, some.A[0], some.B[0]),
                       torch::linear(torch::linear(x, some.A[0]), some.B[0])));
}

TEST(LoraKinds, PerHeadIsOpenpisEinsum) {
  const LoraWeights lora = RandomLora(LoraKind::kPerHead, 2);
  EXPECT_EQ(lora.A[0].sizes(), (std::vector<int64_t>{3, 2, 10}));
  EXPECT_EQ(lora.B[0].sizes(), (std::vector<int64_t>{3, 4, 2}));
  EXPECT_EQ(lora.A[1].sizes(), (std::vector<int64_t>{3, 2, 4}));
  EXPECT_EQ(lora.B[1].sizes(), (std::vector<int64_t>{3, 10, 2}));
  EXPECT_EQ(lora.A[2].dim(), 2);  // no heads: a matrix in both ways
  const torch::Tensor x = torch::randn({2, 5, 10});
  // q: "BTD,NDL->BTNL", "BTNL,NLH->BTNH" with A and B transposed as JAX stores them.
  const torch::Tensor q =
      at::einsum("btd,nld,nhl->btnh", {x, lora.A[0], lora.B[0]}).reshape({2, 5, 12});
  EXPECT_LT(MaxDifference(LoraDelta(x, lora.A[0], lora.B[0]), q), 1e-5);
  // o: "BTNH,NHL->BTNL", then the sum over heads.
  const torch::Tensor attended = torch::randn({2, 5, 12});
  const torch::Tensor o =
      at::einsum("btnh,nlh,ndl->btd", {attended.view({2, 5, 3, 4}), lora.A[1], lora.B[1]});
  EXPECT_LT(MaxDifference(LoraDelta(attended, lora.A[1], lora.B[1]), o), 1e-5);
}

TEST(LoraKinds, OneLayerOfPi0HasTheCountsOfBothFactorisations) {
  const std::vector<LoraTarget> layer = {
      {"q", 1024, 2048, 8}, {"k", 1024, 256},   {"v", 1024, 256},    {"o", 2048, 1024, 1, 8},
      {"gate", 1024, 4096}, {"up", 1024, 4096}, {"down", 4096, 1024}};
  EXPECT_EQ(NumLoraParameters(layer, LoraKind::kPerHead, 4), 153600);
  EXPECT_EQ(NumLoraParameters(layer, LoraKind::kPerMatrix, 4), 96256);
}

TEST(LoraKinds, BothStartWithoutEffectAndWithTheSameDrawsWhereNoHeadsAre) {
  for (const LoraKind kind : {LoraKind::kPerHead, LoraKind::kPerMatrix}) {
    const LoraWeights lora = InitialLora(kTargets, kind, 4, 0.01, StreamKey("s"));
    EXPECT_EQ(NumParameters(lora), NumLoraParameters(kTargets, kind, 4));
    for (size_t i = 0; i < kTargets.size(); ++i) {
      const torch::Tensor y =
          LoraDelta(torch::randn({3, kTargets[i].in_features}), lora.A[i], lora.B[i]);
      EXPECT_EQ(y.abs().max().item<float>(), 0) << kTargets[i].name;
      EXPECT_GT(lora.A[i].std().item<float>(), 0.005);
    }
  }
  EXPECT_TRUE(BitEqual(InitialLora(kTargets, LoraKind::kPerHead, 4, 0.01, StreamKey("s")).A[2],
                       InitialLora(kTargets, LoraKind::kPerMatrix, 4, 0.01, StreamKey("s")).A[2]));
}

TEST(LoraKinds, ThePairOfMatricesHasTheSameProduct) {
  const LoraWeights lora = RandomLora(LoraKind::kPerHead, 3);
  for (size_t i = 0; i < kTargets.size(); ++i) {
    const MatrixPair pair = AsMatrices(kTargets[i], lora.A[i], lora.B[i]);
    EXPECT_EQ(pair.A.dim(), 2);
    const torch::Tensor x = torch::randn({4, kTargets[i].in_features});
    EXPECT_LT(MaxDifference(LoraDelta(x, pair.A, pair.B), LoraDelta(x, lora.A[i], lora.B[i])),
              1e-5);
  }
}

TEST(LoraKinds, GradientsPerHeadAreThoseOfTheProduct) {
  for (size_t i = 0; i < kTargets.size(); ++i) {
    const LoraWeights lora = RandomLora(LoraKind::kPerHead, 4);
    const torch::Tensor x = torch::randn({6, kTargets[i].in_features});
    std::vector<torch::Tensor> leaves = {lora.A[i].requires_grad_(), lora.B[i].requires_grad_()};
    const torch::Tensor weight = torch::randn({6, kTargets[i].out_features});
    const auto direct =
        torch::autograd::grad({(LoraDelta(x, leaves[0], leaves[1]) * weight).sum()}, leaves);
    const MatrixPair pair = AsMatrices(kTargets[i], leaves[0], leaves[1]);
    const auto merged = torch::autograd::grad(
        {(torch::linear(x, torch::matmul(pair.B, pair.A)) * weight).sum()}, leaves);
    for (int j = 0; j < 2; ++j) EXPECT_LT(MaxDifference(direct[j], merged[j]), 1e-4) << i;
  }
}

TEST(LoraRows, ARowGetsItsOwnAdapterWhateverItsKindAndRank) {
  const LoraWeights a = RandomLora(LoraKind::kPerHead, 5), b = RandomLora(LoraKind::kPerMatrix, 6),
                    c = RandomLora(LoraKind::kPerMatrix, 7, 5);
  const std::vector<const LoraWeights*> rows = {&a, nullptr, &b, &c};
  const LoraRows stacked = StackLora(kTargets, rows);
  for (size_t i = 0; i < kTargets.size(); ++i) {
    const torch::Tensor x = torch::randn({4, 3, kTargets[i].in_features});
    const torch::Tensor y = LoraRowsDelta(x, stacked.A[i], stacked.B[i]);
    for (int64_t row = 0; row < 4; ++row) {
      if (rows[row] == nullptr) {
        EXPECT_EQ(y[row].abs().max().item<float>(), 0);
      } else {
        EXPECT_LT(MaxDifference(y[row], LoraDelta(x[row], rows[row]->A[i], rows[row]->B[i])), 1e-5);
      }
    }
  }
}

TEST(Peft, BothKindsSurviveTheFilesBitForBit) {
  for (const LoraKind kind : {LoraKind::kPerHead, LoraKind::kPerMatrix}) {
    const LoraWeights lora = RandomLora(kind, 8);
    const auto files = ToPeft(kTargets, "expert.", lora);
    ASSERT_TRUE(files.ok()) << files.status();
    const auto back = FromPeft("folder", *files, kTargets, "expert.", kind);
    ASSERT_TRUE(back.ok()) << back.status();
    EXPECT_TRUE(BitEqual(*back, lora));
  }
}

TEST(Peft, WritesPeftsNamesAndSettings) {
  const auto files = ToPeft(kTargets, "expert.", RandomLora(LoraKind::kPerHead, 9));
  const auto file = SafetensorsFile::Parse("f", files->safetensors);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->tensors().at("base_model.model.expert.q_proj.lora_A.weight").shape,
            (std::vector<int64_t>{6, 10}));
  EXPECT_EQ(file->tensors().at("base_model.model.expert.q_proj.lora_B.weight").shape,
            (std::vector<int64_t>{12, 6}));
  const auto config = nlohmann::json::parse(files->config_json);
  EXPECT_EQ(config["peft_type"], "LORA");
  EXPECT_EQ(config["r"], 2);
  EXPECT_EQ(config["lora_alpha"], 2);
  EXPECT_EQ(config["rank_pattern"]["expert.q_proj"], 6);
  EXPECT_EQ(config["alpha_pattern"]["expert.q_proj"], 6);
  EXPECT_FALSE(config["rank_pattern"].contains("expert.up_proj"));
}

// A file in PEFT's form as another program would write it.
PeftFiles Foreign(const std::function<void(nlohmann::json&)>& change,
                  const std::string& root = "base_model.model.") {
  PeftFiles files = *ToPeft(kTargets, "", RandomLora(LoraKind::kPerMatrix, 10));
  nlohmann::json config = nlohmann::json::parse(files.config_json);
  change(config);
  files.config_json = config.dump();
  const auto file = SafetensorsFile::Parse("f", files.safetensors);
  SafetensorsWriter writer;
  for (const auto& [name, view] : file->tensors()) {
    writer.Add(root + name.substr(std::string("base_model.model.").size()), view.dtype, view.shape,
               view.bytes.data(), view.bytes.size());
  }
  files.safetensors = *writer.Serialize();
  return files;
}

TEST(Peft, MultipliesTheScaleIntoB) {
  const LoraWeights original = RandomLora(LoraKind::kPerMatrix, 10);
  const auto scaled = [&](const std::function<void(nlohmann::json&)>& change) {
    const auto lora = FromPeft("f", Foreign(change), kTargets, "", LoraKind::kPerMatrix);
    EXPECT_TRUE(lora.ok()) << lora.status();
    return (lora->B[0] / original.B[0]).mean().item<double>();
  };
  EXPECT_NEAR(scaled([](nlohmann::json& c) { c["lora_alpha"] = 16; }), 8, 1e-5);
  EXPECT_NEAR(scaled([](nlohmann::json& c) { c["lora_alpha"] = 2, c["use_rslora"] = true; }),
              std::sqrt(2.0), 1e-5);
  EXPECT_NEAR(scaled([](nlohmann::json& c) { c["alpha_pattern"]["q_proj"] = 6; }), 3, 1e-5);
}

TEST(Peft, AcceptsTheNamesOfAPolicyThatWrapsTheNetwork) {
  const auto lora = FromPeft("f", Foreign([](nlohmann::json&) {}, "base_model.model.model."),
                             kTargets, "", LoraKind::kPerMatrix);
  ASSERT_TRUE(lora.ok()) << lora.status();
  EXPECT_TRUE(BitEqual(*lora, RandomLora(LoraKind::kPerMatrix, 10)));
}

TEST(Peft, RefusesWhatIsNotPlainLora) {
  const auto message = [](const std::function<void(nlohmann::json&)>& change, LoraKind kind) {
    const auto lora = FromPeft("folder", Foreign(change), kTargets, "", kind);
    EXPECT_FALSE(lora.ok());
    return std::string(lora.status().message());
  };
  constexpr LoraKind kMatrix = LoraKind::kPerMatrix;
  EXPECT_THAT(message([](nlohmann::json& c) { c["use_dora"] = true, c["bias"] = "all"; }, kMatrix),
              AllOf(HasSubstr("use_dora is true"), HasSubstr("bias is \"all\"")));
  EXPECT_THAT(message([](nlohmann::json& c) { c["r"] = 0; }, kMatrix), HasSubstr("r is 0"));
  EXPECT_THAT(message([](nlohmann::json& c) { c["r"] = 3; }, kMatrix),
              HasSubstr("must be [3, 10] and [12, 3]"));
  EXPECT_THAT(message([](nlohmann::json& c) { c["alpha_pattern"][".*q"] = 3; }, kMatrix),
              HasSubstr("regular expression"));
  EXPECT_THAT(message([](nlohmann::json& c) { c = 3; }, kMatrix), HasSubstr("not a JSON object"));
  EXPECT_THAT(message([](nlohmann::json&) {}, LoraKind::kPerHead),
              HasSubstr("import it as per_matrix"));
}

TEST(Peft, RefusesMissingUnexpectedAndUnequalModulesAtOnce) {
  const std::vector<LoraTarget> others = {kTargets[0], {"gate_proj", 10, 7}};
  const auto lora =
      FromPeft("folder", Foreign([](nlohmann::json&) {}), others, "", LoraKind::kPerMatrix);
  EXPECT_THAT(std::string(lora.status().message()),
              AllOf(HasSubstr("missing: base_model.model.gate_proj.lora_A.weight"),
                    HasSubstr("unexpected: base_model.model.up_proj.lora_B.weight")));
  const auto per_head = ToPeft(kTargets, "", RandomLora(LoraKind::kPerHead, 11));
  EXPECT_THAT(
      std::string(
          FromPeft("folder", *per_head, kTargets, "", LoraKind::kPerMatrix).status().message()),
      HasSubstr("import it as per_head"));
}

}  // namespace
}  // namespace robostress
