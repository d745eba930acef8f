#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/operations/published.h"

namespace robostress {

// What a caller may do. `predict`: sessions, predictions, statistics. `feedback`: what changes an
// adapter (executed chunks, import, roll-back) and its export. `metrics`: reads the figures for
// Prometheus. `admin`: AdminService, figures and the live page. None implies another.
enum class Scope : uint8_t { kPredict = 1, kFeedback = 2, kAdmin = 4, kMetrics = 8 };
inline constexpr Scope kScopes[] = {Scope::kPredict, Scope::kFeedback, Scope::kAdmin,
                                    Scope::kMetrics};
const char* ScopeName(Scope scope);

// What one caller may hold and ask for; 0: as much as the server allows anybody.
struct CallerLimits {
  int sessions = 0;         // open at once
  int rank = 0;             // of a method's LoRA
  int batch = 0;            // chunks of an update
  int update_interval = 0;  // at least so many chunks between two updates
  int buffer_chunks = 0;

  bool operator==(const CallerLimits&) const = default;
};

// Somebody who calls.
struct Caller {
  std::string name;  // as in the file; may be logged, the token never
  uint8_t scopes = 0;
  // Whose sessions they are: two calls are of one owner where this is equal. "token:NAME",
  // "certificate:SHA-256 of it"; empty: nobody is asked who he is.
  std::string owner;
  // Who shares limits where `owner` is empty: the peer's address without its port.
  std::string host;
  CallerLimits limits;

  bool operator==(const Caller&) const = default;
  bool Has(Scope scope) const { return (scopes & static_cast<uint8_t>(scope)) != 0; }
  const std::string& client() const { return owner.empty() ? host : owner; }
};
// Everybody, where nobody is asked: every scope.
Caller Anybody();

// The tokens that a server accepts. The file holds their SHA-256, so that who reads it cannot call:
//   tokens:
//     - {name: arm_1, sha256: <64 hex digits>, scopes: [predict, feedback], limits: {sessions: 2}}
// `limits` may be absent; its keys are CallerLimits' fields. Make one with:  openssl rand -hex 32 |
// tee arm_1.token | tr -d '\n' | sha256sum Immutable; any thread.
class AccessTokens {
 public:
  // Nobody is asked: every caller has every scope.
  AccessTokens() = default;
  // INVALID_ARGUMENT names file, entry and field.
  static absl::StatusOr<AccessTokens> Parse(const std::string& file, const std::string& text);
  static absl::StatusOr<AccessTokens> Load(const std::string& file);

  bool required() const { return required_; }
  // In the order of the file.
  std::vector<std::string> names() const;
  // `authorization` is the header's value: "Bearer TOKEN", "Api-Key TOKEN" (openpi) or "Basic ..."
  // with the token as password (browsers). UNAUTHENTICATED without a known token. What the caller
  // shows is hashed and compared with every entry, all bytes of each, whether or not one before it
  // matched: the time says nothing about what the right token is.
  absl::StatusOr<Caller> Authenticate(std::string_view authorization) const;
  // PERMISSION_DENIED names caller and scope.
  static absl::Status Require(const Caller& caller, Scope scope);
  absl::Status Check(std::string_view authorization, Scope scope) const;

  bool operator==(const AccessTokens&) const = default;

 private:
  struct Entry {
    std::array<uint8_t, 32> digest;
    Caller caller;
    bool operator==(const Entry&) const = default;
  };
  bool required_ = false;
  std::vector<Entry> entries_;
};

// The tokens of a running server: replaced when their file changes. After another generation, who
// was let in before may be asked again.
using TokenStore = Published<AccessTokens>;

}  // namespace robostress
