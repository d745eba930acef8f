#pragma once

#include <cstdint>
#include <string_view>

#include "absl/types/span.h"
#include "server/operations/access_tokens.h"

namespace robostress {

// One thing that can be asked of a server, over any of its wires.
struct AccessRule {
  enum class Wire { kPolicy, kAdmin, kHttp, kWebSocket };  // gRPC's two services, pages, openpi
  Wire wire;
  const char* what;     // the method's name, the page's path, the message's part
  uint8_t scopes;       // any one of these lets a caller in; 0: everybody, without a token
  bool of_one_session;  // of the caller's own only (AdminService: of anybody's)
};

// Everything that can be asked, once. What is not in it is refused.
absl::Span<const AccessRule> AccessTable();

// Null: there is no such thing.
const AccessRule* FindRule(AccessRule::Wire wire, std::string_view what);

// Whether a caller may ask for it. PERMISSION_DENIED names caller and scopes; NOT_FOUND: there is
// no such thing.
absl::Status Allow(const Caller& caller, AccessRule::Wire wire, std::string_view what);
// The same of somebody who shows `authorization`, or needs not. UNAUTHENTICATED: no known token.
absl::StatusOr<Caller> Allow(const AccessTokens& tokens, std::string_view authorization,
                             AccessRule::Wire wire, std::string_view what);

}  // namespace robostress
