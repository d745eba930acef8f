#include "robot_client/can/interface_restart.h"

#include <linux/can.h>
#include <linux/can/raw.h>
#include <pthread.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cerrno>

namespace robostress {

InterfaceRestart::InterfaceRestart(std::string interface, SocketCalls& calls)
    : interface_(std::move(interface)), calls_(calls), thread_([this] { Serve(); }) {}

InterfaceRestart::~InterfaceRestart() {
  ending_ = true;
  if (!asked_.exchange(true)) wake_.release();
  thread_.join();
}

void InterfaceRestart::Ask() {
  if (!asked_.exchange(true)) wake_.release();
}

void InterfaceRestart::Serve() {
  pthread_setname_np(pthread_self(), "can-restart");
  while (true) {
    wake_.acquire();
    if (ending_) return;
    result_ = DownAndUp();
    asked_ = false;
    if (ending_) return;
  }
}

CanRestart InterfaceRestart::DownAndUp() {
  const int socket = calls_.Socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
  if (socket < 0) return CanRestart::kFailed;
  ifreq request{};
  std::copy_n(interface_.begin(), std::min(interface_.size(), size_t{IFNAMSIZ - 1}),
              request.ifr_name);
  CanRestart result = CanRestart::kDone;
  if (calls_.InterfaceCall(socket, SIOCGIFFLAGS, &request) != 0) result = CanRestart::kFailed;
  for (const bool up : {false, true}) {
    if (result != CanRestart::kDone) break;
    request.ifr_flags =
        static_cast<short>(up ? request.ifr_flags | IFF_UP : request.ifr_flags & ~IFF_UP);
    if (calls_.InterfaceCall(socket, SIOCSIFFLAGS, &request) != 0)
      result = errno == EPERM ? CanRestart::kNoRights : CanRestart::kFailed;
  }
  calls_.Close(socket);
  return result;
}

}  // namespace robostress
