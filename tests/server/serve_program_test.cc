#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/rpc/policy_client.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::pair<std::string, int> RunServe(const std::string& arguments) {
  return RunProgram(SERVE_PROGRAM, arguments);
}

TEST(ServeProgram, ExplainsItselfWithExamples) {
  const auto [output, code] = RunServe("--help");
  EXPECT_EQ(code, 0);
  EXPECT_THAT(output, HasSubstr("Examples:"));
  EXPECT_THAT(output, HasSubstr("--port-file"));
}

TEST(ServeProgram, RefusesUnknownPoliciesAndForeignWeightsWithTheirName) {
  const auto [unknown, unknown_code] = RunServe("--policy pi9");
  EXPECT_NE(unknown_code, 0);
  EXPECT_THAT(unknown, HasSubstr("pi9"));
  const auto [missing, missing_code] = RunServe("--policy absent.safetensors");
  EXPECT_NE(missing_code, 0);
  EXPECT_THAT(missing, HasSubstr("absent.safetensors"));
  const auto path = std::filesystem::path(::testing::TempDir()) / "foreign.safetensors";
  std::ofstream(path) << "not a weights file at all";
  const auto [foreign, foreign_code] = RunServe(absl::StrCat("--policy ", path.string()));
  EXPECT_NE(foreign_code, 0);
  EXPECT_THAT(foreign, HasSubstr("foreign.safetensors"));
}

TEST(ServeProgram, RefusesAnAddressItCannotListenOn) {
  const auto [output, code] = RunServe("--policy nano:random --listen 203.0.113.1:1");
  EXPECT_NE(code, 0);
  EXPECT_THAT(output, HasSubstr("cannot listen on 203.0.113.1:1"));
}

TEST(ServeProgram, ServesUntilItIsTerminated) {
  const auto port_file =
      std::filesystem::path(::testing::TempDir()) / absl::StrCat("port-", getpid());
  std::filesystem::remove(port_file);
  const pid_t child = fork();
  if (child == 0) {
    execl(SERVE_PROGRAM, SERVE_PROGRAM, "--policy", "nano:random", "--threads", "1", "--port-file",
          port_file.c_str(), "--state-dir", (port_file.string() + ".state").c_str(), nullptr);
    _exit(127);
  }
  std::string port;
  for (int i = 0; i < 600 && port.empty(); ++i) {  // published whole, so any content is complete
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    std::ifstream(port_file) >> port;
  }
  ASSERT_FALSE(port.empty());
  PolicyClientOptions options;
  options.address = absl::StrCat("127.0.0.1:", port);
  const auto info = GetServerInfo(options);
  EXPECT_TRUE(info.ok()) << info.status();
  if (info.ok()) {
    EXPECT_EQ(info->policies[0].name, "nano:random");
    EXPECT_TRUE(info->durable);
    EXPECT_FALSE(info->instance.empty());
  }
  kill(child, SIGTERM);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_TRUE(std::filesystem::remove_all(port_file.string() + ".state") > 0);
}

}  // namespace
}  // namespace robostress
