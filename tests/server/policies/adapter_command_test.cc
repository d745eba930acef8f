// robostress policy adapter, run as a user runs it, on nano's weights and on openpi's.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "adapter/adaptation_state.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"
#include "server/policies/adapters/adapter_base.h"
#include "server/policies/openpi/checkpoint_load.h"
#include "server/policies/openpi/openpi_lora.h"
#include "tests/run_program.h"
#include "tests/server/policies/tiny_nano.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string Temp(const std::string& name) {
  return (std::filesystem::path(testing::TempDir()) /
          ("adapter_command_test_" + std::to_string(getpid()) + "_" + name))
      .string();
}

std::pair<std::string, int> RunAdapter(const std::string& arguments) {
  return RunProgram(POLICY_PROGRAM, "adapter " + arguments);
}

// An adapter file of some updates' size for a weights file.
std::string WriteAdapter(const std::string& name, const AdapterBase& base, LoraKind kind) {
  torch::manual_seed(12);
  AdaptationState state;
  for (const LoraTarget& target : base.targets) {
    const LoraShape shape = LoraShapeOf(target, kind, 4);
    state.lora.phi.A.push_back(torch::randn(shape.A) * 0.2);
    state.lora.phi.B.push_back(torch::randn(shape.B) * 0.2);
    state.lora.phi_0.A.push_back(state.lora.phi.A.back());
    state.lora.phi_0.B.push_back(torch::zeros(shape.B));
  }
  state.lora.phi.version = 5;
  state.lora.adam = InitialAdamState(Parameters(state.lora.phi));
  state.policy = "nano";
  state.model_hash = base.model_hash;
  state.method = "ours";
  state.lora_kind = kind;
  state.session = "suite/scenario/5/nano/ours/0";
  const std::string path = Temp(name);
  EXPECT_TRUE(WriteFileAtomically(path, *SerializeAdaptationState(state, base.targets)).ok());
  return path;
}

LoraWeights ReadPhi(const std::string& path, const AdapterBase& base) {
  const auto state = ParseAdapter(path, *ReadFile(path), base.targets, base.model_hash);
  EXPECT_TRUE(state.ok()) << state.status();
  return state->lora.phi;
}

class AdapterCommandTest : public ::testing::TestWithParam<LoraKind> {
 protected:
  void SetUp() override {
    nano_ = Temp("nano.safetensors");
    ASSERT_TRUE(SaveNanoModel(TinyModel(), nano_).ok());
    const auto base = OpenAdapterBase(nano_);
    ASSERT_TRUE(base.ok()) << base.status();
    base_ = *base;
    adapter_ = WriteAdapter("adapter.safetensors", base_, GetParam());
  }
  std::string nano_, adapter_;
  AdapterBase base_;
};
INSTANTIATE_TEST_SUITE_P(Kinds, AdapterCommandTest,
                         ::testing::Values(LoraKind::kPerHead, LoraKind::kPerMatrix));

TEST_P(AdapterCommandTest, ShowsWhatAFileHolds) {
  const auto [output, code] = RunAdapter("show --json " + adapter_);
  ASSERT_EQ(code, 0) << output;
  const auto facts = nlohmann::json::parse(output);
  const LoraWeights phi = ReadPhi(adapter_, base_);
  EXPECT_EQ(facts["lora"], LoraKindName(GetParam()));
  EXPECT_EQ(facts["version"], "5");
  EXPECT_EQ(facts["method"], "ours");
  EXPECT_EQ(facts["rank"], 4);
  EXPECT_EQ(facts["parameters"], NumParameters(phi));
  double squares = 0;
  for (const torch::Tensor& B : phi.B) squares += B.square().sum().item<double>();
  EXPECT_NEAR(facts["distance"].get<double>(), std::sqrt(squares), 1e-4);
}

TEST_P(AdapterCommandTest, ExportedAndImportedItIsTheSameAdapter) {
  const std::string folder = Temp("peft"), back = Temp("back.safetensors");
  const auto [exported, export_code] =
      RunAdapter("export --adapter " + adapter_ + " --weights " + nano_ + " --out " + folder);
  ASSERT_EQ(export_code, 0) << exported;
  const auto [imported, import_code] =
      RunAdapter("import --peft " + folder + " --weights " + nano_ + " --lora " +
                 LoraKindName(GetParam()) + " --out " + back);
  ASSERT_EQ(import_code, 0) << imported;
  const LoraWeights before = ReadPhi(adapter_, base_), after = ReadPhi(back, base_);
  for (size_t i = 0; i < before.A.size(); ++i) {
    EXPECT_TRUE(before.A[i].equal(after.A[i]));
    EXPECT_TRUE(before.B[i].equal(after.B[i]));
  }
  EXPECT_EQ(after.version, 1u);
}

TEST_P(AdapterCommandTest, MergedNanoPredictsWhatTheAdaptedOneDoes) {
  const std::string merged = Temp("merged.safetensors");
  const auto [output, code] =
      RunAdapter("merge --adapter " + adapter_ + " --weights " + nano_ + " --out " + merged);
  ASSERT_EQ(code, 0) << output;
  const auto base = LoadFlowPolicy(nano_).value(), sum = LoadFlowPolicy(merged).value();
  const PolicyContext context = base->Encode(TinyObservation(base->spec())).value();
  const torch::Tensor noise = torch::randn({1, 10, 8});
  const LoraWeights phi = ReadPhi(adapter_, base_);
  const torch::Tensor adapted = base->Sample(context, noise, &phi);
  EXPECT_TRUE(torch::allclose(sum->Sample(context, noise, nullptr), adapted, 1e-4, 1e-4));
  EXPECT_FALSE(torch::allclose(base->Sample(context, noise, nullptr), adapted, 1e-2, 1e-2));
}

TEST_P(AdapterCommandTest, MergedOpenpiHasTheVelocityOfTheAdaptedOne) {
  torch::NoGradGuard no_grad;
  const openpi::OpenpiConfig config = openpi::TinyConfig(false);
  const openpi::OpenpiModel model = openpi::RandomOpenpiModel(config, 5);
  const std::string weights = openpi::WriteTensors(
      "adapter_command_test_" + std::to_string(getpid()) + "_openpi.safetensors",
      openpi::WeightTensors(model), {{"config", openpi::ConfigJson(config)}});
  const auto base = OpenAdapterBase(weights);
  ASSERT_TRUE(base.ok()) << base.status();
  const std::string adapter = WriteAdapter("openpi_adapter.safetensors", *base, GetParam());
  const std::string out = Temp("openpi_merged.safetensors");
  const auto [output, code] =
      RunAdapter("merge --adapter " + adapter + " --weights " + weights + " --out " + out);
  ASSERT_EQ(code, 0) << output;
  const auto checkpoint = openpi::OpenCheckpoint(out);
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  const auto merged = openpi::LoadCheckpoint(*checkpoint);
  ASSERT_TRUE(merged.ok()) << merged.status();
  const openpi::OracleInputs in = openpi::RandomInputs(config, 2, 2, true, 3);
  const auto velocity = [&](const openpi::OpenpiModel& m) {
    const auto context = openpi::EncodePrefix(m, openpi::EmbedPrefix(m, in.model), in.model.state);
    return openpi::Velocity(m, openpi::SuffixOnCache(m, context, in.noise, in.loss_time));
  };
  const torch::Tensor adapted = velocity(openpi::WithLora(model, ReadPhi(adapter, *base)));
  EXPECT_TRUE(torch::allclose(velocity(*merged), adapted, 1e-4, 1e-4));
  EXPECT_FALSE(torch::allclose(velocity(model), adapted, 1e-2, 1e-2));
}

TEST_P(AdapterCommandTest, RefusesOtherWeightsForeignFilesAndBadUsage) {
  const std::string other = Temp("other.safetensors");
  ASSERT_TRUE(SaveNanoModel(TinyModel(4), other).ok());
  const auto [wrong, wrong_code] =
      RunAdapter("merge --adapter " + adapter_ + " --weights " + other + " --out " + Temp("never"));
  EXPECT_EQ(wrong_code, 2);
  EXPECT_THAT(wrong, HasSubstr("the adapter belongs to weights"));
  EXPECT_FALSE(std::filesystem::exists(Temp("never")));
  const auto [foreign, foreign_code] = RunAdapter("show " + nano_);
  EXPECT_EQ(foreign_code, 2);
  EXPECT_THAT(foreign, AllOf(HasSubstr(nano_), HasSubstr("format is 'robostress-nano'")));
  EXPECT_EQ(RunAdapter("show /nowhere").second, 2);
  EXPECT_EQ(RunAdapter("merge --adapter x").second, 2);
  EXPECT_EQ(
      RunAdapter("import --peft /nowhere --weights " + nano_ + " --out " + Temp("never")).second,
      2);
}

}  // namespace
}  // namespace robostress
