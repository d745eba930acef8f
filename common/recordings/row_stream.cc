#include "common/recordings/row_stream.h"

#include "absl/strings/str_cat.h"

namespace robostress {

const char* QuantityName(JointQuantity quantity) {
  switch (quantity) {
    case JointQuantity::kPosition:
      return "position";
    case JointQuantity::kVelocity:
      return "velocity";
    case JointQuantity::kEffort:
      return "effort";
    case JointQuantity::kCommand:
      return "command";
    case JointQuantity::kGoal:
      return "goal";
  }
  return "";
}

absl::StatusOr<size_t> RowStream::Channel(const RecordedChannel& description) {
  const auto [entry, is_new] = channels_.try_emplace(description.name, channels_.size());
  if (channels_.size() > kMostChannels)
    return absl::ResourceExhaustedError(absl::StrCat(
        "channel ", description.name, " is one more than ", kMostChannels, "; is it a recording?"));
  if (is_new) visitor_->OnChannel(entry->second, description);
  return entry->second;
}

absl::StatusOr<size_t> RowStream::Signal(size_t channel, const std::string& joint,
                                         JointQuantity quantity) {
  const auto [entry, is_new] =
      signals_.try_emplace(std::tuple(channel, quantity, joint), signals_.size());
  if (signals_.size() > kMostSignals)
    return absl::ResourceExhaustedError(
        absl::StrCat("the ", QuantityName(quantity), " of joint '", joint, "' is one more than ",
                     kMostSignals, " signals; names that change with every message are no joints"));
  if (is_new) visitor_->OnSignal(entry->second, {channel, joint, quantity});
  return entry->second;
}

}  // namespace robostress
