#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "eval/launch/server_source.h"

namespace robostress {

// True when HOST:PORT, or the server of a ws:// URL, accepts a connection within a second.
bool Accepts(const std::string& address);

// Servers that run already and hold one and the same policy: given in turn. Where there are
// several, one that accepts no connection is passed over while another does.
class ServersElsewhere {
 public:
  // `first`: which is given first; spreads those who begin at the same time.
  explicit ServersElsewhere(std::vector<std::string> addresses, size_t first = 0)
      : addresses_(std::move(addresses)), next_(first) {}

  bool empty() const { return addresses_.empty(); }
  ServerPlace Next();  // of at least one
  // Whether the place is gone and another one is there.
  bool Lost(const ServerPlace& place) const;

 private:
  const std::vector<std::string> addresses_;
  size_t next_;
};

}  // namespace robostress
