#include "server/wire/grpc/read_meter.h"

#include <arpa/inet.h>
#include <dirent.h>
#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstdlib>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// gRPC's name of the other end of a socket; empty: it is none, or not of the Internet.
std::string PeerOf(int descriptor) {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  if (getpeername(descriptor, reinterpret_cast<sockaddr*>(&address), &size) != 0) return "";
  char text[INET6_ADDRSTRLEN] = "";
  if (address.ss_family == AF_INET) {
    const auto& v4 = reinterpret_cast<const sockaddr_in&>(address);
    inet_ntop(AF_INET, &v4.sin_addr, text, sizeof text);
    return absl::StrCat("ipv4:", text, ":", ntohs(v4.sin_port));
  }
  if (address.ss_family != AF_INET6) return "";
  const auto& v6 = reinterpret_cast<const sockaddr_in6&>(address);
  if (IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr)) {
    inet_ntop(AF_INET, v6.sin6_addr.s6_addr + 12, text, sizeof text);
    return absl::StrCat("ipv4:", text, ":", ntohs(v6.sin6_port));
  }
  inet_ntop(AF_INET6, &v6.sin6_addr, text, sizeof text);
  return absl::StrCat("ipv6:%5B", text, "%5D:", ntohs(v6.sin6_port));
}

// False: the kernel does not say.
bool ReceivedBy(int descriptor, uint64_t& bytes) {
  tcp_info info{};
  socklen_t size = sizeof info;
  if (getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return false;
  if (size < offsetof(tcp_info, tcpi_bytes_received) + sizeof info.tcpi_bytes_received)
    return false;
  bytes = info.tcpi_bytes_received;
  return true;
}

// The sockets of this process by the names of their other ends.
std::unordered_map<std::string, int> Sockets() {
  std::unordered_map<std::string, int> sockets;
  const std::unique_ptr<DIR, int (*)(DIR*)> folder(opendir("/proc/self/fd"), &closedir);
  if (folder == nullptr) return sockets;
  while (const dirent* entry = readdir(folder.get())) {
    const int descriptor = std::atoi(entry->d_name);
    if (std::string peer = PeerOf(descriptor); !peer.empty()) sockets[std::move(peer)] = descriptor;
  }
  return sockets;
}

}  // namespace

void ReadMeter::Begin(const std::string& peer, size_t most) {
  absl::MutexLock lock(&mu_);
  Connection& connection = connections_[peer];
  ++connection.reads;
  connection.allowed += most;
}

void ReadMeter::End(const std::string& peer, size_t most, size_t bytes) {
  absl::MutexLock lock(&mu_);
  const auto found = connections_.find(peer);
  Connection& connection = found->second;
  connection.allowed -= most;
  // Frames of 16 KiB have headers of 9 bytes; TLS adds 22 to as much; a call's own headers.
  connection.credit += bytes + bytes / 64 + 1024;
  if (--connection.reads == 0) connections_.erase(found);
}

std::vector<std::string> ReadMeter::Over() {
  std::vector<std::string> over;
  absl::MutexLock lock(&mu_);
  std::unordered_map<std::string, int> sockets;
  bool listed = false;
  for (auto& [peer, connection] : connections_) {
    if (peer.rfind("ipv", 0) != 0) continue;
    uint64_t received = 0;
    // A number may be another socket's by now.
    if (connection.descriptor < 0 || PeerOf(connection.descriptor) != peer) {
      if (!listed) sockets = Sockets();
      listed = true;
      const auto found = sockets.find(peer);
      if (found == sockets.end() || !ReceivedBy(found->second, received)) continue;
      connection.descriptor = found->second;
      connection.base = received;
      connection.credit = 0;
      continue;
    }
    if (!ReceivedBy(connection.descriptor, received)) continue;
    if (received > connection.base + connection.credit + connection.allowed + kSlack)
      over.push_back(peer);
  }
  return over;
}

}  // namespace robostress
