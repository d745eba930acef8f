#include "robot_client/can/socket_calls.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <string>

namespace robostress {
namespace {

class SystemCalls : public SocketCalls {
 public:
  int Socket(int domain, int type, int protocol) override { return socket(domain, type, protocol); }
  unsigned NameToIndex(const char* interface) override { return if_nametoindex(interface); }
  int SetOption(int socket, int level, int option, const void* value, socklen_t size) override {
    return setsockopt(socket, level, option, value, size);
  }
  int GetOption(int socket, int level, int option, void* value, socklen_t* size) override {
    return getsockopt(socket, level, option, value, size);
  }
  int InterfaceCall(int socket, unsigned long request, ifreq* interface) override {
    return ioctl(socket, request, interface);
  }
  int Carrier(const char* interface) override {
    char digit = '1';
    const std::string path = std::string("/sys/class/net/") + interface + "/carrier";
    if (const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC); file >= 0) {
      if (read(file, &digit, 1) != 1) digit = '1';
      close(file);
    }
    return digit == '0' ? 0 : 1;
  }
  int Bind(int socket, const sockaddr* address, socklen_t size) override {
    return bind(socket, address, size);
  }
  ssize_t Send(int socket, const void* data, size_t size, int flags) override {
    return send(socket, data, size, flags);
  }
  ssize_t Receive(int socket, msghdr* message, int flags) override {
    return recvmsg(socket, message, flags);
  }
  int Close(int socket) override { return close(socket); }
};

}  // namespace

SocketCalls& SystemSocketCalls() {
  static auto& calls = *new SystemCalls;
  return calls;
}

}  // namespace robostress
