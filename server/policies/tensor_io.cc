#include "server/policies/tensor_io.h"

#include <torch/types.h>

#include <cstring>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress::openpi {
namespace {

// How a dtype lies in memory, and what it becomes.
struct Conversion {
  c10::ScalarType stored, wanted;
};

Conversion ConversionOf(DType dtype) {
  switch (dtype) {
    case DType::kBool:
      return {torch::kUInt8, torch::kBool};  // any byte but 0 is true
    case DType::kU8:
      return {torch::kUInt8, torch::kInt64};
    case DType::kI8:
      return {torch::kInt8, torch::kInt64};
    case DType::kI16:
      return {torch::kInt16, torch::kInt64};
    case DType::kI32:
      return {torch::kInt32, torch::kInt64};
    case DType::kI64:
      return {torch::kInt64, torch::kInt64};
    case DType::kF16:
      return {torch::kFloat16, torch::kFloat32};
    case DType::kBF16:
      return {torch::kBFloat16, torch::kFloat32};
    case DType::kF32:
      return {torch::kFloat32, torch::kFloat32};
    case DType::kF64:
      return {torch::kFloat64, torch::kFloat32};
  }
  return {torch::kUInt8, torch::kInt64};
}

}  // namespace

std::string ShapeText(c10::IntArrayRef shape) {
  return absl::StrCat("[", absl::StrJoin(shape, ", "), "]");
}

absl::StatusOr<torch::Tensor> ToTensor(const std::string& what, const TensorView& view) {
  const Conversion conversion = ConversionOf(view.dtype);
  try {  // LibTorch throws when memory is short
    torch::Tensor stored = at::empty(view.shape, at::TensorOptions(conversion.stored));
    if (!view.bytes.empty()) std::memcpy(stored.data_ptr(), view.bytes.data(), view.bytes.size());
    return conversion.wanted == torch::kBool ? stored.ne(0) : stored.to(conversion.wanted);
  } catch (const std::exception&) {
    return absl::ResourceExhaustedError(absl::StrCat(what, ": no memory for its ",
                                                     view.bytes.size(), " bytes as ",
                                                     c10::toString(conversion.wanted)));
  }
}

absl::StatusOr<torch::Tensor> ToFiniteFloats(const std::string& what, const TensorView& view) {
  if (view.dtype != DType::kF32 && view.dtype != DType::kBF16 && view.dtype != DType::kF16) {
    return absl::InvalidArgumentError(
        absl::StrCat(what, " is ", DTypeName(view.dtype), ", must be F32, BF16 or F16"));
  }
  RS_ASSIGN_OR_RETURN(torch::Tensor tensor, ToTensor(what, view));
  const torch::Tensor bad = at::isfinite(tensor).logical_not().flatten();
  if (bad.any().item<bool>()) {
    const int64_t index = bad.to(torch::kUInt8).argmax().item<int64_t>();
    return absl::InvalidArgumentError(
        absl::StrCat(what, " holds ", tensor.flatten()[index].item<float>(), " at index ", index));
  }
  return tensor;
}

}  // namespace robostress::openpi
