#include "adapter/velocity_field.h"

#include <torch/types.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/check.h"

namespace robostress {

namespace {

std::string Describe(const torch::Tensor& tensor) {
  if (!tensor.defined()) return "absent";
  return absl::StrCat(torch::toString(tensor.scalar_type()), " [",
                      absl::StrJoin(tensor.sizes(), ", "), "]");
}

// Bytes of a bool are 0 or 1; others come from files only, and are undefined to every operator.
bool ZerosAndOnes(const torch::Tensor& mask) {
  const torch::Tensor dense = mask.contiguous();
  const auto* bytes = static_cast<const uint8_t*>(dense.data_ptr());
  return std::all_of(bytes, bytes + dense.nbytes(), [](uint8_t byte) { return byte <= 1; });
}

}  // namespace

absl::Status CheckContext(const std::string& where, const PolicyContext& context,
                          const ContextShape& shape) {
  const auto invalid = [&where](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(where, ": ", parts...));
  };
  const torch::Tensor& mask = context.prefix_mask;
  if (!mask.defined() || mask.scalar_type() != torch::kBool || mask.dim() != 2 ||
      mask.size(0) != 1 || mask.size(1) < 1 || mask.size(1) > shape.max_prefix) {
    return invalid("prefix_mask is ", Describe(mask), "; this policy's is Bool [1, 1..",
                   shape.max_prefix, "]");
  }
  if (!mask.device().is_cpu() || ZerosAndOnes(mask)) {
    if (!mask.any().item<bool>()) return invalid("prefix_mask masks every slot");
  } else {
    return invalid("prefix_mask holds a byte that is neither 0 nor 1");
  }
  const torch::Tensor& state = context.state;
  if (!state.defined() || state.scalar_type() != torch::kFloat32 || state.dim() != 2 ||
      state.size(0) != 1 || state.size(1) != shape.state_dim) {
    return invalid("state is ", Describe(state), "; this policy's is Float [1, ", shape.state_dim,
                   "]");
  }
  if (!torch::isfinite(state).all().item<bool>())
    return invalid("state holds a value that is not finite");
  const auto layers = static_cast<size_t>(shape.layers);
  if (context.keys.size() != layers || context.values.size() != layers) {
    return invalid("keys of ", context.keys.size(), " and values of ", context.values.size(),
                   " layers; this policy has ", shape.layers);
  }
  const std::vector<int64_t> expected{1, shape.kv_heads, mask.size(1), shape.head_dim};
  for (const auto* side : {&context.keys, &context.values}) {
    const char* name = side == &context.keys ? "keys" : "values";
    for (size_t layer = 0; layer < side->size(); ++layer) {
      const torch::Tensor& tensor = (*side)[layer];
      if (!tensor.defined() || tensor.scalar_type() != shape.kv_type ||
          tensor.sizes() != expected) {
        return invalid(name, " of layer ", layer, " are ", Describe(tensor), "; this policy's are ",
                       torch::toString(shape.kv_type), " [", absl::StrJoin(expected, ", "), "]");
      }
      if (!torch::isfinite(tensor).all().item<bool>())
        return invalid(name, " of layer ", layer, " hold a value that is not finite");
    }
  }
  return absl::OkStatus();
}

PolicyContext StackContexts(const std::vector<const PolicyContext*>& contexts) {
  RS_CHECK(!contexts.empty());
  int64_t longest = 0;
  for (const PolicyContext* context : contexts)
    longest = std::max(longest, context->prefix_mask.size(1));
  // `dimension` counts the slots of the prefix; 0 and false fill the masked ones. Contexts that
  // were imported lie on the CPU, those of a policy on a GPU there: all go to the first one's
  // device.
  const auto stack = [&](int64_t dimension, auto&& member) {
    std::vector<torch::Tensor> rows;
    for (const PolicyContext* context : contexts) {
      rows.push_back(member(*context).to(member(*contexts[0]).device()));
      std::vector<int64_t> filling = rows.back().sizes().vec();
      filling[dimension] = longest - filling[dimension];
      if (filling[dimension] > 0)
        rows.back() =
            torch::cat({rows.back(), torch::zeros(filling, rows.back().options())}, dimension);
    }
    return torch::cat(rows, 0);
  };
  PolicyContext result;
  for (size_t layer = 0; layer < contexts[0]->keys.size(); ++layer) {
    result.keys.push_back(stack(2, [layer](const PolicyContext& c) { return c.keys[layer]; }));
    result.values.push_back(stack(2, [layer](const PolicyContext& c) { return c.values[layer]; }));
  }
  result.prefix_mask = stack(1, [](const PolicyContext& c) { return c.prefix_mask; });
  std::vector<torch::Tensor> states;
  for (const PolicyContext* context : contexts) states.push_back(context->state);
  result.state = torch::cat(states, 0);
  return result;
}

PolicyContext ContextRow(const PolicyContext& context, int64_t row) {
  PolicyContext result;
  for (const torch::Tensor& keys : context.keys) result.keys.push_back(keys.narrow(0, row, 1));
  for (const torch::Tensor& values : context.values)
    result.values.push_back(values.narrow(0, row, 1));
  result.prefix_mask = context.prefix_mask.narrow(0, row, 1);
  result.state = context.state.narrow(0, row, 1);
  return result;
}

}  // namespace robostress
