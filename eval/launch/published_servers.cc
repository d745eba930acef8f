#include "eval/launch/published_servers.h"

#include <fcntl.h>
#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;
using SteadyClock = std::chrono::steady_clock;

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

absl::StatusOr<ServerPlace> ReadPlace(const std::string& file) {
  const absl::StatusOr<std::string> text = ReadFile(file);
  if (!text.ok()) return text.status();
  const json record = json::parse(*text, nullptr, false);
  if (!record.is_object() || !record.contains("address") || !record["address"].is_string() ||
      !record.contains("machine") || !record["machine"].is_string())
    return absl::DataLossError(absl::StrCat(file, " names no server"));
  return ServerPlace{record["address"], record["machine"]};
}

}  // namespace

bool Accepts(const std::string& address) {
  const size_t colon = address.rfind(':');
  if (colon == std::string::npos) return false;
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  if (getaddrinfo(address.substr(0, colon).c_str(), address.substr(colon + 1).c_str(), &hints,
                  &found) != 0)
    return false;
  bool accepts = false;
  for (const addrinfo* place = found; place != nullptr && !accepts; place = place->ai_next)
    accepts = Connects(*place);
  freeaddrinfo(found);
  return accepts;
}

absl::Status PublishServer(const Submission& submission, const std::string& policy, int index,
                           const ServerPlace& place) {
  const json record = {{"address", place.address}, {"machine", place.machine}};
  return WriteFileAtomically(submission.ServerFile(policy, index), record.dump() + "\n");
}

absl::StatusOr<ServerPlace> PublishedServers::Find(const std::string& policy) {
  if (!submission_.elsewhere().empty()) return ServerPlace{submission_.elsewhere(), "unknown"};
  const auto deadline = SteadyClock::now() + std::chrono::duration<double>(patience_s_);
  while (true) {
    for (int k = 0; k < submission_.servers(); ++k) {
      const int index = (preferred_ + k) % submission_.servers();
      const absl::StatusOr<ServerPlace> place = ReadPlace(submission_.ServerFile(policy, index));
      if (place.ok() && Accepts(place->address)) return place;
    }
    if (SteadyClock::now() > deadline) {
      return absl::UnavailableError(
          absl::StrCat("no server of policy ", policy, " has answered for ", patience_s_,
                       " s; its job's log is in ", submission_.run().path(), "/logs"));
    }
    pollfd item{signals_.fd(), POLLIN, 0};
    if (poll(&item, 1, 500) > 0) return absl::CancelledError("interrupted");
  }
}

bool PublishedServers::Lost(const std::string&, const ServerPlace& place) {
  return submission_.elsewhere().empty() && !Accepts(place.address);
}

}  // namespace robostress
