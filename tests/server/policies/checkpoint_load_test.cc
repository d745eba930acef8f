// Checkpoints, loaded: values, precision, mapping, memory, and values that are refused.

#include "server/policies/openpi/checkpoint_load.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <cmath>
#include <cstring>
#include <fstream>

#include "server/policies/openpi/finite_scan.h"
#include "tests/run_program.h"
#include "tests/server/policies/raw_checkpoint.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress::openpi {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

absl::StatusOr<OpenpiModel> Load(const fs::path& path, const LoadOptions& options = {}) {
  const auto checkpoint = OpenCheckpoint(path.string());
  if (!checkpoint.ok()) return checkpoint.status();
  return LoadCheckpoint(*checkpoint, options);
}

TensorMap Tensors(const fs::path& path, const LoadOptions& options = {}) {
  const auto model = Load(path, options);
  EXPECT_TRUE(model.ok()) << model.status();
  return model.ok() ? WeightTensors(*model) : TensorMap();
}

std::string ErrorOf(const fs::path& path, const LoadOptions& options = {}) {
  const auto model = Load(path, options);
  return model.ok() ? "(loaded)" : std::string(model.status().message());
}

TEST(Load, LayoutsShardsAndPrecisionsHoldTheSameNetwork) {
  for (const bool pi05 : {false, true}) {
    const TensorMap reference =
        Tensors(Generate("reference", {.pi05 = pi05, .dtype = DType::kF32, .seed = 3}));
    for (const auto layout :
         {CheckpointLayout::kOpenpi, CheckpointLayout::kLerobot, CheckpointLayout::kLerobotOld}) {
      if (pi05 && layout == CheckpointLayout::kLerobotOld) continue;
      const fs::path path = Generate(
          "other", {.pi05 = pi05, .dtype = DType::kBF16, .layout = layout, .shards = 3, .seed = 3});
      const TensorMap tensors = Tensors(path);
      ASSERT_EQ(tensors.size(), reference.size());
      for (const auto& [name, tensor] : reference) {
        const torch::Tensor rounded = tensor.to(torch::kBFloat16).to(torch::kFloat32);
        EXPECT_EQ(tensors.at(name).dtype(), torch::kFloat32);
        EXPECT_TRUE(at::equal(tensors.at(name), rounded)) << LayoutName(layout) << " " << name;
      }
    }
  }
}

TEST(Load, Bf16KeepsOpenpisSelectionInFloat32) {
  const fs::path path = Generate("selection", {.pi05 = true, .dtype = DType::kF32});
  const std::string p = "paligemma_with_expert.paligemma.model.";
  const std::string e = "paligemma_with_expert.gemma_expert.model.";
  const std::vector<std::string> float32 = {
      p + "vision_tower.vision_model.embeddings.patch_embedding.bias",
      p + "vision_tower.vision_model.embeddings.position_embedding.weight",
      p + "language_model.layers.1.input_layernorm.weight",
      p + "language_model.layers.1.post_attention_layernorm.weight",
      p + "language_model.norm.weight",
      e + "layers.0.input_layernorm.dense.weight",
      e + "norm.dense.bias",
      "action_in_proj.weight",
      "time_mlp_out.bias"};
  const std::vector<std::string> vision = {
      p + "vision_tower.vision_model.encoder.layers.0.layer_norm1.weight",
      p + "vision_tower.vision_model.encoder.layers.1.mlp.fc1.weight",
      p + "vision_tower.vision_model.post_layernorm.weight",
      p + "multi_modal_projector.linear.bias"};
  const std::vector<std::string> bf16 = {p + "language_model.embed_tokens.weight",
                                         p + "language_model.layers.2.mlp.down_proj.weight",
                                         e + "layers.2.self_attn.q_proj.weight"};
  const TensorMap stored = Tensors(path, {.precision = WeightPrecision::kAsStored});
  for (const bool float32_vision : {false, true}) {
    const TensorMap tensors =
        Tensors(path, {.precision = WeightPrecision::kBf16, .float32_vision = float32_vision});
    for (const auto& name : float32) EXPECT_EQ(tensors.at(name).dtype(), torch::kFloat32) << name;
    for (const auto& name : bf16) EXPECT_EQ(tensors.at(name).dtype(), torch::kBFloat16) << name;
    for (const auto& name : vision)
      EXPECT_EQ(tensors.at(name).dtype(), float32_vision ? torch::kFloat32 : torch::kBFloat16);
    for (const auto& [name, tensor] : tensors)
      EXPECT_TRUE(at::equal(tensor, stored.at(name).to(tensor.dtype()))) << name;
  }
}

TEST(Load, StoredPrecisionIsViewedWhereItLiesAndOutlivesTheCheckpoint) {
  const fs::path path = Generate("viewed", {.dtype = DType::kBF16, .shards = 2});
  TensorMap tensors;
  {
    const auto checkpoint = OpenCheckpoint(path.string());
    ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
    const auto model = LoadCheckpoint(*checkpoint, {.precision = WeightPrecision::kAsStored});
    ASSERT_TRUE(model.ok()) << model.status();
    tensors = WeightTensors(*model);
    for (const auto& [name, tensor] : tensors)
      EXPECT_EQ(tensor.data_ptr(), checkpoint->tensors.at(name).view.bytes.data()) << name;
  }
  fs::remove_all(path);  // the mapping stays
  for (const auto& [name, tensor] : tensors)
    EXPECT_TRUE(at::isfinite(tensor).all().item<bool>()) << name;
}

TEST(Load, HalfPrecisionFilesAreWidened) {
  const fs::path path = Generate("half", {.dtype = DType::kF32});
  TensorMap reference = Tensors(path);
  Edit(path / "model.safetensors", [&](RawFile& raw) {
    const torch::Tensor half = reference.at("state_proj.weight").to(torch::kFloat16);
    raw.tensors["state_proj.weight"] = {
        DType::kF16, half.sizes().vec(),
        std::string(static_cast<const char*>(half.data_ptr()), half.nbytes())};
  });
  for (const auto precision :
       {WeightPrecision::kAsStored, WeightPrecision::kBf16, WeightPrecision::kFloat32}) {
    const torch::Tensor loaded = Tensors(path, {.precision = precision}).at("state_proj.weight");
    EXPECT_EQ(loaded.dtype(), torch::kFloat32);
    EXPECT_TRUE(at::equal(
        loaded, reference.at("state_proj.weight").to(torch::kFloat16).to(torch::kFloat32)));
  }
}

// The header made one byte longer: no tensor is aligned any more.
void Misalign(const fs::path& file) {
  std::string bytes;
  {
    std::ifstream in(file, std::ios::binary);
    bytes.assign(std::istreambuf_iterator<char>(in), {});
  }
  uint64_t size = 0;
  std::memcpy(&size, bytes.data(), 8);
  bytes.insert(8 + size, " ");
  ++size;
  std::memcpy(bytes.data(), &size, 8);
  const fs::path whole = file.string() + ".new";  // in place, mapped tensors would change too
  std::ofstream(whole, std::ios::binary) << bytes;
  fs::rename(whole, file);
}

TEST(Load, UnalignedTensorsAreCopied) {
  for (const DType dtype : {DType::kF32, DType::kBF16}) {
    const fs::path path = Generate("unaligned", {.dtype = dtype});
    const TensorMap aligned = Tensors(path, {.precision = WeightPrecision::kAsStored});
    Misalign(path / "model.safetensors");
    for (const auto precision :
         {WeightPrecision::kAsStored, WeightPrecision::kBf16, WeightPrecision::kFloat32}) {
      for (const auto& [name, tensor] : Tensors(path, {.precision = precision})) {
        EXPECT_EQ(reinterpret_cast<uintptr_t>(tensor.data_ptr()) % tensor.element_size(), 0u);
        EXPECT_TRUE(at::equal(tensor, aligned.at(name).to(tensor.dtype()))) << name;
      }
    }
  }
}

TEST(Load, ValuesThatAreNotFiniteAreNamedInEveryPrecision) {
  const fs::path path =
      Generate("infinite", {.dtype = DType::kF32, .layout = CheckpointLayout::kLerobot});
  const auto with = [&](float value, WeightPrecision precision) {
    Edit(path / "model.safetensors", [&](RawFile& raw) {
      auto& bytes = raw.tensors
                        .at("model.paligemma_with_expert.paligemma.model.language_model.layers.0."
                            "mlp.up_proj.weight")
                        .bytes;
      std::memcpy(bytes.data() + 4 * 1234, &value, 4);
    });
    return ErrorOf(path, {.precision = precision});
  };
  for (const auto precision :
       {WeightPrecision::kAsStored, WeightPrecision::kBf16, WeightPrecision::kFloat32}) {
    EXPECT_THAT(with(-INFINITY, precision),
                AllOf(HasSubstr("model.safetensors: tensor 'model.paligemma_with_expert"),
                      HasSubstr("up_proj.weight"), HasSubstr("holds -inf at index 1234")));
    EXPECT_THAT(with(NAN, precision), HasSubstr("holds nan at index 1234"));
    EXPECT_EQ(with(0, precision), "(loaded)");
  }
  EXPECT_EQ(with(3.4e38f, WeightPrecision::kFloat32), "(loaded)");
  EXPECT_THAT(with(3.4e38f, WeightPrecision::kBf16),
              HasSubstr("holds 3.4e+38 at index 1234 as BF16"));
}

TEST(FiniteScan, FindsTheFirstInEveryTypeAtEveryPlace) {
  for (const int64_t count : {1, 5, 4096, 4097, 9000}) {
    for (const int64_t bad : {int64_t{0}, count / 2, count - 1}) {
      std::vector<float> f32(count, 1.5f);
      std::vector<uint16_t> half(count, 0x3C00);
      const auto bytes = [](const auto& v) {
        return absl::Span<const uint8_t>(reinterpret_cast<const uint8_t*>(v.data()),
                                         v.size() * sizeof(v[0]));
      };
      EXPECT_EQ(FirstNotFinite(DType::kF32, bytes(f32)), -1);
      EXPECT_EQ(FirstNotFinite(DType::kF16, bytes(half)), -1);
      EXPECT_EQ(FirstNotFinite(DType::kBF16, bytes(half)), -1);
      f32[bad] = NAN;
      half[bad] = 0xFC00;  // -inf as F16, an ordinary number as BF16
      EXPECT_EQ(FirstNotFinite(DType::kF32, bytes(f32)), bad);
      EXPECT_EQ(FirstNotFinite(DType::kF16, bytes(half)), bad);
      EXPECT_EQ(FirstNotFinite(DType::kBF16, bytes(half)), -1);
      half[bad] = 0x7F81;
      EXPECT_EQ(FirstNotFinite(DType::kBF16, bytes(half)), bad);
    }
  }
}

TEST(Load, TheTiedEmbeddingHasOneValue) {
  const fs::path path = Generate("tied", {});
  const auto copy = [&](bool equal) {
    Edit(path / "model.safetensors", [&](RawFile& raw) {
      raw.tensors[kEmbeddingName] = raw.tensors.at(kTiedHeadName);
      if (!equal) raw.tensors[kEmbeddingName].bytes[7] ^= 1;
    });
    return ErrorOf(path);
  };
  EXPECT_EQ(copy(true), "(loaded)");
  EXPECT_THAT(copy(false), AllOf(HasSubstr(kTiedHeadName), HasSubstr("different bytes")));
}

// Ten Euler steps on random inputs.
torch::Tensor Actions(const OpenpiModel& model, const OracleInputs& inputs) {
  const PrefixContext context =
      EncodePrefix(model, EmbedPrefix(model, inputs.model), inputs.model.state);
  return IntegrateEuler(model, context, inputs.noise, 10).xs.back();
}

TEST(Load, MixedPrecisionComputesWhatFloat32DoesToRounding) {
  for (const bool pi05 : {false, true}) {
    const fs::path path = Generate("computes", {.pi05 = pi05, .dtype = DType::kBF16});
    OracleInputs inputs = RandomInputs(TinyGeneratedConfig(pi05), 2, 2, true, 7);
    const auto wide = Load(path);
    ASSERT_TRUE(wide.ok()) << wide.status();
    const torch::Tensor reference = Actions(*wide, inputs);
    for (const LoadOptions& options :
         {LoadOptions{.precision = WeightPrecision::kBf16},
          LoadOptions{.precision = WeightPrecision::kBf16, .float32_vision = true},
          LoadOptions{.precision = WeightPrecision::kAsStored}}) {
      const auto model = Load(path, options);
      ASSERT_TRUE(model.ok()) << model.status();
      const torch::Tensor actions = Actions(*model, inputs);
      EXPECT_EQ(actions.dtype(), torch::kFloat32);
      const double error =
          ((actions - reference).square().mean() / reference.square().mean()).sqrt().item<double>();
      // bf16 has 8 bits: 0.4 % a rounding; the facts saw 2-6 % rms on such sizes.
      EXPECT_GT(error, 1e-5) << "nothing was computed in bf16";
      EXPECT_LT(error, 0.1);
      const FlowLoss loss = ComputeFlowLoss(*model, inputs.model, inputs.loss_actions,
                                            inputs.loss_noise, inputs.loss_time);
      EXPECT_TRUE(std::isfinite(loss.mean.item<double>()));
    }
  }
}

// [bytes] of a line of /proc/self/status.
int64_t Memory(const std::string& field) {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    int64_t kib = 0;
    if (word == field + ":" && status >> kib) return kib * 1024;
  }
  return 0;
}

// Peak of resident memory while a file with a table of 200 MiB (float32) is loaded, less what was
// resident before.
int64_t PeakOf(DType dtype, const LoadOptions& options, uint64_t& file_bytes) {
  OpenpiConfig config = TinyGeneratedConfig(false);
  config.vocab = 1 << 20;
  std::vector<SafetensorsStream::Entry> entries = CheckpointTensors({.dtype = dtype});
  for (auto& entry : entries) {
    if (entry.name == kTiedHeadName) entry.shape[0] = config.vocab;
  }
  const fs::path file = FreshPath("large") / "large.safetensors";
  WriteHollow(file, entries, {{"config", OpenpiConfigJson(config)}});
  file_bytes = fs::file_size(file);
  const int64_t before = Memory("VmRSS");
  std::ofstream("/proc/self/clear_refs") << "5";
  const auto model = Load(file, options);
  EXPECT_TRUE(model.ok()) << model.status();
  const int64_t peak = Memory("VmHWM") - before;
  fs::remove(file);
  return peak;
}

TEST(Load, HoldsOneCopyAtMost) {
  if (Memory("VmHWM") == 0) GTEST_SKIP() << "no /proc/self/status on this system";
  constexpr double kSlack = 24 << 20;  // blocks in flight
  uint64_t bytes = 0;
  const double viewed = PeakOf(DType::kBF16, {.precision = WeightPrecision::kBf16}, bytes);
  EXPECT_LT(viewed, 1.1 * bytes + kSlack);
  const double narrowed = PeakOf(DType::kF32, {.precision = WeightPrecision::kBf16}, bytes);
  EXPECT_LT(narrowed, 0.55 * bytes + kSlack);  // without giving pages back: 1.5
  const double widened = PeakOf(DType::kBF16, {.precision = WeightPrecision::kFloat32}, bytes);
  EXPECT_LT(widened, 2.1 * bytes + kSlack);  // without: 3
}

TEST(Program, GeneratesAndLoads) {
  const std::string out = FreshPath("program").string();
  const auto run = [](const std::string& arguments) {
    return RunProgram(POLICY_PROGRAM, arguments);
  };
  const std::string generate =
      "generate --network pi0.5 --size tiny --layout lerobot --shards 3 --out " + out;
  EXPECT_EQ(run(generate).second, 0);
  const auto [again, again_code] = run(generate);
  EXPECT_EQ(again_code, 2);
  EXPECT_THAT(again, HasSubstr("must be a folder that does not exist yet"));
  const auto [loaded, code] = run("load --checkpoint " + out + " --precision bf16");
  EXPECT_EQ(code, 0) << loaded;
  const auto json = nlohmann::json::parse(loaded);
  EXPECT_EQ(json["network"], "pi0.5");
  EXPECT_EQ(json["layout"], "lerobot");
  EXPECT_GT(json["resident_peak_bytes"], json["file_bytes"]);
  EXPECT_EQ(run("load --checkpoint " + out + " --horizon 9").second, 2);
  EXPECT_EQ(run("load --checkpoint " + out + " --precision int4").second, 2);
  EXPECT_EQ(run("generate --network pi1 --out x").second, 2);
}

}  // namespace
}  // namespace robostress::openpi
