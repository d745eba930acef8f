#pragma once

namespace robostress {

// Whether this build can count: a sanitizer owns malloc.
bool CountsAllocations();
// Calls that reached malloc in this program so far, of any thread.
long Allocations();

}  // namespace robostress
