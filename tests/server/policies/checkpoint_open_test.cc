// Checkpoints as users have them, opened: layouts, shards, sizes, and everything that is refused.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <set>

#include "server/policies/openpi/checkpoint.h"
#include "tests/server/policies/raw_checkpoint.h"

namespace robostress::openpi {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;

constexpr char kEmbedding[] =
    "paligemma_with_expert.paligemma.model.language_model.embed_tokens.weight";

std::string ErrorOf(const fs::path& path, const CheckpointOptions& options = {}) {
  const auto checkpoint = OpenCheckpoint(path.string(), options);
  return checkpoint.ok() ? "(opened)" : std::string(checkpoint.status().message());
}

// --- what the generator writes, in every layout -------------------------------------------------

struct Case {
  bool pi05;
  CheckpointLayout layout;
  DType dtype;
  int64_t shards;
};

class Generated : public ::testing::TestWithParam<Case> {};

INSTANTIATE_TEST_SUITE_P(
    Tiny, Generated,
    ::testing::Values(Case{false, CheckpointLayout::kOpenpi, DType::kBF16, 1},
                      Case{true, CheckpointLayout::kOpenpi, DType::kF32, 1},
                      Case{true, CheckpointLayout::kOpenpi, DType::kBF16, 4},
                      Case{false, CheckpointLayout::kLerobot, DType::kF32, 1},
                      Case{true, CheckpointLayout::kLerobot, DType::kBF16, 3},
                      Case{false, CheckpointLayout::kLerobotOld, DType::kF32, 1},
                      Case{false, CheckpointLayout::kLerobotOld, DType::kBF16, 2}),
    [](const auto& info) {
      return absl::StrCat(info.param.pi05 ? "pi05_" : "pi0_", LayoutName(info.param.layout), "_",
                          DTypeName(info.param.dtype), "_", info.param.shards);
    });

TEST_P(Generated, OpensAsWhatItIs) {
  const Case& c = GetParam();
  const fs::path path = Generate(
      "generated",
      {.pi05 = c.pi05, .dtype = c.dtype, .layout = c.layout, .shards = c.shards, .seed = 4});
  const auto checkpoint = OpenCheckpoint(path.string());
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  EXPECT_EQ(checkpoint->layout, c.layout);
  EXPECT_EQ(static_cast<int64_t>(checkpoint->shards.size()), c.shards);
  EXPECT_EQ(OpenpiConfigJson(checkpoint->config), OpenpiConfigJson(TinyGeneratedConfig(c.pi05)));
  EXPECT_EQ(checkpoint->stored_precision(), DTypeName(c.dtype));
  EXPECT_TRUE(checkpoint->tensors.contains(kEmbedding));
  EXPECT_THAT(checkpoint->unused, Contains(HasSubstr("gemma_expert.lm_head.weight")));

  const auto stats = ReadNormStats(*checkpoint);
  ASSERT_TRUE(stats.ok()) << stats.status();
  const NormStats written = RandomNormStats(4);
  for (const char* key : {"state", "actions"}) {
    EXPECT_EQ(stats->fields.at(key).mean, written.fields.at(key).mean) << key;
    EXPECT_EQ(stats->fields.at(key).std, written.fields.at(key).std) << key;
    EXPECT_EQ(stats->fields.at(key).has_quantiles(), c.layout != CheckpointLayout::kLerobotOld);
    if (stats->fields.at(key).has_quantiles()) {
      EXPECT_EQ(stats->fields.at(key).q99, written.fields.at(key).q99) << key;
    }
  }
}

TEST(Generator, RefusesWhatNoWriterMakesAndFoldersThatExist) {
  GeneratorOptions options;
  options.out = FreshPath("refused").string();
  options.layout = CheckpointLayout::kLerobotOld;
  options.pi05 = true;
  EXPECT_THAT(GenerateCheckpoint(options).message(), HasSubstr("no pi0.5"));
  options.pi05 = false;
  options.shards = 0;
  EXPECT_THAT(GenerateCheckpoint(options).message(), HasSubstr("shards is 0"));
  options.shards = 1;
  fs::create_directory(options.out);
  EXPECT_THAT(GenerateCheckpoint(options).message(), HasSubstr("must be a folder that does not"));
}

// --- full size: headers only, the data is a hole -------------------------------------------------

TEST(FullSize, NamesAndShapesAreThePublishedOnes) {
  const char* shared = std::getenv("ROBOSTRESS_SHARED");
  const fs::path facts = fs::path(shared != nullptr ? shared : "../shared") / "facts";
  if (!fs::exists(facts / "pi0_tensors.tsv"))
    GTEST_SKIP() << "no facts/pi0_tensors.tsv: set ROBOSTRESS_SHARED to the folder of shared data";
  for (const bool pi05 : {false, true}) {
    std::set<std::string> published, ours;
    std::ifstream list(facts / (pi05 ? "pi05_tensors.tsv" : "pi0_tensors.tsv"));
    for (std::string line; std::getline(list, line);) published.insert(line);
    for (const auto& entry : CheckpointTensors({.pi05 = pi05, .full = true}))
      ours.insert(absl::StrCat(entry.name, "\t[", absl::StrJoin(entry.shape, ", "), "]"));
    EXPECT_EQ(ours, published);
    EXPECT_EQ(published.size(), pi05 ? 812u : 777u);
  }
}

struct FullCase {
  bool pi05;
  CheckpointLayout layout;
};

fs::path FullFolder(const FullCase& c, const std::string& config) {
  const fs::path folder = FreshPath("full");
  WriteHollow(folder / "model.safetensors",
              CheckpointTensors({.pi05 = c.pi05, .full = true, .layout = c.layout}));
  if (!config.empty()) WriteText(folder / "config.json", config);
  return folder;
}

TEST(FullSize, SizesFollowFromConfigJson) {
  for (const bool pi05 : {false, true}) {
    const fs::path folder = FullFolder({pi05, CheckpointLayout::kOpenpi}, R"({"action_dim": 32,
        "action_horizon": 50, "paligemma_variant": "gemma_2b",
        "action_expert_variant": "gemma_300m", "precision": "bfloat16"})");
    const auto checkpoint = OpenCheckpoint(folder.string());
    ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
    EXPECT_EQ(OpenpiConfigJson(checkpoint->config), OpenpiConfigJson(FullConfig(pi05)));
    EXPECT_GT(checkpoint->file_bytes(), 7'000'000'000u);
  }
}

TEST(FullSize, VariantsAreRecognisedWhereNoFileNamesThem) {
  const fs::path folder = FullFolder({false, CheckpointLayout::kLerobotOld},
                                     R"({"type": "pi0", "chunk_size": 50, "max_state_dim": 32,
                                         "tokenizer_max_length": 48})");
  const auto checkpoint = OpenCheckpoint(folder.string());
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  EXPECT_EQ(OpenpiConfigJson(checkpoint->config), OpenpiConfigJson(FullConfig(false)));
  EXPECT_THAT(checkpoint->notes, Contains(HasSubstr("gemma_300m, recognised by width 1024")));
}

TEST(FullSize, WhatNoFileSaysMustBeStatedAndIsNotContradicted) {
  const fs::path folder = FullFolder({true, CheckpointLayout::kOpenpi}, "");
  EXPECT_THAT(ErrorOf(folder), AllOf(HasSubstr("horizon"), HasSubstr("action_horizon"),
                                     HasSubstr("no config.json")));
  const auto checkpoint = OpenCheckpoint(folder.string(), {.horizon = 10});
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  EXPECT_EQ(checkpoint->config.horizon, 10);
  EXPECT_THAT(checkpoint->notes, Contains(HasSubstr("prompt_tokens 200")));
  WriteText(folder / "config.json", R"({"action_horizon": 50})");
  EXPECT_THAT(ErrorOf(folder, {.horizon = 10}),
              HasSubstr("the stated horizon is 10, the checkpoint has 50"));
}

TEST(FullSize, AMissingLastLayerIsMissing) {
  std::vector<SafetensorsStream::Entry> entries;
  for (const auto& entry : CheckpointTensors({.full = true})) {
    if (entry.name.find("language_model.layers.17.") == std::string::npos) entries.push_back(entry);
  }
  const fs::path file = FreshPath("short") / "model.safetensors";
  WriteHollow(file, entries);
  EXPECT_THAT(
      ErrorOf(file, {.horizon = 50}),
      AllOf(HasSubstr("9 problems"),
            HasSubstr("missing: paligemma_with_expert.paligemma.model.language_model.layers."
                      "17.mlp.down_proj.weight [2048, 16384]")));
}

TEST(FullSize, OtherWidthsNeedTheirHeads) {
  std::vector<SafetensorsStream::Entry> entries = CheckpointTensors({});
  const fs::path file = FreshPath("unknown") / "model.safetensors";
  WriteHollow(file, entries);
  EXPECT_THAT(ErrorOf(file, {.horizon = 8}),
              AllOf(HasSubstr("heads of the image encoder: its width is 32"),
                    HasSubstr("heads and head_dim of paligemma_variant: width 48, mlp 80"),
                    HasSubstr("metadata has no 'config'")));
}

// --- what does not fit ---------------------------------------------------------------------------

class Tiny : public ::testing::Test {
 protected:
  fs::path Make(GeneratorOptions options) {
    folder_ = Generate("tiny", std::move(options));
    return folder_;
  }
  fs::path weights() const { return folder_ / "model.safetensors"; }
  fs::path index() const { return folder_ / "model.safetensors.index.json"; }
  fs::path folder_;
};

TEST_F(Tiny, AllMisfitsAreNamedAtOnceWithTheirStoredNamesAndShards) {
  Make({.layout = CheckpointLayout::kLerobotOld, .shards = 2});
  const std::string q =
      "model.paligemma_with_expert.gemma_expert.model.layers.0.self_attn.q_proj.weight";
  const fs::path second = folder_ / "model-00002-of-00002.safetensors";
  Edit(second, [&](RawFile& raw) {
    raw.tensors.erase("model.state_proj.bias");
    raw.tensors["model.action_out_proj.bias"] = {DType::kBF16, {3}, std::string(6, '\0')};
    raw.tensors["model.colour.weight"] = {DType::kF32, {1}, std::string(4, '\0')};
    raw.tensors["model.action_in_proj.bias"] = {DType::kI64, {40}, std::string(320, '\0')};
  });
  EditJson(index(), [](nlohmann::json& json) {
    json["weight_map"].erase("model.state_proj.bias");
    json["weight_map"]["model.colour.weight"] = "model-00002-of-00002.safetensors";
  });
  EXPECT_THAT(ErrorOf(folder_),
              AllOf(HasSubstr("4 problems"), HasSubstr("missing: state_proj.bias [40]"),
                    HasSubstr("misshaped: action_out_proj.bias (stored as "
                              "model.action_out_proj.bias in model-00002-of-00002.safetensors) is "
                              "[3], the configuration asks for [32]"),
                    HasSubstr("unexpected: model.colour.weight (in model-00002"),
                    HasSubstr("dtype: action_in_proj.bias"), HasSubstr("is I64, must be")));
}

TEST_F(Tiny, NamesStoredTwiceAreRefused) {
  Make({.layout = CheckpointLayout::kLerobot, .shards = 2});
  EXPECT_THAT(ErrorOf(folder_), "(opened)");
  const std::string twice = "model.action_in_proj.bias";
  const RawFile second = ReadRaw(folder_ / "model-00002-of-00002.safetensors");
  Edit(folder_ / "model-00001-of-00002.safetensors",
       [&](RawFile& raw) { raw.tensors[twice] = second.tensors.at(twice); });
  EXPECT_THAT(ErrorOf(folder_), AllOf(HasSubstr("model-00001-of-00002.safetensors holds " + twice),
                                      HasSubstr("which weight_map places in model-00002")));
  Edit(folder_ / "model-00001-of-00002.safetensors", [&](RawFile& raw) {
    raw.tensors.erase(twice);
    raw.tensors["action_in_proj.bias"] = second.tensors.at(twice);  // means the same
  });
  EditJson(index(), [](nlohmann::json& json) {
    json["weight_map"]["action_in_proj.bias"] = "model-00001-of-00002.safetensors";
  });
  EXPECT_THAT(ErrorOf(folder_),
              AllOf(HasSubstr("stores tensors twice"), HasSubstr("as action_in_proj.bias in"),
                    HasSubstr("as model.action_in_proj.bias in")));
}

TEST_F(Tiny, AnIndexMustMatchItsShards) {
  Make({.shards = 3});
  EXPECT_THAT(ErrorOf(index()), "(opened)");
  const nlohmann::json good = nlohmann::json::parse(std::ifstream(index()));
  const auto with = [&](const std::function<void(nlohmann::json&)>& change) {
    nlohmann::json json = good;
    change(json);
    WriteText(index(), json.dump());
    return ErrorOf(folder_);
  };
  const std::string tensor = "action_in_proj.bias";
  EXPECT_THAT(with([&](auto& j) { j["weight_map"][tensor] = "model-00001-of-00003.safetensors"; }),
              AllOf(HasSubstr("index.json"), HasSubstr("places " + tensor + " in model-00001"),
                    HasSubstr("holds " + tensor + ", which weight_map places in")));
  EXPECT_THAT(with([&](auto& j) { j["weight_map"].erase(tensor); }),
              HasSubstr("holds " + tensor + ", which weight_map does not list"));
  EXPECT_THAT(
      with([&](auto& j) {
        j["weight_map"]["a"] = "model-00004-of-00003.safetensors";
        j["weight_map"]["b"] = "model-00005-of-00003.safetensors";
      }),
      AllOf(HasSubstr("2 problems"), HasSubstr("model-00005-of-00003.safetensors is not there")));
  for (const char* outside :
       {"../model.safetensors", "/etc/passwd", "sub/model.safetensors", "x.bin"}) {
    EXPECT_THAT(
        with([&](auto& j) { j["weight_map"]["a"] = outside; }),
        AllOf(HasSubstr("places a in \"" + std::string(outside)), HasSubstr("same folder")));
  }
  EXPECT_THAT(with([&](auto& j) { j["weight_map"] = 3; }),
              HasSubstr("'weight_map' is not an object"));
  WriteText(index(), R"({"weight_map": {"a": "x.safetensors", "a": "y.safetensors"}})");
  EXPECT_THAT(ErrorOf(folder_), HasSubstr("key 'a' occurs twice"));
  WriteText(index(), std::string(100000, '['));
  EXPECT_THAT(ErrorOf(folder_), HasSubstr("nested 100000 deep"));
  WriteText(index(), good.dump());
  const fs::path shard = folder_ / "model-00002-of-00003.safetensors";
  fs::resize_file(shard, fs::file_size(shard) - 5);
  EXPECT_THAT(ErrorOf(folder_), AllOf(HasSubstr(shard.string()), HasSubstr("truncated")));
}

TEST_F(Tiny, FoldersWithoutOneCheckpointSayWhatToDo) {
  const fs::path folder = FreshPath("empty");
  fs::create_directories(folder);
  EXPECT_THAT(ErrorOf(folder), HasSubstr("holds neither model.safetensors nor"));
  fs::create_directories(folder / "params");
  EXPECT_THAT(ErrorOf(folder), HasSubstr("convert_jax_model_to_pytorch.py"));
  EXPECT_THAT(ErrorOf(folder / "absent.safetensors"), HasSubstr("absent.safetensors"));
  Make({});
  WriteText(index(), "{}");
  EXPECT_THAT(ErrorOf(folder_), HasSubstr("holds both"));
}

TEST_F(Tiny, ForeignFilesAreNoWeights) {
  Make({});
  Edit(weights(), [](RawFile& raw) {
    raw.tensors = {{"model.layers.0.weight", {DType::kF32, {1}, std::string(4, '\0')}}};
    raw.metadata.clear();
  });
  EXPECT_THAT(ErrorOf(folder_), HasSubstr("holds none of the tensors of a pi0 or pi0.5 network"));
}

TEST_F(Tiny, ConfigJsonMustNotContradictTheTensors) {
  Make({.layout = CheckpointLayout::kLerobot});
  const fs::path config = folder_ / "config.json";
  const nlohmann::json good = nlohmann::json::parse(std::ifstream(config));
  const auto with = [&](const std::string& key, const nlohmann::json& value) {
    nlohmann::json json = good;
    json[key] = value;
    WriteText(config, json.dump());
    return ErrorOf(folder_);
  };
  EXPECT_THAT(with("type", "pi05"), AllOf(HasSubstr(config.string()), HasSubstr("pi05")));
  EXPECT_THAT(with("type", "act"), HasSubstr("type is \"act\", must be pi0 or pi05"));
  EXPECT_THAT(with("max_action_dim", 24), HasSubstr("max_action_dim is 24, the checkpoint has 32"));
  EXPECT_THAT(with("max_state_dim", 24), HasSubstr("max_state_dim is 24"));
  EXPECT_THAT(with("chunk_size", 50), HasSubstr("chunk_size is 50, the checkpoint has 8"));
  EXPECT_THAT(with("chunk_size", -1), HasSubstr("chunk_size is -1, must be an integer in 1..4096"));
  EXPECT_THAT(with("chunk_size", "many"), HasSubstr("chunk_size is \"many\""));
  EXPECT_THAT(with("image_resolution", {224, 112}), HasSubstr("image_resolution is [224,112]"));
  EXPECT_THAT(with("image_resolution", {224, 224}), HasSubstr("image size is 224"));
  EXPECT_THAT(with("paligemma_variant", "gemma_2b"), HasSubstr("gemma_2b is 2048"));
  EXPECT_THAT(with("output_features", {{"action", {{"shape", {60}}}}}),
              HasSubstr("shape of action is 60, the network has room for 32"));
  WriteText(config, "{\"type\": ");
  EXPECT_THAT(ErrorOf(folder_), AllOf(HasSubstr(config.string()), HasSubstr("not a JSON object")));
  fs::remove(config);
  fs::create_directory(config);
  EXPECT_THAT(ErrorOf(folder_), HasSubstr("is not a regular file"));
}

TEST_F(Tiny, LerobotsNamesOfTheTimeMlpAndItsLeftOverStateAreUnderstood) {
  Make({.pi05 = true, .layout = CheckpointLayout::kLerobot});
  Edit(weights(), [](RawFile& raw) {
    for (const char* name :
         {"time_mlp_in.weight", "time_mlp_in.bias", "time_mlp_out.weight", "time_mlp_out.bias"}) {
      raw.tensors[absl::StrCat("model.action_", name)] =
          raw.tensors.at(absl::StrCat("model.", name));
      raw.tensors.erase(absl::StrCat("model.", name));
    }
    raw.tensors["model.state_proj.weight"] = {DType::kF32, {1}, std::string(4, '\0')};
  });
  const auto checkpoint = OpenCheckpoint(folder_.string());
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  EXPECT_EQ(checkpoint->tensors.at("time_mlp_in.bias").stored_name,
            "model.action_time_mlp_in.bias");
  EXPECT_THAT(checkpoint->unused, Contains("model.state_proj.weight"));
}

TEST_F(Tiny, LerobotFilesMayLackTheirPrefix) {
  Make({.layout = CheckpointLayout::kLerobot});
  Edit(weights(), [](RawFile& raw) {
    std::map<std::string, RawTensor> stripped;
    for (auto& [name, tensor] : raw.tensors) stripped[name.substr(6)] = std::move(tensor);
    raw.tensors = std::move(stripped);
  });
  const auto checkpoint = OpenCheckpoint(folder_.string());
  ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
  EXPECT_EQ(checkpoint->declared.writer, CheckpointConfig::Writer::kLerobot);
  EXPECT_THAT(checkpoint->declared.cameras, Contains("observation.images.base_0_rgb"));
  EXPECT_EQ(checkpoint->declared.robot_state_dim, 8);
}

// --- statistics ----------------------------------------------------------------------------------

class Statistics : public Tiny {
 protected:
  std::string StatsError(const std::string& asset_id = "") {
    const auto checkpoint = OpenCheckpoint(folder_.string());
    if (!checkpoint.ok()) return std::string(checkpoint.status().message());
    const auto stats = ReadNormStats(*checkpoint, asset_id);
    return stats.ok() ? "read from " + stats->source : std::string(stats.status().message());
  }
};

TEST_F(Statistics, AreFoundWhereWritersLeaveThem) {
  Make({});
  const fs::path assets = folder_ / "assets";
  EXPECT_THAT(StatsError(), HasSubstr("assets/generated/norm_stats.json"));
  fs::create_directories(assets / "lab");
  fs::copy(assets / "generated", assets / "lab/arm");
  EXPECT_THAT(StatsError(),
              AllOf(HasSubstr("fits 2"), HasSubstr("generated ("), HasSubstr("lab/arm (")));
  EXPECT_THAT(StatsError("lab/arm"), HasSubstr("read from"));
  EXPECT_THAT(StatsError("lab/leg"), HasSubstr("'lab/leg' fits 0"));
  fs::remove_all(assets / "lab");
  const fs::path parents = folder_.parent_path() / "assets";
  fs::remove_all(parents);
  fs::rename(assets, parents);
  EXPECT_THAT(StatsError(), HasSubstr((parents / "generated").string()));
  fs::copy(parents / "generated/norm_stats.json", folder_ / "norm_stats.json");
  EXPECT_THAT(StatsError(), HasSubstr((folder_ / "norm_stats.json").string()));
  fs::remove(folder_ / "norm_stats.json");
  fs::remove_all(parents);
  EXPECT_THAT(StatsError(), HasSubstr("has no normalisation statistics"));
}

TEST_F(Statistics, ThatCannotBeAreNamedAtOnce) {
  Make({});
  const fs::path file = folder_ / "assets/generated/norm_stats.json";
  EditJson(file, [](nlohmann::json& json) {
    json["norm_stats"]["state"]["std"][2] = -0.5;
    json["norm_stats"]["state"]["q99"][1] = -9;
    json["norm_stats"]["actions"]["mean"].push_back(1);
    json["norm_stats"]["actions"].erase("q01");
  });
  EXPECT_THAT(StatsError(), AllOf(HasSubstr(file.string()), HasSubstr("state.std[2] is -0.5"),
                                  HasSubstr("state.q99[1] is -9, below q01[1]"),
                                  HasSubstr("actions.std has 7 values, actions.mean has 8"),
                                  HasSubstr("q99 stands alone")));
  WriteText(file, R"({"norm_stats": {"state": {"mean": [0, "x"], "std": {}}, "actions": 3}})");
  EXPECT_THAT(StatsError(),
              AllOf(HasSubstr("state.mean[1] is \"x\""), HasSubstr("state.std is object"),
                    HasSubstr("actions is not an object")));
  WriteText(file, R"({"norm_stats": {"state": {"mean": [1e999], "std": [1]}}})");
  EXPECT_THAT(StatsError(), HasSubstr("not a JSON object"));
  WriteText(file, R"({"norm_stats": {"state": {"mean": [1], "std": [1]}}})");
  EXPECT_THAT(StatsError(), HasSubstr("no statistics of 'actions'"));
  const std::string ones =
      absl::StrCat("[1", absl::StrJoin(std::vector<std::string>(40, ",1"), ""), "]");
  WriteText(file, absl::StrCat(R"({"norm_stats": {"state": {"mean": )", ones, R"(, "std": )", ones,
                               R"(}, "actions": {"mean": [1], "std": [1]}}})"));
  EXPECT_THAT(StatsError(), HasSubstr("state.mean has 41 values, the network of"));
  WriteText(file, R"({"state": {}})");
  EXPECT_THAT(StatsError(), HasSubstr("'norm_stats' is not an object"));
}

TEST_F(Statistics, OfLerobotMustBeThereAndFilled) {
  Make({.layout = CheckpointLayout::kLerobot});
  const fs::path preprocessor = folder_ / "policy_preprocessor.json";
  EXPECT_THAT(StatsError(), HasSubstr("normalizer_processor.safetensors"));
  EditJson(preprocessor,
           [](nlohmann::json& j) { j["steps"][0]["state_file"] = "../x.safetensors"; });
  EXPECT_THAT(StatsError(), AllOf(HasSubstr("state_file"), HasSubstr("../x.safetensors")));
  EditJson(preprocessor, [](nlohmann::json& j) { j["steps"][0]["state_file"] = "x.safetensors"; });
  EXPECT_THAT(StatsError(), HasSubstr("x.safetensors, which is not there"));

  Make({.layout = CheckpointLayout::kLerobotOld});
  Edit(weights(), [](RawFile& raw) {
    const float infinity = HUGE_VALF;
    for (auto& [name, tensor] : raw.tensors) {
      if (name == "normalize_inputs.buffer_observation_state.std")
        tensor.bytes.replace(4, 4, reinterpret_cast<const char*>(&infinity), 4);
      if (name == "normalize_targets.buffer_action.mean") tensor.bytes[0] ^= 1;
    }
  });
  EXPECT_THAT(StatsError(), AllOf(HasSubstr("state.std[1] is inf"),
                                  HasSubstr("contradicts another copy of actions.mean")));
}

}  // namespace
}  // namespace robostress::openpi
