#include "sim_worker/libero/libero_expert.h"

#include "sim_worker/libero/libero_sim_task.h"

namespace robostress::libero {

absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeLiberoExpert(LiberoSimTask&) {
  return absl::UnimplementedError("no script");
}

}  // namespace robostress::libero
