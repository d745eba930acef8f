#include "server/policies/openpi/prefix_encoder.h"

#include <torch/types.h>

#include <cmath>

#include "server/policies/openpi/masks.h"

namespace robostress::openpi {
namespace {

constexpr double kLayerNormEpsilon = 1e-6;

torch::Tensor LayerNormed(const LayerNorm& norm, const torch::Tensor& x) {
  return at::layer_norm(x, {x.size(-1)}, norm.weight, norm.bias, kLayerNormEpsilon);
}

// images [N, 3, s, s] -> tokens [N, patches, prefix_width].
torch::Tensor EncodeImages(const InferenceSetup& setup, const InferenceWeights& w,
                           const torch::Tensor& images) {
  const OpenpiConfig& c = setup.config;
  const int64_t count = images.size(0);
  const AttentionShape shape = {c.vision_heads, c.vision_heads, c.vision_width / c.vision_heads};
  const torch::Tensor grid =
      at::conv2d(images.to(setup.device, torch::kFloat32), w.patch_weight, w.patch_bias, c.patch);
  torch::Tensor x = (grid.flatten(2).transpose(1, 2) + w.position)
                        .to(setup.activations)
                        .reshape({-1, c.vision_width});  // [N patches, vision_width]
  for (const VisionLayer& layer : w.vision) {
    const Heads heads = SplitHeads(Project(layer.qkv, LayerNormed(layer.norm1, x)), count, shape,
                                   shape.heads, nullptr);
    x.add_(Project(layer.out, Attend(heads.q, heads.k, heads.v, {}, count, shape)));
    torch::Tensor hidden = Project(layer.fc1, LayerNormed(layer.norm2, x));
    Gelu(hidden);
    x.add_(Project(layer.fc2, hidden));
  }
  return Project(w.projector, LayerNormed(w.vision_norm, x))
      .view({count, c.patches(), c.prefix_width});
}

// Tokens of every valid image, camera by camera; row b of camera i is at `index[i][b]`, -1 when
// absent.
struct ImageTokens {
  torch::Tensor tokens;  // [N, patches, prefix_width]
  std::vector<std::vector<int64_t>> index;
};

ImageTokens EncodeValidImages(const InferenceSetup& setup, const InferenceWeights& weights,
                              const ModelInputs& inputs) {
  ImageTokens result;
  std::vector<torch::Tensor> images;
  int64_t next = 0;
  for (size_t i = 0; i < inputs.images.size(); ++i) {
    const torch::Tensor mask = inputs.image_masks[i].to(torch::kCPU).contiguous();
    std::vector<int64_t>& index = result.index.emplace_back(mask.size(0), -1);
    for (int64_t b = 0; b < mask.size(0); ++b) {
      if (!mask.data_ptr<bool>()[b]) continue;
      images.push_back(inputs.images[i][b]);
      index[b] = next++;
    }
  }
  if (next > 0) result.tokens = EncodeImages(setup, weights, at::stack(images));
  return result;
}

// Valid tokens of each row, [length, prefix_width] in the order of the prefix.
std::vector<torch::Tensor> ValidTokens(const InferenceSetup& setup, const InferenceWeights& w,
                                       const ModelInputs& inputs) {
  const ImageTokens images = EncodeValidImages(setup, w, inputs);
  const double scale = std::sqrt(static_cast<double>(setup.config.prefix_width));
  const torch::Tensor mask = inputs.token_mask.to(torch::kCPU);
  std::vector<torch::Tensor> rows;
  for (int64_t b = 0; b < inputs.tokens.size(0); ++b) {
    std::vector<torch::Tensor> parts;
    for (const std::vector<int64_t>& index : images.index) {
      if (index[b] >= 0) parts.push_back(images.tokens[index[b]]);
    }
    const torch::Tensor ids = inputs.tokens[b].to(torch::kCPU).masked_select(mask[b]);
    parts.push_back(
        (at::embedding(w.embedding, ids.to(setup.device)) * scale).to(setup.activations));
    rows.push_back(at::cat(parts, 0));
  }
  return rows;
}

}  // namespace

torch::Tensor KeyMask(const torch::Tensor& mask, const torch::Device& device) {
  return AdditiveMask(mask.unsqueeze(1)).squeeze(1).to(device);
}

PolicyContext EncodePrefix(const InferenceSetup& setup, const InferenceWeights& weights,
                           const ModelInputs& inputs) {
  const std::vector<torch::Tensor> rows = ValidTokens(setup, weights, inputs);
  const int64_t batch = static_cast<int64_t>(rows.size());
  std::vector<int64_t> lengths;
  for (const torch::Tensor& row : rows) lengths.push_back(row.size(0));
  const int64_t length = *std::max_element(lengths.begin(), lengths.end());
  PolicyContext context;
  context.state = inputs.state;
  context.prefix_mask = at::arange(length).unsqueeze(0) < torch::tensor(lengths).unsqueeze(1);

  // Rows that end early repeat zeros, which no valid query sees.
  torch::Tensor x = at::zeros({batch, length, setup.config.prefix_width}, rows[0].options());
  for (int64_t b = 0; b < batch; ++b) x[b].narrow(0, 0, lengths[b]).copy_(rows[b]);
  x = x.view({batch * length, setup.config.prefix_width});
  torch::Tensor mask;
  if (!context.prefix_mask.all().item<bool>()) mask = KeyMask(context.prefix_mask, setup.device);
  const Rotary rotary =
      MakeRotary(at::arange(length).repeat({batch}).to(setup.device), setup.config.head_dim);

  const std::vector<Modulation>& norms = weights.prefix.NormsAt(0);
  torch::Tensor branch;  // what the layer before adds to x
  for (size_t i = 0; i < weights.prefix.layers.size(); ++i) {
    const InferenceLayer& layer = weights.prefix.layers[i];
    const bool last = i + 1 == weights.prefix.layers.size();
    const Heads heads = SplitHeads(Project(layer.qkv, AddAndNormalise(x, branch, {}, norms[2 * i])),
                                   batch, setup.shape(), last ? 0 : setup.config.heads, &rotary);
    const auto store = [&](const torch::Tensor& of_heads) {
      return of_heads.view({batch, setup.config.kv_heads, length, setup.config.head_dim})
          .to(setup.stored);
    };
    context.keys.push_back(store(heads.k));
    context.values.push_back(store(heads.v));
    if (last) break;
    branch = Project(layer.o, Attend(heads.q, heads.k, heads.v, mask, batch, setup.shape()));
    branch = Project(layer.gate_up, AddAndNormalise(x, branch, {}, norms[2 * i + 1]));
    branch = Project(layer.down, GeGlu(branch));
  }
  return context;
}

}  // namespace robostress::openpi
