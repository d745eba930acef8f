#include "server/training/train_options.h"

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::Status ValidateTrainOptions(const TrainOptions& options) {
  const auto check = [](const char* name, double value, double low, double high) -> absl::Status {
    if (value >= low && value <= high) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("training: ", name, " is ", value, ", must be ", low, " to ", high));
  };
  if (options.data.empty()) {
    return absl::InvalidArgumentError(
        "training: no data; give --data DIR, a folder that robostress-record has written");
  }
  if (options.out.empty()) return absl::InvalidArgumentError("training: no output; give --out DIR");
  RS_RETURN_IF_ERROR(check("hdf5_stride", options.hdf5_stride, 1, 1000));
  RS_RETURN_IF_ERROR(check("steps", static_cast<double>(options.steps), 1, 1e9));
  RS_RETURN_IF_ERROR(check("batch", options.batch, 1, 65536));
  RS_RETURN_IF_ERROR(check("draws", options.draws, 1, 64));
  RS_RETURN_IF_ERROR(check("lr", options.lr, 0, 1));
  RS_RETURN_IF_ERROR(check("final_lr", options.final_lr, 0, 1));
  RS_RETURN_IF_ERROR(check("warmup", static_cast<double>(options.warmup), 0, 1e9));
  RS_RETURN_IF_ERROR(check("weight_decay", options.weight_decay, 0, 1));
  RS_RETURN_IF_ERROR(check("beta2", options.beta2, 0.5, 0.99999));
  RS_RETURN_IF_ERROR(check("clip", options.clip, 1e-6, 1e6));
  RS_RETURN_IF_ERROR(check("ema", options.ema, 0, 0.999999));
  RS_RETURN_IF_ERROR(check("threads", options.threads, 1, 256));
  RS_RETURN_IF_ERROR(check("aux_weight", options.aux_weight, 0, 1e3));
  RS_RETURN_IF_ERROR(check("near_steps", options.near_steps, 1, 1000));
  RS_RETURN_IF_ERROR(check("far_weight", options.far_weight, 0, 1));
  RS_RETURN_IF_ERROR(check("shift_px", options.shift_px, 0, 16));
  RS_RETURN_IF_ERROR(check("colour_jitter", options.colour_jitter, 0, 1));
  RS_RETURN_IF_ERROR(check("state_noise", options.state_noise, 0, 10));
  RS_RETURN_IF_ERROR(check("validation_share", options.validation_share, 0, 0.5));
  RS_RETURN_IF_ERROR(check("validation_frames", options.validation_frames, 1, 1e6));
  RS_RETURN_IF_ERROR(check("log_every", static_cast<double>(options.log_every), 1, 1e9));
  RS_RETURN_IF_ERROR(check("evaluate_every", static_cast<double>(options.evaluate_every), 1, 1e9));
  RS_RETURN_IF_ERROR(
      check("checkpoint_every", static_cast<double>(options.checkpoint_every), 1, 1e9));
  if (options.batch % options.threads != 0) {
    return absl::InvalidArgumentError(absl::StrCat("training: batch is ", options.batch,
                                                   ", must be a multiple of threads, ",
                                                   options.threads));
  }
  RS_RETURN_IF_ERROR(ValidatePgdOptions(options.robust));
  return ValidateNanoConfig(options.network);
}

}  // namespace robostress
