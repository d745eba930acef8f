#include "adapter/measured_chunk.h"

#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "adapter/plausible_motion.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<MeasuredChunk> MeasuredChunk::Create(const ExecutedChunk& reported,
                                                    const PolicySpec& policy,
                                                    const ResidualOptions& options) {
  RS_RETURN_IF_ERROR(ValidateExecutedChunk(reported, policy.action_dim, options.space));
  const auto steps = static_cast<int>(reported.steps.size());
  if (reported.first_step > policy.horizon - steps) {
    return absl::InvalidArgumentError(
        absl::StrCat("executed chunk ", reported.sequence, " covers steps ", reported.first_step,
                     " to ", int64_t{reported.first_step} + steps - 1, ", policy '", policy.name,
                     "' predicts ", policy.horizon));
  }
  MeasuredChunk chunk(reported);
  chunk.steps_masked_ = static_cast<uint64_t>(absl::c_count(reported.masked, true));
  const std::vector<bool> impossible = ImpossibleSteps(reported);
  for (size_t i = 0; i < impossible.size(); ++i)
    chunk.steps_impossible_ += impossible[i] && !reported.IsMasked(i);
  if (!impossible.empty()) chunk.masked_ = WithMasked(reported, impossible);
  chunk.residual_ = ChunkResidual(chunk.usable(), options);
  return chunk;
}

}  // namespace robostress
