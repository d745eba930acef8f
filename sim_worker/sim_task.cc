#include "sim_worker/sim_task.h"

#include <utility>

#include "common/rollout/expert_policy.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeExpertPolicy(SimTask& task) {
  RS_ASSIGN_OR_RETURN(Expert expert, task.MakeExpert());
  return std::make_unique<ExpertPolicy>([expert = std::move(expert)] { return expert().command; });
}

}  // namespace robostress
