#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/policies/nano/nano_config.h"
#include "server/training/worst_case_actions.h"

namespace robostress {

// kBc: behaviour cloning. kRobust: behaviour cloning of the worst chunk near the demonstration.
enum class Objective { kBc, kRobust };

// How a nano policy is trained. Saved resolved as OUT/config.yaml.
struct TrainOptions {
  std::vector<std::string>
      data;             // directories of shards; LIBERO's .hdf5 files, or directories of them
  int hdf5_stride = 2;  // control steps between the frames taken from those
  std::string out;
  std::string init;  // weights to go on from; empty: random
  // Weights of another architecture or robot: words and every tensor that `network` has too are
  // taken over, normalisation if the robot is the same; the rest starts random. Not with init.
  std::string graft;
  Objective objective = Objective::kBc;
  PgdOptions robust;      // with objective robust
  int64_t steps = 20000;  // optimizer steps of the whole run
  int batch = 128;        // frames per step
  int draws = 2;          // flow times and noises per frame; the prefix is shared
  double lr = 1e-3;
  double final_lr = 1e-5;      // end of the cosine
  int64_t warmup = 300;        // steps
  double weight_decay = 0.01;  // AdamW, on matrices only
  double beta2 = 0.99;
  double clip = 1.0;   // global norm of the gradient
  double ema = 0.999;  // decay of the averaged weights, which are what is published
  uint64_t seed = 1;
  int threads = 2;                 // each computes batch / threads frames
  double aux_weight = 0.5;         // of the auxiliary loss on prefix outputs
  int near_steps = 15;             // steps of a chunk with full weight in the loss
  double far_weight = 0.3;         // weight of the other steps
  int shift_px = 0;                // largest random shift of an image
  double colour_jitter = 0.05;     // largest relative change of a channel's gain, and of its offset
  double state_noise = 0.02;       // Gaussian noise on the normalised proprioception
  double validation_share = 0.03;  // of the episodes, held out
  int validation_frames = 256;     // of them, spread evenly
  int64_t log_every = 50;          // steps
  int64_t evaluate_every = 1000;
  std::string evaluate_command;  // see MeasureSuccess; empty: held-out errors only
  int64_t checkpoint_every = 500;
  NanoConfig network;  // unused with init

  template <class V>
  void Visit(V& v) {
    v.Field("data", data,
            "directories of shards; .hdf5 files in LIBERO's form, or directories of them");
    v.Field("hdf5_stride", hdf5_stride, "control steps between the frames taken from .hdf5 files");
    v.Field("out", out, "output directory");
    v.Field("init", init, "weights to go on from; empty: random");
    v.Field("graft", graft, "weights of another architecture whose shared tensors are taken over");
    v.Choice(
        "objective", objective, {{"bc", Objective::kBc}, {"robust", Objective::kRobust}},
        "bc: behaviour cloning; robust: on the worst chunk near the demonstration (RobustVLA)");
    v.Section("robust", robust, "PGD on the normalised action chunk, with objective robust");
    v.Field("steps", steps, "optimizer steps of the whole run");
    v.Field("batch", batch, "frames per step");
    v.Field("draws", draws, "flow times and noises per frame");
    v.Field("lr", lr, "peak learning rate");
    v.Field("final_lr", final_lr, "learning rate at the end");
    v.Field("warmup", warmup, "steps of linear warm-up");
    v.Field("weight_decay", weight_decay, "AdamW, matrices only");
    v.Field("beta2", beta2, "AdamW");
    v.Field("clip", clip, "global norm of the gradient");
    v.Field("ema", ema, "decay of the averaged weights");
    v.Field("seed", seed, "of initialisation, order, noise and augmentation");
    v.Field("threads", threads, "each computes batch / threads frames");
    v.Field("aux_weight", aux_weight, "weight of the auxiliary loss");
    v.Field("near_steps", near_steps, "steps of a chunk with full weight");
    v.Field("far_weight", far_weight, "weight of the other steps");
    v.Field("shift_px", shift_px, "largest random image shift [px]");
    v.Field("colour_jitter", colour_jitter, "largest relative change of gain and offset");
    v.Field("state_noise", state_noise, "noise on the normalised proprioception");
    v.Field("validation_share", validation_share, "share of the episodes held out");
    v.Field("validation_frames", validation_frames, "frames of them that are evaluated");
    v.Field("log_every", log_every, "steps");
    v.Field("evaluate_every", evaluate_every, "steps");
    v.Field(
        "evaluate_command", evaluate_command,
        "run then; {weights}, {out} and {step} are replaced, episodes.jsonl below {out} counted");
    v.Field("checkpoint_every", checkpoint_every, "steps");
    v.Section("network", network, "shape of the policy; unused with init");
  }
};

// Every value in range; the error names field, value and limit.
absl::Status ValidateTrainOptions(const TrainOptions& options);

}  // namespace robostress
