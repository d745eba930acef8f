#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/wire/policy_conversation.h"

namespace robostress {

// vla-eval's wire, the client's side: vla_eval/protocol and vla_eval/connection.py of
// allenai/vla-evaluation-harness, protocol version 1. A message is a map of type, payload, seq and
// timestamp. The client speaks first (hello), tells when an episode starts and ends, and asks at
// every control step; the server hands out one action, and echoes seq.
//
// The hello's observation_params say what the model wants to see. They are heeded as vla-eval's
// LIBERO benchmark heeds them: send_state, send_wrist_image (the second camera),
// quat_no_antipodal (of a state of 8 numbers, entries 3 to 5: an axis-angle that may be longer than
// pi); absolute_action is refused. Errors: PolicyConversation::Open's.
absl::StatusOr<std::unique_ptr<PolicyConversation>> OpenVlaEvalConversation(
    const std::string& url, const OpenpiDialect& dialect, const OpenpiConnectionOptions& options);

}  // namespace robostress
