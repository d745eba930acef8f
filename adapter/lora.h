#pragma once

#include <cstdint>
#include <vector>

#include "adapter/lora_options.h"
#include "adapter/velocity_field.h"
#include "common/random.h"

// Low-rank updates of linear layers, scale 1, in two ways:
//
//   per_matrix (PEFT)    y += B A x                     A [rank, in], B [out, rank]
//   per_head (openpi)    q, k, v: y_n += B_n A_n x      A [heads, rank, in], B [heads, out/heads,
//   rank]
//                        o: y += sum over n of B_n A_n x_n
//                                                       A [heads, rank, in/heads], B [heads, out,
//                                                       rank]
//
// where n counts the heads and x_n, y_n are a head's part. A layer with one head (k and v of pi0,
// gate, up, down of every model) is factored as a matrix in both ways.
namespace robostress {

const char* LoraKindName(LoraKind kind);  // "per_head", "per_matrix"

// Shapes of A and B of one target.
struct LoraShape {
  std::vector<int64_t> A, B;
};
LoraShape LoraShapeOf(const LoraTarget& target, LoraKind kind, int64_t rank);
// Sum over the targets, without making them.
int64_t NumLoraParameters(const std::vector<LoraTarget>& targets, LoraKind kind, int64_t rank);

// phi_0: A ~ N(0, init_std^2), drawn from `session` and the target's name, so a function of these
// alone; B = 0, so the adapted policy equals the base policy (paper, sec:supp_lora).
LoraWeights InitialLora(const std::vector<LoraTarget>& targets, LoraKind kind, int64_t rank,
                        double init_std, const StreamKey& session);

// What a pair adds to y: x [..., in] -> [..., out]. Differentiable in all arguments.
torch::Tensor LoraDelta(const torch::Tensor& x, const torch::Tensor& A, const torch::Tensor& B);

// A pair as one of matrices, A [R, in] and B [out, R], with the same product: R = heads x rank and
// zeros outside the heads' blocks for a pair per head, the pair itself otherwise.
struct MatrixPair {
  torch::Tensor A, B;
};
MatrixPair AsMatrices(const LoraTarget& target, const torch::Tensor& A, const torch::Tensor& B);

// Adapters of the rows of one batch, which may differ in kind and rank; null: no adapter.
// A [rows, R, in], B [rows, out, R] per target, R the largest rank (as matrices) in the batch.
struct LoraRows {
  std::vector<torch::Tensor> A, B;
};
LoraRows StackLora(const std::vector<LoraTarget>& targets,
                   const std::vector<const LoraWeights*>& rows);
// x [rows, T, in] -> [rows, T, out]: row i through its own pair.
torch::Tensor LoraRowsDelta(const torch::Tensor& x, const torch::Tensor& A, const torch::Tensor& B);

// A_0, B_0, A_1, B_1, ...: the order of gradients and Adam moments.
std::vector<torch::Tensor> Parameters(const LoraWeights& lora);
// The inverse of Parameters.
LoraWeights FromParameters(const std::vector<torch::Tensor>& parameters, uint64_t version);

// ||phi - phi_0||_2 over all A and B.
double LoraDistance(const LoraWeights& phi, const LoraWeights& phi_0);
int64_t NumParameters(const LoraWeights& lora);

}  // namespace robostress
