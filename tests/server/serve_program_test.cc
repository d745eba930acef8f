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
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/rpc/policy_client.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_readers.h"
#include "nlohmann/json.hpp"
#include "server/serve_options.h"
#include "server/sessions/read_spec.h"
#include "tests/run_program.h"
#include "tests/server/operations/test_certificates.h"
#include "tests/server/serve_process.h"
#include "tests/server/wire/tls_web_client.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using ::testing::AllOf;
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
  const auto [beyond, beyond_code] = RunProgram(SERVE_PROGRAM, "--listen 127.0.0.1:99999");
  EXPECT_EQ(beyond_code, 1);
  EXPECT_THAT(beyond, HasSubstr("'99999' must be 0..65535"));
}

TEST(ServeProgram, RefusesALimitBeyondItsRangeByFlagValueAndRange) {
  const std::pair<const char*, const char*> beyond[] = {
      {"--max-stored-sessions 0", "1..1000000"}, {"--abandoned-after -1", "0..1e+07"},
      {"--lockstep-timeout 0.5", "1..86400"},    {"--starvation-limit 1e9", "0..3600"},
      {"--max-message-mib 2048", "1..1024"},     {"--kept-traces 0", "1..100000"},
      {"--request-timeout nan", "1..3600"},      {"--idle-timeout 0", "1..86400"},
      {"--health-connections 0", "1..1024"},     {"--grace -1", "0..86400"},
      {"--session-expiry -1", "0..1e+09"},       {"--max-rank 0", "1..256"},
      {"--calls-per-client -1", "0..1048576"},   {"--stream-idle 0", "1..1e+07"}};
  for (const auto& [arguments, range] : beyond) {
    const auto [output, code] = RunServe(arguments);
    EXPECT_EQ(code, 1) << arguments;
    const std::vector<std::string> words = absl::StrSplit(arguments, ' ');
    EXPECT_THAT(output, AllOf(HasSubstr(words[0] + " is "), HasSubstr(range))) << arguments;
  }
}

TEST(ServeProgram, ServesUntilItIsTerminated) {
  const std::string state = absl::StrCat(::testing::TempDir(), "/state-of-", getpid());
  {
    const ServeProcess server(SERVE_PROGRAM, {"--state-dir", state});
    PolicyClientOptions options;
    options.address = server.Address("grpc");
    const auto info = GetServerInfo(options);
    ASSERT_TRUE(info.ok()) << info.status();
    EXPECT_EQ(info->policies[0].name, "nano:random");
    EXPECT_TRUE(info->durable);
    EXPECT_FALSE(info->instance.empty());
  }
  EXPECT_GT(std::filesystem::remove_all(state), 0u);
}

TEST(ServeProgram, ServesEveryPortAndLogsJson) {
  ServeProcess server(SERVE_PROGRAM,
                      {"--websocket-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0",
                       "--admin-listen", "127.0.0.1:0", "--log-format", "json"});
  for (const char* port : {"grpc", "websocket", "http", "admin"}) EXPECT_GT(server.port(port), 0);
  EXPECT_EQ(WebClient(server.port("websocket")).Get("/healthz").second, "OK\n");
  EXPECT_EQ(WebClient(server.port("http")).Get("/readyz").first, 200);
  EXPECT_THAT(WebClient(server.port("http")).Get("/metrics").second,
              HasSubstr("robostress_batch_size"));
  auto client =
      OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", server.port("websocket")));
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ(*OpenpiText("server", *(*client)->metadata().Find("server"), 20), "robostress");
  EXPECT_THAT(std::string((*client)->Ask("nonsense", absl::Seconds(30)).status().message()),
              HasSubstr("the policy server failed: message"));
  server.End(SIGTERM);
  std::ifstream lines(server.Path("log"));
  for (std::string line; std::getline(lines, line);)
    EXPECT_TRUE(nlohmann::json::accept(line)) << line;
}

// Probes have places of their own: what fills the other ports does not end the pod.
TEST(ServeProgram, AnswersProbesWhileEveryOtherPlaceIsTakenAndClientsMustShowCertificates) {
  const TestCertificates certificates;
  certificates.MakeAuthority("ca");
  certificates.Make("server", "ca");
  const ServeProcess server(
      SERVE_PROGRAM,
      {"--websocket-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--health-listen",
       "127.0.0.1:0", "--max-connections", "2", "--tls-certificate",
       certificates.File("server.crt"), "--tls-key", certificates.File("server.key"),
       "--tls-client-ca", certificates.File("ca.crt")});
  std::vector<std::unique_ptr<WebClient>> house;
  for (int i = 0; i < 8; ++i) {
    house.push_back(std::make_unique<WebClient>(server.port("http")));
    house.push_back(std::make_unique<WebClient>(server.port("websocket")));
  }
  EXPECT_EQ(WebClient(server.port("health")).Get("/healthz"), std::pair(200, std::string("OK\n")));
  EXPECT_EQ(WebClient(server.port("health")).Get("/readyz").first, 200);
  EXPECT_EQ(WebClient(server.port("health")).Get("/metrics").first, 404);
  EXPECT_EQ(WebClient(server.port("health")).Upgrade(), 404);
}

TEST(ServeProgram, TakesNewSecretsAtSighup) {
  const TestCertificates certificates;
  for (const char* name : {"ca", "next_ca"}) certificates.MakeAuthority(name);
  certificates.Make("server", "ca");
  certificates.Make("next", "next_ca");
  const auto write_token = [&](const std::string& name) {
    certificates.Write("tokens.yaml", absl::StrCat("tokens: [{name: op, sha256: ", Sha256Hex(name),
                                                   ", scopes: [admin]}]\n"));
  };
  write_token("old_secret");
  const ServeProcess server(
      SERVE_PROGRAM, {"--http-listen", "127.0.0.1:0", "--tls-certificate",
                      certificates.File("server.crt"), "--tls-key", certificates.File("server.key"),
                      "--tokens", certificates.File("tokens.yaml"), "--reload-seconds", "0"});
  const auto get = [&](const std::string& authority, const std::string& token) {
    TlsWebClient client(server.port("http"), certificates.File(authority + ".crt"));
    if (!client.connected()) return 0;
    return client.Get("/metrics", "Authorization: Bearer " + token + "\r\n").first;
  };
  EXPECT_EQ(get("ca", "old_secret"), 200);
  EXPECT_EQ(get("ca", "new_secret"), 401);
  write_token("new_secret");
  certificates.Write("server.crt", certificates.Read("next.crt"));
  certificates.Write("server.key", certificates.Read("next.key"));
  EXPECT_EQ(get("ca", "old_secret"), 200) << "nobody has asked";
  kill(server.pid(), SIGHUP);
  for (int i = 0; i < 200 && get("next_ca", "new_secret") != 200; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_EQ(get("next_ca", "new_secret"), 200);
  EXPECT_EQ(get("next_ca", "old_secret"), 401);
  EXPECT_EQ(get("ca", "new_secret"), 0);
  const std::string log = *ReadFile(server.Path("log"));
  EXPECT_THAT(log, HasSubstr("tokens.yaml: op"));
  EXPECT_THAT(log, ::testing::Not(HasSubstr("_secret")));
}

TEST(SessionsProgram, ListsExportsRollsBackAndEndsSessionsThenDrainsTheServer) {
  ServeProcess server(SERVE_PROGRAM, {"--admin-listen", "127.0.0.1:0"});
  PolicyClientOptions options;
  options.address = server.Address("grpc");
  SessionSpec spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = "nano:random";
  spec.method = *MakeMethod("ours");
  const auto client = GrpcPolicyClient::Connect(options, RequestOf(spec));
  ASSERT_TRUE(client.ok()) << client.status();
  const std::string& id = (*client)->session_id();
  const auto sessions = [&](const std::string& arguments) {
    return RunProgram(SESSIONS_PROGRAM,
                      absl::StrCat("--server ", server.Address("admin"), " ", arguments));
  };

  EXPECT_THAT(sessions("list").first, AllOf(HasSubstr(id), HasSubstr("heavy_payload")));
  const auto listed = nlohmann::json::parse(sessions("list --json").first);
  EXPECT_EQ(listed.at(0).at("session"), id);
  EXPECT_EQ(listed.at(0).at("state"), "open");
  EXPECT_EQ(nlohmann::json::parse(sessions("versions " + id + " --json").first).at(0).at("version"),
            0);
  EXPECT_EQ(sessions("pin " + id + " 0").second, 0);
  EXPECT_THAT(sessions("versions " + id).first, HasSubstr("published  always held"));
  EXPECT_EQ(sessions("unpin " + id + " 0").second, 0);
  EXPECT_EQ(sessions("export " + id + " 0 --out " + server.Path("phi_0")).second, 0);
  EXPECT_TRUE((*client)->ImportAdapter(*ReadFile(server.Path("phi_0"))).ok());
  EXPECT_EQ(sessions("rollback " + id + " 0").second, 0);

  const auto [unknown, unknown_code] = sessions("versions session-0");
  EXPECT_EQ(unknown_code, 1);
  EXPECT_THAT(unknown, HasSubstr("session-0"));
  const auto [version, version_code] =
      sessions("export " + id + " 7 --out " + server.Path("phi_7"));
  EXPECT_EQ(version_code, 1);
  EXPECT_THAT(version, HasSubstr("7"));
  EXPECT_FALSE(std::filesystem::exists(server.Path("phi_7")));
  EXPECT_EQ(sessions("pin " + id).second, 2);
  EXPECT_EQ(RunProgram(SESSIONS_PROGRAM, "--server 127.0.0.1:1 --timeout 2 list").second, 1);

  EXPECT_EQ(sessions("end " + id).second, 0);
  EXPECT_EQ(nlohmann::json::parse(sessions("list --json").first).size(), 0u);
  EXPECT_EQ(sessions("drain --grace 1").second, 0);
  server.End(0);
}

}  // namespace
}  // namespace robostress
