// deploy/monitoring against a server that runs: every figure that a rule, a panel or a runbook
// names is one that the server shows, and every command is one that exists.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/time/clock.h"
#include "common/atomic_file.h"
#include "common/rpc/policy_client.h"
#include "nlohmann/json.hpp"
#include "server/serve_options.h"
#include "server/sessions/read_spec.h"
#include "tests/adapter/toy_arm.h"
#include "tests/run_program.h"
#include "tests/server/operations/test_certificates.h"
#include "tests/server/serve_process.h"
#include "tests/server/wire/tls_web_client.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;

const fs::path kMonitoring = fs::path(ROBOSTRESS_SOURCE_DIR) / "deploy/monitoring";

std::string Text(const fs::path& file) {
  auto text = ReadFile(file.string());
  EXPECT_TRUE(text.ok()) << text.status();
  return text.ok() ? *text : "";
}

// Names of metrics in a text, as Prometheus shows them; a histogram's parts are its own name.
std::set<std::string> MetricNames(const std::string& text) {
  std::set<std::string> names;
  const std::regex name("\\b(robostress|process)_[a-z_]+\\b");
  for (std::sregex_iterator at(text.begin(), text.end(), name), end; at != end; ++at)
    names.insert(std::regex_replace(at->str(), std::regex("_bucket$"), ""));
  return names;
}

std::set<std::string> Alerts() {
  std::set<std::string> names;
  const YAML::Node rules = YAML::LoadFile((kMonitoring / "alerts.yml").string());
  for (const YAML::Node& group : rules["groups"]) {
    for (const YAML::Node& rule : group["rules"]) {
      const std::string name = rule["alert"].as<std::string>();
      EXPECT_TRUE(names.insert(name).second) << name;
      EXPECT_EQ(rule["annotations"]["runbook_url"].as<std::string>(),
                absl::StrCat("deploy/monitoring/runbooks/", name, ".md"));
      EXPECT_FALSE(rule["annotations"]["summary"].as<std::string>().empty());
    }
  }
  return names;
}

nlohmann::json Dashboard() { return nlohmann::json::parse(Text(kMonitoring / "dashboard.json")); }

std::vector<std::string> DashboardQueries() {
  std::vector<std::string> queries;
  const nlohmann::json dashboard = Dashboard();
  for (const auto& panel : dashboard.at("panels")) {
    for (const auto& target : panel.value("targets", nlohmann::json::array()))
      queries.push_back(target.at("expr"));
  }
  for (const auto& variable : dashboard.at("templating").at("list")) {
    if (variable.at("type") == "query") queries.push_back(variable.at("query").at("query"));
  }
  return queries;
}

// A program as an operator runs it: TLS, tokens, a state directory, every port. It has predicted,
// learned from feedback, and been asked by a scraper with a token of scope `metrics`.
class LiveFigures : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    certificates_ = new TestCertificates();
    certificates_->MakeAuthority("ca");
    certificates_->Make("server", "ca");
    std::string tokens = "tokens:\n";
    for (const auto& [name, scopes] :
         {std::pair("arm", "predict, feedback"), {"prometheus", "metrics"}})
      absl::StrAppend(&tokens, "  - {name: ", name, ", sha256: ", Sha256Hex(name), ", scopes: [",
                      scopes, "]}\n");
    certificates_->Write("tokens.yaml", tokens);
    certificates_->Write("arm.token", "arm");
    server_ = new ServeProcess(
        SERVE_PROGRAM,
        {"--websocket-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--admin-listen",
         "127.0.0.1:0", "--health-listen", "127.0.0.1:0", "--state-dir",
         certificates_->File("state"), "--tls-certificate", certificates_->File("server.crt"),
         "--tls-key", certificates_->File("server.key"), "--tokens",
         certificates_->File("tokens.yaml")});
    setenv("ROBOSTRESS_TLS_CA", certificates_->File("ca.crt").c_str(), 1);
    setenv("ROBOSTRESS_TOKEN_FILE", certificates_->File("arm.token").c_str(), 1);
    RunChunks();
    unsetenv("ROBOSTRESS_TLS_CA");
    unsetenv("ROBOSTRESS_TOKEN_FILE");
  }
  static void TearDownTestSuite() {
    client_.reset();
    delete server_;
    delete certificates_;
  }
  static void RunChunks() {
    PolicyClientOptions options;
    options.address = server_->Address("grpc");
    SessionSpec spec;
    spec.suite = "tabletop_goal";
    spec.scenario = "clean";
    spec.policy = "nano:random";
    spec.method = *MakeMethod("ours");
    auto client = GrpcPolicyClient::Connect(options, RequestOf(spec));
    ASSERT_TRUE(client.ok()) << client.status();
    client_ = *std::move(client);
    ASSERT_TRUE(client_->StartEpisode({0, 0}).ok());
    Observation observation;
    observation.instruction = "put the bowl on the plate";
    const PolicySpec& policy = client_->spec();
    for (const std::string& camera : policy.cameras) {
      Image image{policy.image_width, policy.image_height, {}};
      image.data.resize(size_t{3} * image.width * image.height, 127);
      observation.views.push_back({camera, image});
    }
    observation.proprioception = Eigen::VectorXf::Zero(policy.state_dim);
    ToyArm arm(0.6);
    for (int chunk = 0; chunk < 3; ++chunk) {
      const auto prediction = client_->Predict(observation, chunk);
      ASSERT_TRUE(prediction.ok()) << prediction.status();
      ExecutedChunk executed = arm.Execute(*prediction, 5);
      executed.sequence = client_->last_feedback_sequence() + 1;
      executed.chunk = chunk;
      ASSERT_TRUE(client_->SendFeedback(std::move(executed)).ok());
    }
  }
  static std::pair<int, std::string> Get(const std::string& path, const std::string& token) {
    TlsWebClient client(server_->port("http"), certificates_->File("ca.crt"));
    return client.Get(path, absl::StrCat("Authorization: Bearer ", token, "\r\n"));
  }

  static inline TestCertificates* certificates_ = nullptr;
  static inline ServeProcess* server_ = nullptr;
  static inline std::unique_ptr<GrpcPolicyClient> client_;
};

TEST_F(LiveFigures, HoldEveryNameThatARuleAPanelOrARunbookUses) {
  const auto [status, text] = Get("/metrics", "prometheus");
  ASSERT_EQ(status, 200) << text;
  std::set<std::string> shown;
  const std::regex type("# TYPE ([a-z_]+) [a-z]+\n");
  for (std::sregex_iterator at(text.begin(), text.end(), type), end; at != end; ++at)
    shown.insert((*at)[1]);
  EXPECT_THAT(shown, IsSupersetOf(MetricNames(Text(kMonitoring / "alerts.yml"))));
  EXPECT_THAT(shown, IsSupersetOf(MetricNames(Text(kMonitoring / "alerts_test.yml"))));
  EXPECT_THAT(shown, IsSupersetOf(MetricNames(absl::StrJoin(DashboardQueries(), "\n"))));
  for (const auto& page : fs::directory_iterator(kMonitoring / "runbooks"))
    EXPECT_THAT(shown, IsSupersetOf(MetricNames(Text(page.path())))) << page.path();
}

TEST_F(LiveFigures, FollowPrometheusConventions) {
  const std::string text = Get("/metrics", "prometheus").second;
  std::map<std::string, std::string> types;
  std::set<std::string> helped;
  for (const std::string& line : std::vector<std::string>(absl::StrSplit(text, '\n'))) {
    const std::vector<std::string> words = absl::StrSplit(line, ' ');
    if (words.size() >= 4 && words[1] == "TYPE") types[words[2]] = words[3];
    if (words.size() >= 4 && words[1] == "HELP" && !words[3].empty()) helped.insert(words[2]);
  }
  EXPECT_GT(types.size(), 25u);
  for (const auto& [name, type] : types) {
    EXPECT_EQ(helped.count(name), 1u) << name << " has no help";
    EXPECT_EQ(name.ends_with("_total"), type == "counter") << name << " is a " << type;
    for (const char* unit : {"_ms", "_milliseconds", "_mib", "_kb", "_percent", "_minutes"})
      EXPECT_FALSE(name.ends_with(unit)) << name << " is not in a base unit";
  }
}

TEST_F(LiveFigures, SayWhatRunsAndWhatItTakes) {
  const std::string text = Get("/metrics", "prometheus").second;
  const auto value = [&text](const std::string& series) {
    std::smatch match;
    const std::string escaped = std::regex_replace(series, std::regex("[{}\"]"), "\\$&");
    return std::regex_search(text, match, std::regex("\n" + escaped + " (\\S+)\n"))
               ? std::stod(match[1])
               : -1;
  };
  EXPECT_THAT(text, HasSubstr(absl::StrCat("version=\"", PROJECT_VERSION, "\"")));
  EXPECT_THAT(text, ::testing::ContainsRegex("revision=\"([0-9a-f]{12}|unknown)\""));
  const double now = absl::ToDoubleSeconds(absl::Now() - absl::UnixEpoch());
  EXPECT_NEAR(value("process_start_time_seconds"), now, 600);
  EXPECT_GT(value("process_cpu_seconds_total"), 0.01);
  EXPECT_GT(value("process_resident_memory_bytes"), 1e7);
  EXPECT_GT(value("process_virtual_memory_bytes"), value("process_resident_memory_bytes"));
  EXPECT_GT(value("process_open_fds"), 5);
  EXPECT_GT(value("process_max_fds"), value("process_open_fds"));
  EXPECT_GT(value("process_threads"), 3);
  EXPECT_GT(value("robostress_state_dir_size_bytes"), value("robostress_state_dir_free_bytes"));
  EXPECT_GT(value("robostress_state_dir_free_bytes"), 0);
  EXPECT_GT(value("robostress_journal_bytes"), 100);
  EXPECT_EQ(value("robostress_sessions{state=\"failed\"}"), 0);
  EXPECT_EQ(value("robostress_snapshots_failed_total"), 0);
  EXPECT_EQ(value("robostress_predictions_unkept_total"), 0);
  EXPECT_GT(value("robostress_certificate_expiry_timestamp_seconds"), now);
}

TEST_F(LiveFigures, AScrapersTokenReadsFiguresAndNothingElse) {
  EXPECT_EQ(Get("/metrics", "prometheus").first, 200);
  for (const char* path : {"/", "/main", "/traces", "/image", "/live.js"})
    EXPECT_EQ(Get(path, "prometheus").first, 403) << path;
  EXPECT_EQ(Get("/metrics", "arm").first, 403);
  certificates_->Write("prometheus.token", "prometheus");
  const auto sessions = [&](const std::string& arguments) {
    return RunProgram(
        absl::StrCat("ROBOSTRESS_TLS_CA=", certificates_->File("ca.crt"), " ROBOSTRESS_TOKEN_FILE=",
                     certificates_->File("prometheus.token"), " ", SESSIONS_PROGRAM),
        absl::StrCat("--server ", server_->Address("admin"), " ", arguments));
  };
  const std::string session = client_->session_id();
  for (const std::string& command :
       {std::string("list"), "versions " + session, "end " + session, std::string("drain")}) {
    const auto [output, code] = sessions(command);
    EXPECT_EQ(code, 1) << command;
    EXPECT_THAT(output, HasSubstr("has no scope 'admin'")) << command;
  }
}

TEST(Monitoring, EveryAlertHasARunbookAndEveryRunbookAnAlert) {
  std::set<std::string> pages;
  for (const auto& page : fs::directory_iterator(kMonitoring / "runbooks")) {
    pages.insert(page.path().stem().string());
    const std::string text = Text(page.path());
    for (const char* part : {"## What it means\n", "## How to see it\n", "## What to do\n"})
      EXPECT_THAT(text, HasSubstr(part)) << page.path();
    const std::regex link("\\]\\(([^)]+)\\)");
    for (std::sregex_iterator at(text.begin(), text.end(), link), end; at != end; ++at)
      EXPECT_TRUE(fs::exists(kMonitoring / "runbooks" / (*at)[1].str())) << (*at)[1];
  }
  EXPECT_EQ(pages, Alerts());
  // Each is tested (alerts_test.yml).
  std::set<std::string> tested;
  const std::string tests = Text(kMonitoring / "alerts_test.yml");
  const std::regex name("alertname=\"(\\w+)\"");
  for (std::sregex_iterator at(tests.begin(), tests.end(), name), end; at != end; ++at)
    tested.insert((*at)[1]);
  EXPECT_EQ(tested, pages);
}

// The flags that the server has.
struct FlagNames {
  std::set<std::string> names = {"--config", "--print-config", "--help"};
  template <class T>
  void Field(std::string key, T&, const char*) {
    std::replace(key.begin(), key.end(), '_', '-');
    names.insert("--" + key);
  }
};

TEST(Monitoring, EveryCommandOfTheRunbooksExists) {
  const std::string help = RunProgram(SESSIONS_PROGRAM, "--help").first;
  FlagNames flags;
  ServeOptions().Visit(flags);
  const std::set<std::string> of_the_system = {"systemctl", "journalctl", "curl",    "df",
                                               "du",        "ss",         "openssl", "kubectl"};
  int commands = 0;
  for (const auto& page : fs::directory_iterator(kMonitoring / "runbooks")) {
    const std::string text = Text(page.path());
    const std::regex code("`([a-z-]+)( [^`]*)?`");  // inline, a command or a flag's name
    std::vector<std::string> lines;
    for (std::sregex_iterator at(text.begin(), text.end(), code), end; at != end; ++at) {
      if ((*at)[2].matched) lines.push_back((*at)[1].str() + (*at)[2].str());
    }
    const size_t begin = text.find("```\n") + 4;
    for (const auto& line : absl::StrSplit(text.substr(begin, text.find("```", begin) - begin),
                                           '\n', absl::SkipEmpty()))
      lines.emplace_back(line);
    for (const std::string& line : lines) {
      const std::vector<std::string> words = absl::StrSplit(line, ' ');
      ++commands;
      if (words[0] == "robostress-sessions") {
        EXPECT_THAT(help, HasSubstr(absl::StrCat("\n  ", words.at(1), " "))) << line;
      } else if (words[0] == "robostress-serve") {
        for (const std::string& word : words) {
          if (word.starts_with("--")) {
            EXPECT_EQ(flags.names.count(word), 1u) << line;
          }
        }
      } else if (words[0] == "robostress") {
        EXPECT_TRUE(
            fs::exists(fs::path(ROBOSTRESS_SOURCE_DIR) / "server/policies/policy_main.cc") &&
            words.at(1) == "policy")
            << line;
      } else if (!words[0].starts_with("--")) {
        EXPECT_EQ(of_the_system.count(words[0]) + (words[0] == "ls"), 1u) << page.path() << line;
      }
    }
    const std::regex flag("`(--[a-z-]+)`");
    for (std::sregex_iterator at(text.begin(), text.end(), flag), end; at != end; ++at)
      EXPECT_EQ(flags.names.count((*at)[1]), 1u) << page.path() << " " << (*at)[1];
  }
  EXPECT_GT(commands, 40);
}

TEST(Monitoring, PrometheusAcceptsTheRulesAndTheyFireWhenTheyShould) {
  if (std::system("command -v promtool > /dev/null") != 0)
    GTEST_SKIP() << "no promtool: apt-get install prometheus";
  for (const char* what : {"check rules alerts.yml", "test rules alerts_test.yml"}) {
    const auto [output, code] =
        RunProgram(absl::StrCat("cd ", kMonitoring.string(), " && promtool"), what);
    EXPECT_EQ(code, 0) << output;
  }
}

TEST(Monitoring, TheDashboardHasWhatGrafanaNeedsToImportIt) {
  const nlohmann::json dashboard = Dashboard();
  EXPECT_GE(dashboard.at("schemaVersion").get<int>(), 36);
  EXPECT_EQ(dashboard.at("templating").at("list").at(0).at("type"), "datasource");
  std::set<int> ids;
  std::vector<std::vector<bool>> taken(200, std::vector<bool>(24));
  for (const auto& panel : dashboard.at("panels")) {
    EXPECT_TRUE(ids.insert(panel.at("id").get<int>()).second) << panel.at("title");
    const auto& at = panel.at("gridPos");
    for (int y = at.at("y"); y < at.at("y").get<int>() + at.at("h").get<int>(); ++y) {
      for (int x = at.at("x"); x < at.at("x").get<int>() + at.at("w").get<int>(); ++x) {
        EXPECT_FALSE(taken.at(y).at(x)) << panel.at("title") << " lies over another panel";
        taken.at(y).at(x) = true;
      }
    }
    if (panel.at("type") == "row") continue;
    EXPECT_EQ(panel.at("datasource").at("uid"), "${datasource}") << panel.at("title");
    ASSERT_FALSE(panel.at("targets").empty()) << panel.at("title");
    for (const auto& target : panel.at("targets"))
      EXPECT_EQ(target.at("datasource").at("uid"), "${datasource}");
  }
}

// Blocks of deploy/README.md that need nothing but the programs, one after the other as a person
// types them.
TEST(OperatorsPage, WhatRunsAnywhereRuns) {
  const std::string page = Text(fs::path(ROBOSTRESS_SOURCE_DIR) / "deploy/README.md");
  const fs::path folder = fs::path(::testing::TempDir()) / absl::StrCat("page-", getpid());
  fs::create_directories(folder);
  std::string script = absl::StrCat("set -euo pipefail\ncd ", folder.string(),
                                    "\nPATH=", fs::path(SERVE_PROGRAM).parent_path().string(),
                                    ":$PATH\ntrap 'kill $(jobs -p); wait' EXIT\n");
  int blocks = 0;
  for (size_t at = page.find("```bash\n"); at != std::string::npos;
       at = page.find("```bash\n", at + 1), ++blocks) {
    const size_t begin = at + 8;
    script += page.substr(begin, page.find("```", begin) - begin);
  }
  EXPECT_EQ(blocks, 2);
  ASSERT_TRUE(WriteFileAtomically((folder / "page.sh").string(), script).ok());
  const auto [output, code] = RunProgram("bash", (folder / "page.sh").string());
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("robostress_build_info{"));
  EXPECT_THAT(output, HasSubstr("0 sessions"));
  fs::remove_all(folder);
}

TEST(Monitoring, TheScrapeSampleShowsATokenOverTlsAndLoadsTheRules) {
  const YAML::Node sample = YAML::LoadFile((kMonitoring / "prometheus.yml").string());
  EXPECT_EQ(sample["rule_files"][0].as<std::string>(), "alerts.yml");
  const YAML::Node scrape = sample["scrape_configs"][0];
  EXPECT_EQ(scrape["job_name"].as<std::string>(), "robostress") << "alerts ask for this job";
  EXPECT_EQ(scrape["scheme"].as<std::string>(), "https");
  EXPECT_TRUE(scrape["authorization"]["credentials_file"]);
  EXPECT_TRUE(scrape["tls_config"]["ca_file"]);
}

}  // namespace
}  // namespace robostress
