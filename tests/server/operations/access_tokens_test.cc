#include "server/operations/access_tokens.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>
#include <string>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "server/operations/access_table.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kArm[] = "arm-secret-0123456789";
constexpr char kOperator[] = "operator-secret-0123456789";

std::string File() {
  return absl::StrCat("tokens:\n  - {name: arm_1, sha256: ", Sha256Hex(kArm),
                      ", scopes: [predict, feedback]}\n  - {name: operator, sha256: ",
                      Sha256Hex(kOperator), ", scopes: [admin]}\n");
}

AccessTokens Tokens() {
  auto tokens = AccessTokens::Parse("tokens.yaml", File());
  EXPECT_TRUE(tokens.ok()) << tokens.status();
  return *std::move(tokens);
}

TEST(AccessTokens, KnowsATokenInEveryFormOfTheHeader) {
  const AccessTokens tokens = Tokens();
  const std::string basic = absl::Base64Escape(absl::StrCat("anyone:", kArm));
  for (const std::string& header :
       {absl::StrCat("Bearer ", kArm), absl::StrCat("bearer ", kArm),
        absl::StrCat("Api-Key ", kArm), absl::StrCat("Basic ", basic)}) {
    const auto caller = tokens.Authenticate(header);
    ASSERT_TRUE(caller.ok()) << header.substr(0, 8) << caller.status();
    EXPECT_EQ(caller->name, "arm_1");
  }
}

TEST(AccessTokens, RefusesEverythingElseWithoutRepeatingIt) {
  const AccessTokens tokens = Tokens();
  for (const std::string& header :
       {std::string(), std::string("Bearer "), std::string("Bearer"),
        std::string("Bearer wrong-secret"), std::string(kArm), absl::StrCat("Digest ", kArm),
        absl::StrCat("Bearer ", kArm, "x"), absl::StrCat("Bearer ", Sha256Hex(kArm)),
        std::string("Basic !!!"), absl::StrCat("Bearer ", std::string(100000, 'a'))}) {
    const auto caller = tokens.Authenticate(header);
    EXPECT_EQ(caller.status().code(), absl::StatusCode::kUnauthenticated) << header.substr(0, 20);
    EXPECT_THAT(std::string(caller.status().message()), Not(HasSubstr("secret")));
  }
}

TEST(AccessTokens, GivesAScopeOnlyToWhoHasIt) {
  const AccessTokens tokens = Tokens();
  const std::string arm = absl::StrCat("Bearer ", kArm), admin = absl::StrCat("Bearer ", kOperator);
  EXPECT_TRUE(tokens.Check(arm, Scope::kPredict).ok());
  EXPECT_TRUE(tokens.Check(arm, Scope::kFeedback).ok());
  EXPECT_TRUE(tokens.Check(admin, Scope::kAdmin).ok());
  const absl::Status refused = tokens.Check(arm, Scope::kAdmin);
  EXPECT_EQ(refused.code(), absl::StatusCode::kPermissionDenied);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("'arm_1' has no scope 'admin'"));
  EXPECT_EQ(tokens.Check(admin, Scope::kPredict).code(), absl::StatusCode::kPermissionDenied);
}

TEST(AccessTokens, AsksNobodyWithoutAFile) {
  const AccessTokens tokens;
  EXPECT_FALSE(tokens.required());
  EXPECT_TRUE(tokens.Check("", Scope::kAdmin).ok());
}

TEST(AccessTokens, NamesFileAndEntryThatAreWrong) {
  const auto refusal = [](const std::string& text) {
    const auto tokens = AccessTokens::Parse("tokens.yaml", text);
    EXPECT_FALSE(tokens.ok()) << text;
    return std::string(tokens.status().message());
  };
  const std::string digest = Sha256Hex("a");
  EXPECT_THAT(refusal("[1, 2]"), HasSubstr("tokens.yaml: must hold one list"));
  EXPECT_THAT(refusal("tokens: [{name: a, sha256: 12, scopes: [admin]}]"),
              HasSubstr("tokens[0].sha256 must be 64 lower-case hex digits"));
  EXPECT_THAT(refusal(absl::StrCat("tokens: [{name: a, sha256: ", digest, ", scopes: [root]}]")),
              HasSubstr("tokens[0].scopes: must be of predict, feedback, admin"));
  EXPECT_THAT(refusal(absl::StrCat("tokens: [{name: a, sha256: ", digest, ", scope: [admin]}]")),
              HasSubstr("unknown key 'scope'"));
  EXPECT_THAT(refusal(absl::StrCat("tokens: [{name: a, sha256: ", digest,
                                   ", scopes: []}, {name: b, sha256: ", digest, ", scopes: []}]")),
              HasSubstr("tokens[1].sha256 occurs twice"));
  for (const char* limit : {"0", "-1", "1048577", "many"}) {
    EXPECT_THAT(refusal(absl::StrCat("tokens: [{name: a, sha256: ", digest,
                                     ", scopes: [], limits: {sessions: ", limit, "}}]")),
                HasSubstr(absl::StrCat("tokens[0].limits.sessions is '", limit, "', must be 1..")));
  }
  EXPECT_THAT(refusal("tokens: [{name: a\n  b: ["), HasSubstr("tokens.yaml: line"));
}

TEST(AccessTokens, ComparesTheWholeDigest) {
  // Two secrets whose SHA-256 begin with the same five bytes.
  const std::string known = "arm-secret-0477918", other = "arm-secret-0876648";
  ASSERT_EQ(Sha256Hex(known).substr(0, 10), Sha256Hex(other).substr(0, 10));
  const auto tokens = AccessTokens::Parse(
      "tokens.yaml",
      absl::StrCat("tokens: [{name: arm, sha256: ", Sha256Hex(known), ", scopes: [predict]}]"));
  ASSERT_TRUE(tokens.ok()) << tokens.status();
  EXPECT_TRUE(tokens->Authenticate(absl::StrCat("Bearer ", known)).ok());
  EXPECT_FALSE(tokens->Authenticate(absl::StrCat("Bearer ", other)).ok());
}

// Who may do what, said a second time.
TEST(AccessTable, OpensTeachingToFeedbackOperationToAdminAndTheRestToPredict) {
  const auto of = [](Scope scope) { return static_cast<uint8_t>(scope); };
  const std::set<std::string> teaching = {"Feedback", "ExportAdapter", "ImportAdapter",
                                          "RollbackAdapter", "executed"};
  const std::set<std::string> probes = {"/healthz", "/readyz"};
  const std::set<std::string> nobodys = {"GetServerInfo", "OpenSession", "upgrade"};
  for (const AccessRule& rule : AccessTable()) {
    const std::string what(rule.what);
    const bool robots =
        rule.wire == AccessRule::Wire::kPolicy || rule.wire == AccessRule::Wire::kWebSocket;
    int expected = of(teaching.count(what) > 0 ? Scope::kFeedback : Scope::kPredict);
    if (!robots) expected = probes.count(what) > 0 ? 0 : of(Scope::kAdmin);
    if (what == "/metrics") expected |= of(Scope::kMetrics);
    EXPECT_EQ(rule.scopes, expected) << what;
    EXPECT_EQ(rule.of_one_session, robots && nobodys.count(what) == 0) << what;
  }
}

TEST(AccessTable, AllowsWhoHasTheScopeAndNobodyElse) {
  Caller caller;
  caller.name = "arm_1";
  caller.scopes = static_cast<uint8_t>(Scope::kPredict);
  EXPECT_TRUE(Allow(caller, AccessRule::Wire::kPolicy, "Predict").ok());
  EXPECT_EQ(Allow(caller, AccessRule::Wire::kPolicy, "Feedback").code(),
            absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(Allow(caller, AccessRule::Wire::kAdmin, "EndSession").code(),
            absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(Allow(caller, AccessRule::Wire::kHttp, "/metrics").code(),
            absl::StatusCode::kPermissionDenied);
  EXPECT_TRUE(Allow(caller, AccessRule::Wire::kHttp, "/healthz").ok());
}

}  // namespace
}  // namespace robostress
