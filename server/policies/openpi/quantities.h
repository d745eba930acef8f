#pragma once

#include <torch/types.h>

#include <map>
#include <optional>
#include <set>
#include <string>

#include "absl/status/statusor.h"
#include "server/policies/openpi/flow.h"
#include "server/policies/openpi/oracle_inputs.h"

namespace robostress::openpi {

// Every intermediate of a network that a file of expected values may name, computed on demand:
//   siglip.patch_pos.C  siglip.post_layernorm.C  image_embeds.C           C: a camera
//   prefix.{embs,pad_mask,ar_mask,att_2d_mask,position_ids,out_normed}    kv.L.{key,value}
//   time_emb_tT  adarms_cond_tT  suffix.embs_tT  suffix.out_normed_tT     T: a time, x_t = noise
//   suffix.{pad_mask,ar_mask,att_2d_mask,position_ids}  v_tT              on the cached prefix
//   euler.time  euler.x  actions                                          on the cached prefix
//   loss.{x_t,u_t,v_t,elements,mean,att_2d_mask,position_ids}             joint pass
//   grad/P, d(loss.mean)/dP                    P: a weight or LoRA tensor by its name in the file
//   state_bins                                                            of pi0.5's prompt
// LibTorch's exceptions pass through.
class Quantities {
 public:
  // `gradients`: the P that will be asked for; everything else is frozen. `euler_steps` >= 1.
  Quantities(OpenpiModel model, OracleInputs inputs, const std::set<std::string>& gradients,
             int64_t euler_steps);

  // Undefined for an unknown name; an error when an input it needs is absent.
  absl::StatusOr<torch::Tensor> Compute(const std::string& name);
  // The same quantity by the other pass: v_tT jointly, loss.v_t on the cached prefix. Undefined for
  // all other names.
  torch::Tensor ComputeByOtherPass(const std::string& name);

 private:
  torch::Tensor VisionQuantity(const std::string& name) const;
  torch::Tensor PrefixQuantity(const std::string& name);
  torch::Tensor CacheQuantity(const std::string& name);
  torch::Tensor SuffixQuantity(const std::string& name);
  torch::Tensor TimedQuantity(const std::string& name);
  torch::Tensor EulerQuantity(const std::string& name);
  torch::Tensor LossQuantity(const std::string& name);
  torch::Tensor GradientQuantity(const std::string& name);
  torch::Tensor StateBins() const;

  const Tokens& prefix();
  const PrefixContext& context();
  const FlowLoss& loss();

  OpenpiModel model_;
  OracleInputs inputs_;
  int64_t euler_steps_;
  std::map<std::string, torch::Tensor> leaves_;  // parameters with a gradient, by name
  std::optional<Tokens> prefix_;
  std::optional<PrefixContext> context_;
  std::optional<EulerTrajectory> euler_;
  std::optional<FlowLoss> loss_;
  std::map<std::string, torch::Tensor> gradients_;
};

}  // namespace robostress::openpi
