#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace robostress {

// Which of openpi's two networks a nano policy is in small.
//   pi0   a state token before the actions; the time is mixed into each action token
//   pi05  the state stands in the prefix as one word per entry; the time modulates the expert's
//         norms (adaptive RMSNorm)
enum class NanoArchitecture { kPi0, kPi05 };

// The shape of a nano policy. Stored in the weights file, so that a file describes itself.
struct NanoConfig {
  NanoArchitecture architecture = NanoArchitecture::kPi0;
  std::vector<std::string> cameras = {"agentview", "robot0_eye_in_hand"};
  int image_size = 64;                                 // [px], square
  std::vector<int> conv_channels = {24, 48, 96, 128};  // one convolution of stride 2 each
  int max_words = 18;                                  // words of an instruction, padding included
  int vocabulary_rows = 192;  // rows of the word table, two of them for padding and unknown
  int readout_tokens = 4;     // learned prefix tokens that the auxiliary head reads
  int layers = 4;             // of prefix and action expert alike
  int heads = 4;              // query heads; one key-value head, as in pi0
  int head_dim = 32;
  int prefix_width = 96, prefix_mlp = 256;
  int expert_width = 128, expert_mlp = 384;
  int horizon = 50;          // K
  int action_dim = 7;        // of the environment
  int model_action_dim = 8;  // d; the last channel is padding, as in pi0
  int steps_per_token = 5;   // control steps in one action token; pi0 has 1
  int execute_steps = 5;     // n_exec
  int state_dim = 8;
  // Leading action channels that the network sees as displacements from the same entries of the
  // state at the start of the chunk (a Piper's joints; paper, sec:supp_real). Demonstrations and
  // predictions hold absolute values.
  int displacement_channels = 0;
  int state_bins = 256;   // pi05: words of one entry of the state
  double state_span = 4;  // pi05: [standard deviations] that the words cover, to either side
  int aux_dim = 8;        // target position, destination, holding, progress

  int grid() const;          // image tokens per side
  int image_tokens() const;  // per camera
  bool pi05() const { return architecture == NanoArchitecture::kPi05; }
  int state_words() const { return pi05() ? state_dim : 0; }  // tokens of the state in the prefix
  int prefix_tokens() const;                                  // readout + images + state + words
  int action_tokens() const { return horizon / steps_per_token; }
  int suffix_tokens() const { return action_tokens() + (pi05() ? 0 : 1); }

  template <class V>
  void Visit(V& v) {
    v.Choice("architecture", architecture,
             {{"pi0", NanoArchitecture::kPi0}, {"pi05", NanoArchitecture::kPi05}},
             "pi0: state token; pi05: state in the prefix, adaptive norms");
    v.Field("cameras", cameras, "views, in order");
    v.Field("image_size", image_size, "[px], square");
    v.Field("conv_channels", conv_channels, "one convolution of stride 2 each");
    v.Field("max_words", max_words, "words of an instruction");
    v.Field("vocabulary_rows", vocabulary_rows, "rows of the word table");
    v.Field("readout_tokens", readout_tokens,
            "learned prefix tokens that the auxiliary head reads");
    v.Field("layers", layers, "of prefix and action expert alike");
    v.Field("heads", heads, "query heads; one key-value head");
    v.Field("head_dim", head_dim, "width of a head");
    v.Field("prefix_width", prefix_width, "prefix model width");
    v.Field("prefix_mlp", prefix_mlp, "prefix GeGLU width");
    v.Field("expert_width", expert_width, "action expert width");
    v.Field("expert_mlp", expert_mlp, "action expert GeGLU width");
    v.Field("horizon", horizon, "K, steps of a chunk");
    v.Field("action_dim", action_dim, "of the environment");
    v.Field("model_action_dim", model_action_dim, "d, padding included");
    v.Field("steps_per_token", steps_per_token, "control steps in one action token");
    v.Field("execute_steps", execute_steps, "n_exec");
    v.Field("state_dim", state_dim, "proprioception");
    v.Field("displacement_channels", displacement_channels,
            "leading actions that are displacements from the state at the start of the chunk");
    v.Field("state_bins", state_bins, "pi05: words of one entry of the state");
    v.Field("state_span", state_span, "pi05: standard deviations that the words cover");
    v.Field("aux_dim", aux_dim, "outputs of the auxiliary head");
  }
};

// Every field in range and the sizes divisible; the error names field, value and limit.
absl::Status ValidateNanoConfig(const NanoConfig& config);

}  // namespace robostress
