#pragma once

#include "absl/status/statusor.h"
#include "common/types.h"
#include "proto/robostress/v1/policy.pb.h"

// What a policy sees; checked and exact as in convert_specs.h.
namespace robostress {

robostress::v1::Observation ToProto(const Observation& observation);
absl::StatusOr<Observation> FromProto(const robostress::v1::Observation& message);

}  // namespace robostress
