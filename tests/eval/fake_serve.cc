// A stand-in for robostress-serve: publishes a port and waits to be terminated. With
// FAKE_SERVER_FAILS set it ends at once with a message, as a server whose weights are missing does;
// with FAKE_SERVER_LIFETIME_MS later.

#include <poll.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>

#include "common/atomic_file.h"

int main(int argc, char** argv) {
  if (std::getenv("FAKE_SERVER_FAILS") != nullptr) {
    std::fprintf(stderr, "fake server: weights not found\n");
    return 4;
  }
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::string(argv[i]) == "--port-file" &&
        !robostress::WriteFileAtomically(argv[i + 1], "127.0.0.1:4242\n").ok())
      return 1;
  }
  if (const char* lifetime_ms = std::getenv("FAKE_SERVER_LIFETIME_MS"); lifetime_ms != nullptr) {
    poll(nullptr, 0, std::atoi(lifetime_ms));
    std::fprintf(stderr, "fake server: out of memory\n");
    return 5;
  }
  while (true) pause();
}
