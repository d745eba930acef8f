#include "server/policies/openpi/checkpoint_load.h"

#include <ATen/Parallel.h>
#include <torch/types.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_layout.h"
#include "server/policies/openpi/finite_scan.h"

namespace robostress::openpi {
namespace {

// Read, checked, converted and given back at a time.
constexpr int64_t kBlockElements = 1 << 20;

c10::ScalarType TypeOf(DType dtype) {
  if (dtype == DType::kBF16) return torch::kBFloat16;
  return dtype == DType::kF16 ? torch::kFloat16 : torch::kFloat32;
}

DType WantedType(const std::string& name, DType stored, const LoadOptions& options) {
  switch (options.precision) {
    case WeightPrecision::kAsStored:
      return stored == DType::kF16 ? DType::kF32 : stored;
    case WeightPrecision::kBf16:
      return StaysFloat32(name, options) ? DType::kF32 : DType::kBF16;
    case WeightPrecision::kFloat32:
      return DType::kF32;
  }
  return DType::kF32;
}

absl::Status NotFinite(const std::string& name, const StoredTensor& tensor, int64_t index,
                       const char* as) {
  const int size = DTypeSize(tensor.view.dtype);
  const torch::Tensor element = at::empty({1}, TypeOf(tensor.view.dtype));
  std::memcpy(element.data_ptr(), tensor.view.bytes.data() + index * size, size);
  return absl::InvalidArgumentError(
      absl::StrCat(tensor.shard->path(), ": tensor '", tensor.stored_name, "'",
                   tensor.stored_name == name ? "" : absl::StrCat(" (", name, ")"), " holds ",
                   element.to(torch::kFloat32).item<float>(), " at index ", index, as));
}

// Calls visit(first, count) for every block of a tensor, on several threads; the smallest index
// that it returns, -1 when it returns -1 for all.
template <class Visit>
int64_t FirstBadIndex(int64_t elements, const Visit& visit) {
  constexpr int64_t kNone = std::numeric_limits<int64_t>::max();
  std::atomic<int64_t> first{kNone};
  const int64_t blocks = (elements + kBlockElements - 1) / kBlockElements;
  at::parallel_for(0, blocks, 1, [&](int64_t begin, int64_t end) {
    for (int64_t block = begin; block < end && first == kNone; ++block) {
      const int64_t offset = block * kBlockElements;
      const int64_t bad = visit(offset, std::min(kBlockElements, elements - offset));
      int64_t known = first;
      while (bad >= 0 && bad < known && !first.compare_exchange_weak(known, bad)) {
      }
    }
  });
  return first == kNone ? -1 : first.load();
}

bool IsAligned(const TensorView& view) {
  return reinterpret_cast<uintptr_t>(view.bytes.data()) % DTypeSize(view.dtype) == 0;
}

// The tensor where it lies; it keeps the mapping.
absl::StatusOr<torch::Tensor> ViewTensor(const std::string& name, const StoredTensor& stored) {
  const TensorView& view = stored.view;
  const int size = DTypeSize(view.dtype);
  const int64_t bad = FirstBadIndex(view.num_elements(), [&](int64_t offset, int64_t count) {
    const int64_t index =
        FirstNotFinite(view.dtype, view.bytes.subspan(offset * size, count * size));
    return index < 0 ? index : offset + index;
  });
  if (bad >= 0) return NotFinite(name, stored, bad, "");
  auto* data = const_cast<uint8_t*>(view.bytes.data());  // from_blob has no read-only form
  return at::from_blob(
      data, view.shape, [shard = stored.shard](void*) {}, at::TensorOptions(TypeOf(view.dtype)));
}

// Converts `count` elements from `source` to `target`.
void ConvertBlock(const TensorView& view, absl::Span<const uint8_t> source,
                  const torch::Tensor& target) {
  if (IsAligned(view)) {
    auto* data = const_cast<uint8_t*>(source.data());
    target.copy_(at::from_blob(data, target.sizes(), at::TensorOptions(TypeOf(view.dtype))));
    return;
  }
  const torch::Tensor aligned = at::empty(target.sizes(), TypeOf(view.dtype));
  std::memcpy(aligned.data_ptr(), source.data(), source.size());
  target.copy_(aligned);
}

absl::StatusOr<torch::Tensor> ConvertTensor(const std::string& name, const StoredTensor& stored,
                                            DType wanted) {
  const TensorView& view = stored.view;
  const int size = DTypeSize(view.dtype);
  torch::Tensor converted = at::empty(view.shape, TypeOf(wanted));
  const torch::Tensor flat = converted.view({-1});
  const int64_t bad = FirstBadIndex(view.num_elements(), [&](int64_t offset, int64_t count) {
    const absl::Span<const uint8_t> source = view.bytes.subspan(offset * size, count * size);
    const torch::Tensor target = flat.narrow(0, offset, count);
    ConvertBlock(view, source, target);
    stored.shard->ReleasePages(source);
    const auto* bytes = static_cast<const uint8_t*>(target.data_ptr());
    const int64_t index = FirstNotFinite(wanted, {bytes, target.nbytes()});
    return index < 0 ? index : offset + index;
  });
  if (bad >= 0)
    return NotFinite(name, stored, bad, absl::StrCat(" as ", DTypeName(wanted)).c_str());
  return converted;
}

// Loads what it meets until something is wrong.
struct LoadVisitor : ParameterVisitor {
  LoadVisitor(const Checkpoint& c, const LoadOptions& o) : checkpoint(c), options(o) {}
  void OnTensor(const std::string& name, const std::vector<int64_t>&,
                torch::Tensor& tensor) override {
    if (!status.ok()) return;
    const StoredTensor& stored = checkpoint.tensors.at(name);
    const DType wanted = WantedType(name, stored.view.dtype, options);
    auto loaded = wanted == stored.view.dtype && IsAligned(stored.view)
                      ? ViewTensor(name, stored)
                      : ConvertTensor(name, stored, wanted);
    if (loaded.ok()) {
      tensor = *std::move(loaded);
    } else {
      status = loaded.status();
    }
  }
  const Checkpoint& checkpoint;
  const LoadOptions& options;
  absl::Status status;
};

// The two names of the tied embedding must not disagree.
absl::Status CheckTied(const Checkpoint& checkpoint) {
  const StoredTensor& table = checkpoint.tensors.at(kEmbeddingName);
  for (const auto& shard : checkpoint.shards) {
    for (const auto& [name, view] : shard->tensors()) {
      if (ToOpenpiName(name).name != kTiedHeadName || view.bytes.data() == table.view.bytes.data())
        continue;
      const bool equal = view.dtype == table.view.dtype && view.bytes == table.view.bytes;
      shard->ReleasePages(view.bytes);
      if (equal) continue;
      return absl::InvalidArgumentError(
          absl::StrCat(checkpoint.path, ": contradictory: ", table.stored_name, " and ", name,
                       " are one tied tensor but hold different bytes"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<WeightPrecision> ParsePrecision(const std::string& name) {
  if (name == "as_stored") return WeightPrecision::kAsStored;
  if (name == "bf16") return WeightPrecision::kBf16;
  if (name == "float32") return WeightPrecision::kFloat32;
  return absl::InvalidArgumentError(
      absl::StrCat("precision '", name, "' is not known, must be as_stored, bf16 or float32"));
}

bool StaysFloat32(const std::string& name, const LoadOptions& options) {
  if (!absl::StartsWith(name, "paligemma_with_expert.")) return true;
  for (const char* part : {"patch_embedding", "position_embedding", "input_layernorm",
                           "post_attention_layernorm", "model.norm"}) {
    if (absl::StrContains(name, part)) return true;
  }
  return options.float32_vision && (absl::StrContains(name, "vision_tower") ||
                                    absl::StrContains(name, "multi_modal_projector"));
}

absl::StatusOr<OpenpiModel> LoadCheckpoint(const Checkpoint& checkpoint,
                                           const LoadOptions& options) {
  try {  // LibTorch throws when memory is short
    RS_RETURN_IF_ERROR(CheckTied(checkpoint));
    OpenpiModel model;
    model.config = checkpoint.config;
    LoadVisitor load(checkpoint, options);
    VisitParameters(model.config, model.weights, load);
    RS_RETURN_IF_ERROR(load.status);
    return model;
  } catch (const std::exception& error) {
    return absl::ResourceExhaustedError(
        absl::StrCat(checkpoint.path, ": cannot take memory for its ", checkpoint.tensor_bytes(),
                     " bytes of tensors: ", error.what()));
  }
}

}  // namespace robostress::openpi
