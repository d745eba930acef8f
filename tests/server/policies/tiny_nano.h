#pragma once

#include "server/policies/nano/nano_weights.h"
#include "server/policies/policy.h"

namespace robostress {

// A policy small enough for tests, every code path of the real one: two cameras, three layers,
// padding words, a padding channel, norms away from one.
inline NanoConfig TinyConfig(int steps_per_token = 5,
                             NanoArchitecture architecture = NanoArchitecture::kPi0) {
  NanoConfig config;
  config.architecture = architecture;
  config.state_bins = 11;
  config.image_size = 16;
  config.conv_channels = {4, 6};
  config.max_words = 9;
  config.vocabulary_rows = 12;
  config.readout_tokens = 2;
  config.layers = 3;
  config.heads = 2;
  config.head_dim = 8;
  config.prefix_width = 12;
  config.prefix_mlp = 20;
  config.expert_width = 16;
  config.expert_mlp = 24;
  config.horizon = 10;
  config.steps_per_token = steps_per_token;
  return config;
}

inline NanoModel TinyModel(uint64_t seed = 3, int steps_per_token = 5,
                           NanoArchitecture architecture = NanoArchitecture::kPi0) {
  NanoModel model = RandomNanoModel(TinyConfig(steps_per_token, architecture), seed);
  torch::manual_seed(seed);
  for (torch::Tensor& tensor : model.tensors) {
    // Norms, biases and modulations start at zero.
    if (tensor.dim() == 1 || tensor.count_nonzero().item<int64_t>() == 0)
      tensor += torch::randn_like(tensor) * 0.2;
  }
  model.vocabulary = Vocabulary({"put", "the", "red", "bowl", "on", "plate"});
  for (int i = 0; i < model.config.state_dim; ++i)
    model.state.mean[i] = 0.1f * static_cast<float>(i);
  for (int i = 0; i < model.config.action_dim; ++i) {
    model.actions.mean[i] = 0.05f * static_cast<float>(i);
    model.actions.std[i] = 0.3f + 0.1f * static_cast<float>(i);
  }
  return model;
}

inline Observation TinyObservation(const PolicySpec& spec, int seed = 0) {
  Observation observation;
  observation.instruction = "Put the red bowl on the plate.";
  for (const std::string& camera : spec.cameras) {
    Image image{spec.image_width, spec.image_height, {}};
    image.data.resize(size_t{3} * image.width * image.height);
    for (size_t i = 0; i < image.data.size(); ++i) {
      image.data[i] = static_cast<uint8_t>(
          (i * 37 + static_cast<size_t>(seed) * 101 + camera.size() * 7) % 251);
    }
    observation.views.push_back({camera, image});
  }
  observation.proprioception =
      Eigen::VectorXf::LinSpaced(spec.state_dim, -0.4f, 0.5f + 0.1f * static_cast<float>(seed));
  return observation;
}

}  // namespace robostress
