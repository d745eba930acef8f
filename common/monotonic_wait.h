#pragma once

#include "absl/base/thread_annotations.h"
#include "absl/functional/function_ref.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"

namespace robostress {

// Waits until `condition` holds, with `mu` held whenever it is asked, or until `timeout` has passed
// on the monotonic clock; returns what `condition` says then. absl::Mutex::AwaitWithTimeout counts
// the time of day: it gives up early, or a day late, when somebody sets the clock. The condition is
// asked whenever another thread lets go of `mu`.
bool AwaitFor(absl::Mutex& mu, absl::FunctionRef<bool()> condition, absl::Duration timeout)
    ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu);

}  // namespace robostress
