#include "adapter/velocity_field.h"

#include <torch/torch.h>

#include "common/check.h"

namespace robostress {

PolicyContext StackContexts(const std::vector<const PolicyContext*>& contexts) {
  RS_CHECK(!contexts.empty());
  const auto stack = [&contexts](auto&& member) {
    std::vector<torch::Tensor> rows;
    for (const PolicyContext* context : contexts) rows.push_back(member(*context));
    return torch::cat(rows, 0);
  };
  PolicyContext result;
  for (size_t layer = 0; layer < contexts[0]->keys.size(); ++layer) {
    result.keys.push_back(stack([layer](const PolicyContext& c) { return c.keys[layer]; }));
    result.values.push_back(stack([layer](const PolicyContext& c) { return c.values[layer]; }));
  }
  result.prefix_mask = stack([](const PolicyContext& c) { return c.prefix_mask; });
  result.state = stack([](const PolicyContext& c) { return c.state; });
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
