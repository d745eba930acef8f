#pragma once

#include <atomic>
#include <semaphore>
#include <string>
#include <thread>

#include "robot_client/can/can_bus.h"
#include "robot_client/can/socket_calls.h"

namespace robostress {

// Takes a CAN interface down and up on request: what ends a bus-off whose device has no restart of
// its own. The kernel closes and opens the device, which lasts up to some hundred milliseconds on
// USB; so that a control loop never waits for it, a thread of its own ("can-restart") does it.
class InterfaceRestart {
 public:
  InterfaceRestart(std::string interface, SocketCalls& calls);  // calls outlive it
  ~InterfaceRestart();  // waits for a restart that is under way
  InterfaceRestart(const InterfaceRestart&) = delete;
  InterfaceRestart& operator=(const InterfaceRestart&) = delete;

  // Never blocks, never allocates; nothing happens while one is under way.
  void Ask();
  bool under_way() const { return asked_; }
  // Of the last one that ended.
  CanRestart result() const { return result_; }

 private:
  void Serve();
  CanRestart DownAndUp();

  const std::string interface_;
  SocketCalls& calls_;
  std::atomic<bool> asked_ = false, ending_ = false;
  std::atomic<CanRestart> result_ = CanRestart::kNone;
  std::binary_semaphore wake_{0};
  std::thread thread_;
};

}  // namespace robostress
