#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// Where a WebSocket is.
struct WebUrl {
  bool tls = false;    // wss
  std::string host;    // "127.0.0.1", "gpu.example", "::1"
  int port = 0;        // 1..65535
  std::string target;  // "/path?query"

  std::string authority() const;  // "gpu.example:8000", "[::1]:8000"
  std::string text() const;       // "ws://gpu.example:8000/path?query"
};

// Of "ws://HOST:PORT/PATH", "wss://..." or "HOST:PORT"; without a port 80, or 443 with TLS.
// INVALID_ARGUMENT holds the text and says what is wrong with it.
absl::StatusOr<WebUrl> ParseWebUrl(const std::string& text);

}  // namespace robostress
