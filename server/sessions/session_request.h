#pragma once

#include "adapter/update_guard.h"
#include "common/rollout/session_spec.h"

namespace robostress {

// What a client asks for when it opens a session.
struct SessionRequest {
  SessionSpec spec;
  GuardOptions guard;
  SessionScheduling scheduling;
};

}  // namespace robostress
