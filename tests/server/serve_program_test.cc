#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/rpc/policy_client.h"
#include "nlohmann/json.hpp"
#include "server/serve_options.h"
#include "tests/run_program.h"
#include "tests/server/web_client.h"

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

// A value other than the default for every field, as a file and as flags.
struct Altered {
  std::string yaml, flags;

  void Field(const char* key, bool& value, const char*) {
    Add(key, value ? "false" : "true");
    flags.erase(flags.rfind(value ? "false" : "true") - 1);
    if (value) flags.insert(flags.rfind("--") + 2, "no-");
  }
  void Field(const char* key, std::string& value, const char*) { Add(key, value + "x"); }
  void Field(const char* key, std::vector<std::string>&, const char*) {
    absl::StrAppend(&yaml, key, ": [a=1, b=2]\n");
    absl::StrAppend(&flags, " ", Flag(key), " a=1 b=2");
  }
  template <class T>
  void Field(const char* key, T& value, const char*) {
    Add(key, absl::StrCat(value + 1));
  }

 private:
  static std::string Flag(std::string key) {
    std::replace(key.begin(), key.end(), '_', '-');
    return "--" + key;
  }
  void Add(const char* key, const std::string& value) {
    absl::StrAppend(&yaml, key, ": ", value, "\n");
    absl::StrAppend(&flags, " ", Flag(key), " ", value);
  }
};

TEST(ServeProgram, TakesEveryFlagFromAFileToo) {
  Altered altered;
  ServeOptions().Visit(altered);
  const std::string file =
      (std::filesystem::path(::testing::TempDir()) / absl::StrCat("serve-", getpid(), ".yaml"))
          .string();
  ASSERT_TRUE(WriteFileAtomically(file, altered.yaml).ok());
  const auto [from_flags, flags_code] = RunServe("--print-config" + altered.flags);
  const auto [from_file, file_code] = RunServe("--print-config --config " + file);
  EXPECT_EQ(flags_code, 0) << from_flags;
  EXPECT_EQ(file_code, 0) << from_file;
  EXPECT_EQ(from_flags, from_file);
  // It is what was meant, it can be read again, and flags win over it.
  const auto read = ParseConfig<ServeOptions>("printed", from_file);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->max_sessions, 65);
  EXPECT_FALSE(read->warm_up);
  EXPECT_EQ(read->policy_options, (std::vector<std::string>{"a=1", "b=2"}));
  EXPECT_THAT(RunServe("--print-config --max-sessions 7 --config " + file).first,
              HasSubstr("max_sessions: 7\n"));
  ASSERT_TRUE(WriteFileAtomically(file, "max_session: 3\n").ok());
  const auto [unknown, unknown_code] = RunServe("--config " + file);
  EXPECT_NE(unknown_code, 0);
  EXPECT_THAT(unknown, HasSubstr("max_session"));
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

TEST(ServeProgram, ServesEveryPortAndLogsJson) {
  const auto folder =
      std::filesystem::path(::testing::TempDir()) / absl::StrCat("ports-", getpid());
  std::filesystem::create_directories(folder);
  const std::string ports_file = (folder / "ports").string(), log = (folder / "log").string();
  const pid_t child = fork();
  if (child == 0) {
    if (freopen(log.c_str(), "w", stderr) == nullptr) _exit(126);
    execl(SERVE_PROGRAM, SERVE_PROGRAM, "--policy", "nano:random", "--threads", "1", "--ports-file",
          ports_file.c_str(), "--websocket-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0",
          "--admin-listen", "127.0.0.1:0", "--log-format", "json", nullptr);
    _exit(127);
  }
  for (int i = 0; i < 600 && !std::filesystem::exists(ports_file); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const YAML::Node ports = YAML::LoadFile(ports_file);
  for (const char* port : {"grpc", "websocket", "http", "admin"})
    EXPECT_GT(ports[port].as<int>(), 0);
  EXPECT_EQ(WebClient(ports["websocket"].as<int>()).Get("/healthz").second, "OK\n");
  EXPECT_EQ(WebClient(ports["http"].as<int>()).Get("/readyz").first, 200);
  EXPECT_THAT(WebClient(ports["http"].as<int>()).Get("/metrics").second,
              HasSubstr("robostress_batch_size"));
  WebClient client(ports["websocket"].as<int>());
  EXPECT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().opcode, WebClient::kBinary);
  client.SendFrame("nonsense");
  EXPECT_EQ(client.Read().opcode, WebClient::kText);
  kill(child, SIGTERM);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  std::ifstream lines(log);
  for (std::string line; std::getline(lines, line);)
    EXPECT_TRUE(nlohmann::json::accept(line)) << line;
}

}  // namespace
}  // namespace robostress
