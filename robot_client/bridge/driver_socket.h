#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/clock.h"

namespace robostress::bridge {

// The client's end of a stream to a driver process. Nothing here waits but Connect, and nothing
// allocates after it. One thread.
class DriverSocket {
 public:
  // `address`: unix:PATH of the socket that the driver listens on. UNAVAILABLE where nobody does
  // until `wait_s` [s] are over.
  static absl::StatusOr<std::unique_ptr<DriverSocket>> Connect(const std::string& address,
                                                               double wait_s, Clock& clock);
  explicit DriverSocket(int descriptor);  // takes a connected, non-blocking stream socket
  ~DriverSocket();
  DriverSocket(const DriverSocket&) = delete;
  DriverSocket& operator=(const DriverSocket&) = delete;

  enum class Result : uint8_t { kDone, kWouldWait, kClosed };
  // All bytes or none; kWouldWait: the driver does not read.
  Result Send(const uint8_t* data, size_t size);
  // As many as there are, at most `size`; `received` only with kDone.
  Result Receive(uint8_t* data, size_t size, size_t& received);
  void Close();
  bool closed() const { return descriptor_ < 0; }

 private:
  int descriptor_;
};

}  // namespace robostress::bridge
