#include "adapter/lora_options.h"

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status LoraOptions::Check() const {
  const auto moment = [](const char* key, double beta) {
    if (beta >= 0 && beta < 1) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(key, " is ", beta, ", must be in [0, 1)"));
  };
  RS_RETURN_IF_ERROR(CheckOption("rank", rank, 1, 256));
  RS_RETURN_IF_ERROR(CheckOption("buffer_chunks", buffer_chunks, 1, 4096));
  if (update_interval < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("update_interval is ", update_interval, ", must be at least 1"));
  }
  if (batch < 1 || batch > buffer_chunks) {
    return absl::InvalidArgumentError(
        absl::StrCat("batch is ", batch, ", must be 1..", buffer_chunks, " (buffer_chunks)"));
  }
  RS_RETURN_IF_ERROR(CheckOption("learning_rate", learning_rate, 0.0, 1.0));
  RS_RETURN_IF_ERROR(CheckOption("lora_init_std", init_std, 0.0, 10.0));
  RS_RETURN_IF_ERROR(moment("beta1", beta1));
  RS_RETURN_IF_ERROR(moment("beta2", beta2));
  RS_RETURN_IF_ERROR(CheckOption("adam_epsilon", adam_epsilon, 1e-30, 1.0));
  RS_RETURN_IF_ERROR(CheckOption("clip_norm", clip_norm, 1e-12, 1e12));
  return CheckOption("anchor_weight", anchor_weight, 0.0, 1e6);
}

}  // namespace robostress
