#include "server/operations/access_tokens.h"

#include <openssl/crypto.h>
#include <openssl/sha.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <charconv>
#include <set>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint64_t kMaxFileBytes = 1 << 20;
constexpr size_t kMaxTokens = 4096;
constexpr size_t kMaxShownBytes = 4096;  // of an Authorization header
constexpr int kMostLimit = 1 << 20;

using Digest = std::array<uint8_t, SHA256_DIGEST_LENGTH>;

Digest DigestOf(std::string_view token) {
  Digest digest;
  SHA256(reinterpret_cast<const unsigned char*>(token.data()), token.size(), digest.data());
  return digest;
}

bool ParseDigest(const std::string& hex, Digest& digest) {
  const auto is_hex = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
  if (hex.size() != 2 * digest.size() || !std::all_of(hex.begin(), hex.end(), is_hex)) return false;
  for (size_t i = 0; i < digest.size(); ++i)
    std::from_chars(hex.data() + 2 * i, hex.data() + 2 * i + 2, digest[i], 16);
  return true;
}

bool ParseScope(const std::string& name, uint8_t& scopes) {
  for (const Scope scope : kScopes) {
    if (name != ScopeName(scope)) continue;
    scopes |= static_cast<uint8_t>(scope);
    return true;
  }
  return false;
}

// Null: there is no such limit.
int* LimitOf(const std::string& key, CallerLimits& limits) {
  for (const auto& [name, limit] : {std::pair<const char*, int*>{"sessions", &limits.sessions},
                                    {"rank", &limits.rank},
                                    {"batch", &limits.batch},
                                    {"update_interval", &limits.update_interval},
                                    {"buffer_chunks", &limits.buffer_chunks}})
    if (key == name) return limit;
  return nullptr;
}

// The token in a header; false: a form that is not known.
bool TokenOf(std::string_view authorization, std::string& token) {
  const size_t space = authorization.find(' ');
  if (space == std::string_view::npos || authorization.size() > kMaxShownBytes) return false;
  std::string kind(authorization.substr(0, space));
  std::transform(kind.begin(), kind.end(), kind.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  token = std::string(authorization.substr(space + 1));
  if (kind == "bearer" || kind == "api-key") return true;
  if (kind != "basic") return false;
  std::string pair;
  if (!absl::Base64Unescape(token, &pair)) return false;
  const size_t colon = pair.find(':');
  if (colon == std::string::npos) return false;
  token = pair.substr(colon + 1);
  return true;
}

}  // namespace

const char* ScopeName(Scope scope) {
  switch (scope) {
    case Scope::kPredict:
      return "predict";
    case Scope::kFeedback:
      return "feedback";
    case Scope::kAdmin:
      return "admin";
    case Scope::kMetrics:
      return "metrics";
  }
  return "";
}

Caller Anybody() {
  Caller caller;
  caller.name = "anybody";
  for (const Scope scope : kScopes) caller.scopes |= static_cast<uint8_t>(scope);
  return caller;
}

absl::StatusOr<AccessTokens> AccessTokens::Load(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(file, kMaxFileBytes));
  return Parse(file, text);
}

absl::StatusOr<AccessTokens> AccessTokens::Parse(const std::string& file, const std::string& text) {
  const auto refuse = [&file](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", parts...));
  };
  AccessTokens tokens;
  tokens.required_ = true;
  std::set<std::string> names;
  std::set<Digest> digests;
  try {
    const YAML::Node root = YAML::Load(text);
    if (!root.IsMap() || root.size() != 1 || !root["tokens"] || !root["tokens"].IsSequence())
      return refuse("must hold one list, tokens:");
    if (root["tokens"].size() > kMaxTokens)
      return refuse("holds ", root["tokens"].size(), " tokens, at most ", kMaxTokens, " are taken");
    for (const YAML::Node& node : root["tokens"]) {
      const std::string at = absl::StrCat("tokens[", tokens.entries_.size(), "]");
      if (!node.IsMap()) return refuse(at, " must be {name, sha256, scopes}");
      for (const auto& pair : node) {
        const std::string key = pair.first.as<std::string>();
        if (key != "name" && key != "sha256" && key != "scopes" && key != "limits")
          return refuse(at, " has an unknown key '", absl::CHexEscape(key),
                        "'; known: name, sha256, scopes, limits");
      }
      if (!node["name"] || !node["sha256"] || !node["scopes"] || !node["scopes"].IsSequence())
        return refuse(at, " must have name, sha256 and a list of scopes");
      Entry entry;
      entry.caller.name = node["name"].as<std::string>();
      if (entry.caller.name.empty() || !names.insert(entry.caller.name).second)
        return refuse(at, ".name is empty or names two tokens");
      if (!ParseDigest(node["sha256"].as<std::string>(), entry.digest))
        return refuse(at, ".sha256 must be 64 lower-case hex digits: printf %s TOKEN | sha256sum");
      if (!digests.insert(entry.digest).second) return refuse(at, ".sha256 occurs twice");
      for (const YAML::Node& scope : node["scopes"]) {
        if (!ParseScope(scope.as<std::string>(), entry.caller.scopes))
          return refuse(at, ".scopes: must be of predict, feedback, admin, metrics");
      }
      entry.caller.owner = absl::StrCat("token:", entry.caller.name);
      if (const YAML::Node limits = node["limits"]) {
        if (!limits.IsMap()) return refuse(at, ".limits must be a map");
        for (const auto& pair : limits) {
          const std::string key = pair.first.as<std::string>();
          int* const limit = LimitOf(key, entry.caller.limits);
          if (limit == nullptr)
            return refuse(at, ".limits has an unknown key '", absl::CHexEscape(key),
                          "'; known: sessions, rank, batch, update_interval, buffer_chunks");
          const std::string value = pair.second.as<std::string>();
          if (!absl::SimpleAtoi(value, limit) || *limit < 1 || *limit > kMostLimit)
            return refuse(at, ".limits.", key, " is '", absl::CHexEscape(value), "', must be 1..",
                          kMostLimit);
        }
      }
      tokens.entries_.push_back(std::move(entry));
    }
  } catch (const YAML::Exception& error) {
    return refuse("line ", error.mark.line + 1, ": no YAML that holds tokens");
  }
  return tokens;
}

std::vector<std::string> AccessTokens::names() const {
  std::vector<std::string> names;
  for (const Entry& entry : entries_) names.push_back(entry.caller.name);
  return names;
}

absl::StatusOr<Caller> AccessTokens::Authenticate(std::string_view authorization) const {
  if (!required_) return Anybody();
  std::string token;
  const bool shown = TokenOf(authorization, token);
  const Digest digest = DigestOf(token);
  OPENSSL_cleanse(token.data(), token.size());
  const Entry* known = nullptr;
  for (const Entry& entry : entries_) {
    const bool equal = CRYPTO_memcmp(entry.digest.data(), digest.data(), digest.size()) == 0;
    known = equal ? &entry : known;
  }
  if (!shown || known == nullptr) {
    return absl::UnauthenticatedError(
        "no valid token; send the header 'authorization: Bearer TOKEN' (openpi: Api-Key TOKEN)");
  }
  return known->caller;
}

absl::Status AccessTokens::Require(const Caller& caller, Scope scope) {
  if (caller.Has(scope)) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat("the token of '", caller.name, "' has no scope '", ScopeName(scope), "'"));
}

absl::Status AccessTokens::Check(std::string_view authorization, Scope scope) const {
  RS_ASSIGN_OR_RETURN(const Caller caller, Authenticate(authorization));
  return Require(caller, scope);
}

}  // namespace robostress
