#include "server/policies/nano/nano_config.h"

#include "absl/strings/str_cat.h"

namespace robostress {

int NanoConfig::grid() const { return image_size >> conv_channels.size(); }

int NanoConfig::image_tokens() const { return grid() * grid(); }

int NanoConfig::prefix_tokens() const {
  return readout_tokens + static_cast<int>(cameras.size()) * image_tokens() + state_words() +
         max_words;
}

absl::Status ValidateNanoConfig(const NanoConfig& config) {
  struct Range {
    const char* name;
    int value, low, high;
  };
  const Range ranges[] = {
      {"number of cameras", static_cast<int>(config.cameras.size()), 1, 8},
      {"image_size", config.image_size, 8, 512},
      {"number of conv_channels", static_cast<int>(config.conv_channels.size()), 1, 7},
      {"max_words", config.max_words, 1, 256},
      {"vocabulary_rows", config.vocabulary_rows, 2, 1 << 16},
      {"readout_tokens", config.readout_tokens, 1, 64},
      {"layers", config.layers, 1, 64},
      {"heads", config.heads, 1, 64},
      {"head_dim", config.head_dim, 2, 512},
      {"prefix_width", config.prefix_width, 2, 4096},
      {"prefix_mlp", config.prefix_mlp, 1, 32768},
      {"expert_width", config.expert_width, 4, 4096},
      {"expert_mlp", config.expert_mlp, 1, 32768},
      {"horizon", config.horizon, 1, 1000},
      {"action_dim", config.action_dim, 1, 64},
      {"model_action_dim", config.model_action_dim, config.action_dim, 64},
      {"steps_per_token", config.steps_per_token, 1, config.horizon},
      {"execute_steps", config.execute_steps, 1, config.horizon},
      {"state_dim", config.state_dim, 1, 64},
      {"displacement_channels", config.displacement_channels, 0,
       std::min(config.action_dim, config.state_dim)},
      {"state_bins", config.state_bins, 2, 4096},
      {"aux_dim", config.aux_dim, 1, 64},
  };
  for (const Range& range : ranges) {
    if (range.value < range.low || range.value > range.high) {
      return absl::InvalidArgumentError(absl::StrCat("nano config: ", range.name, " is ",
                                                     range.value, ", must be ", range.low, " to ",
                                                     range.high));
    }
  }
  for (int channels : config.conv_channels) {
    if (channels < 1 || channels > 4096) {
      return absl::InvalidArgumentError(absl::StrCat("nano config: a value of conv_channels is ",
                                                     channels, ", must be 1 to 4096"));
    }
  }
  if (!(config.state_span > 0 && config.state_span < 1000)) {
    return absl::InvalidArgumentError(absl::StrCat("nano config: state_span is ", config.state_span,
                                                   ", must be above 0 and below 1000"));
  }
  if (config.grid() << config.conv_channels.size() != config.image_size) {
    return absl::InvalidArgumentError(
        absl::StrCat("nano config: image_size is ", config.image_size, ", must be a multiple of 2^",
                     config.conv_channels.size(), ", one factor of two per convolution"));
  }
  if (config.horizon % config.steps_per_token != 0) {
    return absl::InvalidArgumentError(absl::StrCat("nano config: steps_per_token is ",
                                                   config.steps_per_token,
                                                   ", must divide the horizon, ", config.horizon));
  }
  if (config.head_dim % 2 != 0 || config.expert_width % 2 != 0) {
    return absl::InvalidArgumentError("nano config: head_dim and expert_width must be even");
  }
  return absl::OkStatus();
}

}  // namespace robostress
