#include "adapter/adaptation_state.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/safetensors.h"
#include "tests/adapter/fake_policy.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class AdaptationStateTest : public ::testing::Test {
 protected:
  AdaptationStateTest() {
    LoraOptions options;
    options.learning_rate = 1e-2;
    adapter_ = *LoraAdapter::Create(&policy_, options, StreamKey("s"));
    for (int i = 0; i < 3; ++i) {
      auto chunk = std::make_shared<TrainingChunk>();
      chunk->context = *policy_.Encode(FakePolicy::MakeObservation(i));
      chunk->target =
          FakePolicy::Random("t" + std::to_string(i), {FakePolicy::kHorizon, FakePolicy::kDim}, 1);
      state_.buffer.push_back(chunk);
    }
    for (int i = 0; i < 3; ++i)
      EXPECT_TRUE(adapter_->Update(i, {state_.buffer[0], state_.buffer[1]}).ok());
    state_.policy = "fake";
    state_.model_hash = "fake-hash";
    state_.method = "ours";
    state_.session = "suite/scenario/5/fake/ours/0";
    state_.lora = adapter_->Export();
    state_.triggers = 3;
    state_.feedback_sequence = 77;
    state_.chunks_since_clear = 45;
    state_.task = 2;
    state_.nominal_task = 2;
    state_.nominal_episode = 9;
    state_.nominal.velocity[3] = 0.125;
    state_.last_loss = 0.1;  // not a float
  }

  std::string Bytes() { return *SerializeAdaptationState(state_, policy_.lora_targets()); }
  absl::StatusOr<AdaptationState> Parse(std::string bytes, const std::string& hash = "fake-hash") {
    return ParseAdaptationState("test.safetensors", std::move(bytes), policy_, hash);
  }

  FakePolicy policy_;
  std::unique_ptr<LoraAdapter> adapter_;
  AdaptationState state_;
};

TEST_F(AdaptationStateTest, SurvivesTheFileBitForBit) {
  const auto parsed = Parse(Bytes());
  ASSERT_TRUE(parsed.ok()) << parsed.status();
  EXPECT_TRUE(BitEqual(parsed->lora.phi, state_.lora.phi));
  EXPECT_TRUE(BitEqual(parsed->lora.phi_0, state_.lora.phi_0));
  for (size_t i = 0; i < state_.lora.adam.m.size(); ++i) {
    EXPECT_TRUE(BitEqual(parsed->lora.adam.m[i], state_.lora.adam.m[i]));
    EXPECT_TRUE(BitEqual(parsed->lora.adam.v[i], state_.lora.adam.v[i]));
  }
  EXPECT_EQ(parsed->lora.adam.steps, 3);
  EXPECT_EQ(parsed->triggers, 3u);
  EXPECT_EQ(parsed->feedback_sequence, 77u);
  EXPECT_EQ(parsed->chunks_since_clear, 45);
  EXPECT_EQ(parsed->task, 2);
  EXPECT_EQ(parsed->nominal_episode, 9);
  EXPECT_EQ(parsed->nominal.velocity, state_.nominal.velocity);
  EXPECT_EQ(parsed->last_loss, 0.1);
  ASSERT_EQ(parsed->buffer.size(), 3u);
  EXPECT_TRUE(BitEqual(parsed->buffer[2]->target, state_.buffer[2]->target));
  EXPECT_TRUE(BitEqual(parsed->buffer[2]->context.keys[0], state_.buffer[2]->context.keys[0]));
  EXPECT_TRUE(
      BitEqual(parsed->buffer[2]->context.prefix_mask, state_.buffer[2]->context.prefix_mask));
}

TEST_F(AdaptationStateTest, SaysItsKindAndIsPerMatrixWhereAnOldFileDoesNot) {
  EXPECT_EQ(Parse(Bytes())->lora_kind, LoraKind::kPerHead);
  LoraOptions options;
  options.kind = LoraKind::kPerMatrix;
  state_.lora = (*LoraAdapter::Create(&policy_, options, StreamKey("s")))->Export();
  state_.lora_kind = LoraKind::kPerMatrix;
  const auto file = SafetensorsFile::Parse("new", Bytes());
  SafetensorsWriter old;
  for (const auto& [key, value] : file->metadata()) {
    if (key != "lora") old.SetMetadata(key, value);
  }
  for (const auto& [name, view] : file->tensors())
    old.Add(name, view.dtype, view.shape, view.bytes.data(), view.bytes.size());
  const auto parsed = Parse(*old.Serialize());
  ASSERT_TRUE(parsed.ok()) << parsed.status();
  EXPECT_EQ(parsed->lora_kind, LoraKind::kPerMatrix);
  EXPECT_TRUE(BitEqual(parsed->lora.phi, state_.lora.phi));
}

TEST_F(AdaptationStateTest, IsRefusedWhenItsTensorsAreOfTheOtherKind) {
  state_.lora_kind = LoraKind::kPerMatrix;
  EXPECT_THAT(std::string(Parse(Bytes()).status().message()), HasSubstr("phi.in.A"));
}

TEST_F(AdaptationStateTest, IsRefusedByOtherWeights) {
  EXPECT_THAT(std::string(Parse(Bytes(), "other-hash").status().message()),
              HasSubstr("belongs to weights fake-hash"));
}

TEST_F(AdaptationStateTest, IsRefusedWhenTruncatedAnywhere) {
  const std::string bytes = Bytes();
  for (const size_t length :
       {size_t{0}, size_t{7}, size_t{100}, bytes.size() / 2, bytes.size() - 1}) {
    EXPECT_FALSE(Parse(bytes.substr(0, length)).ok()) << length;
  }
}

TEST_F(AdaptationStateTest, IsRefusedWhenAValueIsNotFinite) {
  state_.lora.phi.A[0][0][0] = std::nanf("");
  EXPECT_THAT(std::string(Parse(Bytes()).status().message()),
              HasSubstr("phi.in.A holds a value that is not finite"));
}

TEST_F(AdaptationStateTest, IsRefusedWhenATensorHasAnotherShape) {
  state_.lora.adam.m[1] = torch::zeros({3, 3});
  EXPECT_THAT(std::string(Parse(Bytes()).status().message()), HasSubstr("adam_m.in.B"));
}

TEST_F(AdaptationStateTest, RefusesAForeignSafetensorsFile) {
  SafetensorsWriter writer;
  writer.AddFloats("weight", {1}, {1.0f});
  EXPECT_THAT(std::string(Parse(*writer.Serialize()).status().message()),
              HasSubstr("not an adapter state"));
}

}  // namespace
}  // namespace robostress
