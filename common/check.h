#pragma once

#include <cstdio>
#include <cstdlib>

// Aborts with file, line and condition when a programmer's invariant is broken. Torch's glog owns
// CHECK.
#define RS_CHECK(condition)                                                                  \
  do {                                                                                       \
    if (!(condition)) {                                                                      \
      std::fprintf(stderr, "%s:%d: invariant broken: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                          \
    }                                                                                        \
  } while (false)
