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

}  // namespace robostress
