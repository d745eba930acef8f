#include "adapter/velocity_field.h"

#include <torch/torch.h>

#include <algorithm>

#include "common/check.h"

namespace robostress {

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
