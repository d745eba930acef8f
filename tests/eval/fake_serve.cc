// A stand-in for robostress-serve: publishes a port that accepts connections and waits to be
// terminated. With
// FAKE_SERVER_FAILS set it ends at once with a message, as a server whose weights are missing does;
// with FAKE_SERVER_LIFETIME_MS later.

#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>

#include "common/atomic_file.h"

namespace {

// A port of this machine that accepts connections; 0 on failure.
int Listen() {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in place{};
  place.sin_family = AF_INET;
  place.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(place);
  if (fd < 0 || bind(fd, reinterpret_cast<sockaddr*>(&place), size) != 0 || listen(fd, 64) != 0 ||
      getsockname(fd, reinterpret_cast<sockaddr*>(&place), &size) != 0)
    return 0;
  return ntohs(place.sin_port);
}

}  // namespace

int main(int argc, char** argv) {
  if (std::getenv("FAKE_SERVER_FAILS") != nullptr) {
    std::fprintf(stderr, "fake server: weights not found\n");
    return 4;
  }
  const int port = Listen();
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::string(argv[i]) == "--port-file" &&
        (port == 0 ||
         !robostress::WriteFileAtomically(argv[i + 1], std::to_string(port) + "\n").ok()))
      return 1;
  }
  if (const char* lifetime_ms = std::getenv("FAKE_SERVER_LIFETIME_MS"); lifetime_ms != nullptr) {
    poll(nullptr, 0, std::atoi(lifetime_ms));
    std::fprintf(stderr, "fake server: out of memory\n");
    return 5;
  }
  while (true) pause();
}
