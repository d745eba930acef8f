#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// What a caller may do. `predict`: sessions, predictions, statistics. `feedback`: what changes an
// adapter (executed chunks, import, roll-back) and its export. `admin`: AdminService, metrics and
// the live page. None implies another.
enum class Scope : uint8_t { kPredict = 1, kFeedback = 2, kAdmin = 4 };
const char* ScopeName(Scope scope);

// Somebody who showed a token.
struct Caller {
  std::string name;  // as in the file; may be logged, the token never
  uint8_t scopes = 0;
  bool Has(Scope scope) const { return (scopes & static_cast<uint8_t>(scope)) != 0; }
};

// The tokens that a server accepts. The file holds their SHA-256, so that who reads it cannot call:
//   tokens:
//     - {name: arm_1, sha256: <64 hex digits>, scopes: [predict, feedback]}
// Make one with:  openssl rand -hex 32 | tee arm_1.token | tr -d '\n' | sha256sum
// Immutable; any thread.
class AccessTokens {
 public:
  // Nobody is asked: every caller has every scope.
  AccessTokens() = default;
  // INVALID_ARGUMENT names file, entry and field.
  static absl::StatusOr<AccessTokens> Parse(const std::string& file, const std::string& text);
  static absl::StatusOr<AccessTokens> Load(const std::string& file);

  bool required() const { return required_; }
  // `authorization` is the header's value: "Bearer TOKEN", "Api-Key TOKEN" (openpi) or "Basic ..."
  // with the token as password (browsers). UNAUTHENTICATED without a known token. What the caller
  // shows is hashed and compared with every entry, all bytes of each, whether or not one before it
  // matched: the time says nothing about what the right token is.
  absl::StatusOr<Caller> Authenticate(std::string_view authorization) const;
  // PERMISSION_DENIED names caller and scope.
  static absl::Status Require(const Caller& caller, Scope scope);
  absl::Status Check(std::string_view authorization, Scope scope) const;

 private:
  struct Entry {
    std::array<uint8_t, 32> digest;
    Caller caller;
  };
  bool required_ = false;
  std::vector<Entry> entries_;
};

}  // namespace robostress
