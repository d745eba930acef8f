#include "server/proxy/action_block.h"

#include <cstring>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/check.h"
#include "common/rollout/message_limits.h"
#include "common/status_macros.h"
#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_value.h"

namespace robostress {
namespace {

size_t PlaceOf(const ActionBlock& block, int row, int col) {
  return block.offset + block.item * (static_cast<size_t>(row) * static_cast<size_t>(block.cols) +
                                      static_cast<size_t>(col));
}

}  // namespace

absl::StatusOr<ActionBlock> FindActions(std::string_view answer) {
  RS_ASSIGN_OR_RETURN(const OpenpiValue value, DecodeOpenpiValue(answer));
  const OpenpiValue* found = OpenpiActionsIn(value);
  const auto* array = found == nullptr ? nullptr : std::get_if<OpenpiArray>(&found->value);
  if (array == nullptr) return absl::InvalidArgumentError("the answer holds no array of actions");
  std::vector<int64_t> shape = array->shape;
  if (shape.size() == 3 && shape[0] == 1) shape.erase(shape.begin());
  if (shape.size() != 2 || shape[0] < 1 || shape[0] > WireLimits::kHorizon || shape[1] < 1 ||
      shape[1] > WireLimits::kActionDim) {
    return absl::InvalidArgumentError(absl::StrCat("actions have shape [",
                                                   absl::StrJoin(array->shape, ", "),
                                                   "], must be [horizon, action_dim]"));
  }
  if (array->dtype != "<f4" && array->dtype != "<f8") {
    return absl::UnimplementedError(
        absl::StrCat("actions are of dtype ", array->dtype, ", must be <f4 or <f8"));
  }
  ActionBlock block;
  block.offset = static_cast<size_t>(array->data.data() - answer.data());
  block.rows = static_cast<int>(shape[0]);
  block.cols = static_cast<int>(shape[1]);
  block.item = array->item_size();
  const OpenpiValue* adapter = value.Find("adapter");
  const OpenpiValue* id = adapter == nullptr ? nullptr : adapter->Find("prediction_id");
  const auto* number = id == nullptr ? nullptr : std::get_if<int64_t>(&id->value);
  if (number != nullptr && *number > 0) block.prediction_id = static_cast<uint64_t>(*number);
  return block;
}

Eigen::MatrixXd ReadActions(std::string_view answer, const ActionBlock& block) {
  Eigen::MatrixXd actions(block.rows, block.cols);
  for (int row = 0; row < block.rows; ++row) {
    for (int col = 0; col < block.cols; ++col) {
      const char* const at = answer.data() + PlaceOf(block, row, col);
      if (block.item == sizeof(float)) {
        float number;
        std::memcpy(&number, at, sizeof number);
        actions(row, col) = static_cast<double>(number);
      } else {
        std::memcpy(&actions(row, col), at, sizeof(double));
      }
    }
  }
  return actions;
}

double WriteAction(std::string& answer, const ActionBlock& block, int row, int col, double value) {
  const size_t at = PlaceOf(block, row, col);
  RS_CHECK(row < block.rows && col < block.cols && at + block.item <= answer.size());
  if (block.item == sizeof(float)) {
    const auto number = static_cast<float>(value);
    std::memcpy(answer.data() + at, &number, sizeof number);
    return static_cast<double>(number);
  }
  std::memcpy(answer.data() + at, &value, sizeof value);
  return value;
}

}  // namespace robostress
