#include "eval/launch/servers_elsewhere.h"

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "absl/strings/str_cat.h"
#include "common/wire/web_url.h"

namespace robostress {
namespace {

constexpr int kConnectMs = 1000;

bool Connects(const addrinfo& place) {
  const int fd = socket(place.ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0) return false;
  bool connected = connect(fd, place.ai_addr, place.ai_addrlen) == 0;
  if (!connected && errno == EINPROGRESS) {
    pollfd item{fd, POLLOUT, 0};
    int error = 1;
    socklen_t size = sizeof(error);
    connected = poll(&item, 1, kConnectMs) == 1 &&
                getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size) == 0 && error == 0;
  }
  close(fd);
  return connected;
}

}  // namespace

bool Accepts(const std::string& address) {
  const absl::StatusOr<WebUrl> url = ParseWebUrl(address);
  if (!url.ok()) return false;
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  if (getaddrinfo(url->host.c_str(), absl::StrCat(url->port).c_str(), &hints, &found) != 0)
    return false;
  bool accepts = false;
  for (const addrinfo* place = found; place != nullptr && !accepts; place = place->ai_next)
    accepts = Connects(*place);
  freeaddrinfo(found);
  return accepts;
}

ServerPlace ServersElsewhere::Next() {
  for (size_t k = 0; addresses_.size() > 1 && k < addresses_.size(); ++k) {
    const std::string& address = addresses_[next_++ % addresses_.size()];
    if (Accepts(address)) return {address, "unknown"};
  }
  return {addresses_[next_++ % addresses_.size()], "unknown"};  // its worker says what is wrong
}

bool ServersElsewhere::Lost(const ServerPlace& place) const {
  return addresses_.size() > 1 && !Accepts(place.address) &&
         std::any_of(addresses_.begin(), addresses_.end(), Accepts);
}

}  // namespace robostress
