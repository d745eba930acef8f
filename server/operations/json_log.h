#pragma once

#include <string>

#include "absl/status/status.h"

namespace robostress {

// How the process logs, on standard error. `format`: "text", or "json": one object per line with
// time (UTC), level, message, thread, and, where a prediction or a feedback chunk is served,
// session and step (the current PredictionTrace). `level`: debug (one line per prediction), info,
// warn, error. INVALID_ARGUMENT: another word.
absl::Status SetUpLog(const std::string& format, const std::string& level);

}  // namespace robostress
