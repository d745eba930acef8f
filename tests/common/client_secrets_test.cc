#include "common/client_secrets.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(ClientSecrets, ComeFromTheFilesThatTheEnvironmentNames) {
  const auto secrets = ClientSecretsFromEnvironment();
  ASSERT_TRUE(secrets.ok()) << secrets.status();
  EXPECT_EQ(secrets->token + secrets->authority + secrets->certificate + secrets->key, "");

  const std::string file = absl::StrCat(::testing::TempDir(), "/client_secrets_test");
  ASSERT_TRUE(WriteFileAtomically(file, " secret\n").ok());
  setenv("ROBOSTRESS_TOKEN_FILE", file.c_str(), 1);
  EXPECT_EQ(ClientSecretsFromEnvironment()->token, "secret");
  setenv("ROBOSTRESS_TLS_KEY", file.c_str(), 1);
  EXPECT_THAT(std::string(ClientSecretsFromEnvironment().status().message()),
              HasSubstr("ROBOSTRESS_TLS_KEY belong together"));
  setenv("ROBOSTRESS_TLS_KEY", "/nowhere/key", 1);
  EXPECT_THAT(std::string(ClientSecretsFromEnvironment().status().message()),
              AllOf(HasSubstr("ROBOSTRESS_TLS_KEY=/nowhere/key: "), HasSubstr("/nowhere/key")));
  unsetenv("ROBOSTRESS_TOKEN_FILE");
  unsetenv("ROBOSTRESS_TLS_KEY");
}

TEST(ClientSecrets, ATokenIsOneWord) {
  const std::string file = absl::StrCat(::testing::TempDir(), "/client_secrets_token");
  setenv("ROBOSTRESS_TOKEN_FILE", file.c_str(), 1);
  const auto read = [&](const std::string& contents) {
    EXPECT_TRUE(WriteFileAtomically(file, contents).ok());
    return ClientSecretsFromEnvironment();
  };
  EXPECT_EQ(read("a.b-c_d/e+f=\r\n")->token, "a.b-c_d/e+f=");
  for (const char* contents : {"", "\n", " \t\r\n", "two words", "two\nlines\n", "caf\xc3\xa9"}) {
    const auto secrets = read(contents);
    EXPECT_EQ(secrets.status().code(), absl::StatusCode::kInvalidArgument) << contents;
    EXPECT_THAT(std::string(secrets.status().message()),
                HasSubstr("ROBOSTRESS_TOKEN_FILE=" + file + ": "));
  }
  unsetenv("ROBOSTRESS_TOKEN_FILE");
}

}  // namespace
}  // namespace robostress
