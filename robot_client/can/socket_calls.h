#pragma once

#include <net/if.h>
#include <sys/socket.h>
#include <sys/types.h>

#include <cstddef>

namespace robostress {

// The system calls of a SocketCAN node, in a table so that a test can answer them: a machine
// without CAN hardware and without the vcan module still runs every path of SocketCanBus. Each
// function is the call of its name: -1 and errno on failure.
class SocketCalls {
 public:
  virtual ~SocketCalls() = default;
  virtual int Socket(int domain, int type, int protocol) = 0;
  virtual unsigned NameToIndex(const char* interface) = 0;  // 0 on failure
  virtual int SetOption(int socket, int level, int option, const void* value, socklen_t size) = 0;
  virtual int GetOption(int socket, int level, int option, void* value, socklen_t* size) = 0;
  virtual int InterfaceCall(int socket, unsigned long request, ifreq* interface) = 0;  // ioctl
  // 0: the interface has no carrier, as a CAN controller that has left the bus; 1: it has, or the
  // system does not tell. From /sys/class/net; SIOCGIFFLAGS tells it up to a second later.
  virtual int Carrier(const char* interface) = 0;
  virtual int Bind(int socket, const sockaddr* address, socklen_t size) = 0;
  virtual ssize_t Send(int socket, const void* data, size_t size, int flags) = 0;
  virtual ssize_t Receive(int socket, msghdr* message, int flags) = 0;
  virtual int Close(int socket) = 0;
};

// The system's.
SocketCalls& SystemSocketCalls();

}  // namespace robostress
