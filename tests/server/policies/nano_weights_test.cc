#include "server/policies/nano/nano_weights.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "common/safetensors.h"
#include "server/policies/nano/nano_policy.h"
#include "tests/server/policies/tiny_nano.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using torch::Tensor;

std::string TempFile(const std::string& name) {
  return (std::filesystem::path(testing::TempDir()) / ("nano_weights_test_" + name)).string();
}

TEST(NanoWeights, SurviveARoundTrip) {
  const NanoModel model = TinyModel();
  const std::string path = TempFile("round.safetensors");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  const NanoModel read = LoadNanoModel(path).value();
  EXPECT_EQ(read.vocabulary.words(), model.vocabulary.words());
  EXPECT_EQ(read.actions.std, model.actions.std);
  EXPECT_EQ(read.state.mean, model.state.mean);
  for (size_t i = 0; i < model.tensors.size(); ++i)
    EXPECT_TRUE(torch::equal(read.tensors[i], model.tensors[i]));
  const auto policy = LoadFlowPolicy(path).value();
  EXPECT_EQ(policy->spec().model_hash, Sha256OfFile(path).value());
  EXPECT_EQ(policy->spec().image_width, 16);
  std::filesystem::remove(path);
}

TEST(NanoWeights, ReportAllProblemsOfAFileAtOnce) {
  NanoModel model = TinyModel();
  const std::string path = TempFile("bad.safetensors");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  const SafetensorsFile good = SafetensorsFile::Open(path).value();
  SafetensorsWriter writer;
  for (const auto& [key, value] : good.metadata()) writer.SetMetadata(key, value);
  for (const auto& [name, view] : good.tensors()) {
    if (name == "prefix.readout") continue;
    std::vector<int64_t> shape = view.shape;
    if (name == "state_proj.weight") std::swap(shape[0], shape[1]);
    writer.Add(name, view.dtype, shape, view.bytes.data(), view.bytes.size());
  }
  writer.AddFloats("extra", {1}, std::vector<float>{1.0f});
  ASSERT_TRUE(writer.Write(path).ok());
  EXPECT_THAT(
      std::string(LoadNanoModel(path).status().message()),
      AllOf(HasSubstr("3 problems"), HasSubstr("prefix.readout is missing"),
            HasSubstr("extra is unknown"),
            HasSubstr("state_proj.weight has shape [8,16], must be [16,8]"), HasSubstr(path)));

  model.tensors[0][0][0][0][0] = std::nanf("");
  ASSERT_TRUE(SaveNanoModel(model, path).ok());
  EXPECT_THAT(std::string(LoadNanoModel(path).status().message()),
              HasSubstr("cameras.0.conv.0.weight holds nan"));
  std::filesystem::remove(path);
}

TEST(NanoWeights, RefuseTruncatedForeignAndAbsentFiles) {
  const std::string path = TempFile("cut.safetensors");
  ASSERT_TRUE(SaveNanoModel(TinyModel(), path).ok());
  const std::string bytes = ReadFile(path).value();
  ASSERT_TRUE(WriteFileAtomically(path, bytes.substr(0, bytes.size() / 2)).ok());
  EXPECT_THAT(std::string(LoadFlowPolicy(path).status().message()), HasSubstr(path));
  SafetensorsWriter foreign;
  foreign.SetMetadata("format", "pt");
  foreign.AddFloats("weight", {1}, std::vector<float>{1.0f});
  ASSERT_TRUE(foreign.Write(path).ok());
  EXPECT_THAT(std::string(LoadNanoModel(path).status().message()),
              AllOf(HasSubstr("format is 'pt'"), HasSubstr("robostress-nano")));
  EXPECT_THAT(std::string(LoadFlowPolicy(path).status().message()), HasSubstr(path));
  std::filesystem::remove(path);
  EXPECT_FALSE(LoadFlowPolicy(path).ok());
  EXPECT_THAT(std::string(LoadFlowPolicy("nanno").status().message()),
              AllOf(HasSubstr("nanno"), HasSubstr("nano:random")));
}

TEST(NanoWeights, OfTheRepositoryLoadAndKnowTheirWords) {
  std::vector<std::string> names(kSuitePolicies.begin(), kSuitePolicies.end());
  names.emplace_back(kPiperPolicy);
  for (const std::string& name : names) {
    const bool piper = name == kPiperPolicy;
    const std::string path =  // tests run in the source folder
        absl::StrCat("server/models/weights/", name, ".safetensors");
    if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not there";
    EXPECT_LE(std::filesystem::file_size(path), 20u << 20);
    const auto policy = LoadFlowPolicy(name);
    ASSERT_TRUE(policy.ok()) << policy.status();
    EXPECT_EQ((*policy)->spec().horizon, 50);
    EXPECT_EQ((*policy)->spec().execute_steps, piper ? 10 : 5);
    // A Panda's eight states, or six joints and a gripper, as robot_client asks for.
    EXPECT_EQ((*policy)->spec().state_dim, piper ? 7 : 8);
    EXPECT_EQ((*policy)->spec().cameras.front(), piper ? "base" : "agentview");
    const auto model = LoadNanoModel(path);
    EXPECT_GT(model->vocabulary.words().size(), 10u);
    EXPECT_EQ(model->config.pi05(), name == "nano-pi05") << name;
  }
}

TEST(NanoConfig, RefusesSizesThatDoNotFit) {
  const auto message = [](auto change) {
    NanoConfig config = TinyConfig();
    change(config);
    return std::string(ValidateNanoConfig(config).message());
  };
  EXPECT_EQ(message([](NanoConfig&) {}), "");
  EXPECT_THAT(message([](NanoConfig& c) { c.steps_per_token = 3; }),
              HasSubstr("steps_per_token is 3"));
  EXPECT_THAT(message([](NanoConfig& c) { c.image_size = 18; }), HasSubstr("multiple of 2^2"));
  EXPECT_THAT(message([](NanoConfig& c) { c.layers = 0; }), HasSubstr("layers is 0"));
  EXPECT_THAT(message([](NanoConfig& c) { c.model_action_dim = 6; }),
              HasSubstr("model_action_dim is 6"));
}

TEST(Vocabulary, SplitsWordsAndPads) {
  EXPECT_THAT(SplitWords("Put the  Red-hot bowl, on_it!"),
              testing::ElementsAre("put", "the", "red-hot", "bowl", "on", "it"));
  Vocabulary vocabulary;
  vocabulary.Add("put the bowl");
  vocabulary.Add("the plate");
  EXPECT_THAT(vocabulary.words(), testing::ElementsAre("put", "the", "bowl", "plate"));
  EXPECT_THAT(vocabulary.Encode("THE plate flies", 5).value(), testing::ElementsAre(3, 5, 1, 0, 0));
  EXPECT_THAT(vocabulary.Unknown("THE plate flies, yank"), testing::ElementsAre("flies", "yank"));
}

}  // namespace
}  // namespace robostress
