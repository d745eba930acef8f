#pragma once

#include <functional>

namespace robostress {

// Holds SIGINT and SIGTERM back from the calling thread and from what it starts or forks later.
void HoldInterruptions();

// Calls `end` with the first of them that was held back, on a thread that lives as long as the
// process.
void OnInterruption(std::function<void(int signal)> end);

}  // namespace robostress
