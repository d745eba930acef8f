// `robostress sweep --policy-url` from its command line to its report, with the real worker,
// against servers of other people's packages; and what the user reads where a server is none, or a
// bad one. Peers from PyPI are skipped, with the reason, where they cannot be installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <atomic>
#include <boost/asio/buffer.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/wire/openpi_writer.h"
#include "nlohmann/json.hpp"
#include "tests/common/wire/openpi_venv.h"
#include "tests/common/wire/policy_peer.h"
#include "tests/common/wire/python_peer.h"
#include "tests/common/wire/scripted_peer.h"
#include "tests/run_program.h"
#include "tests/server/serve_process.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kPrefix[] = "tabletop_goal-heavy_payload-L5-theirs-";

class PolicyPeers : public ::testing::Test {
 protected:
  PolicyPeers()
      : folder_(absl::StrCat(::testing::TempDir(), "policy_peers_", getpid(), "_",
                             ::testing::UnitTest::GetInstance()->current_test_info()->name())) {
    std::filesystem::create_directories(folder_);
  }
  ~PolicyPeers() override { std::filesystem::remove_all(folder_); }

  // One task, one scenario.
  std::pair<std::string, int> Sweep(const std::string& arguments, const std::string& out = "run",
                                    const std::string& environment = "env") const {
    return RunProgram(
        environment,
        absl::StrCat(BIN_DIR, "/robostress-sweep --suites tabletop_goal --tasks 3-3 --episodes ",
                     episodes_, " --scenarios heavy_payload --workers 1 --quiet --out ", Path(out),
                     " ", arguments));
  }
  // The same of a policy that somebody else serves, under the method base alone.
  std::pair<std::string, int> Ask(const std::string& url, const std::string& more = "",
                                  const std::string& environment = "env") const {
    return Sweep(absl::StrCat("--policy-url ", url, " --policies theirs --methods base ", more),
                 "run", environment);
  }
  std::string Path(const std::string& name) const { return absl::StrCat(folder_, "/", name); }
  std::string Unit(const std::string& method) const {
    return Path(absl::StrCat("run/units/", kPrefix, method, "-s0"));
  }
  std::string Read(const std::string& file) const { return ReadFile(file).value_or("no file"); }

  const std::string folder_;
  int episodes_ = 1;
};

// A server made of openpi-client's packages on openpi's published wire, which closes a connection
// after five answers. Its keys are a file.
TEST_F(PolicyPeers, AServerOfOpenpisWireIsSweptToItsReport) {
  const OpenpiVenv& venv = OpenpiVenv::Get();
  if (!venv.failure.empty()) GTEST_SKIP() << venv.failure;
  const PythonPeer server(venv.python, {OPENPI_PEER_SERVER, "libero", "0.02", "5"});
  const std::string keys = Path("keys.yaml");
  ASSERT_TRUE(
      WriteFileAtomically(keys,
                          "name: mine\ncameras: [observation/image, observation/wrist_image]\n"
                          "state: [observation/state]\n")
          .ok());
  const auto [output, code] =
      Sweep(absl::StrCat("--policy-url ", server.url(), " --dialect ", keys,
                         " --policies theirs --methods base,ours_following"));
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("Heavy Payload"), HasSubstr("ours_following - base"),
                            HasSubstr("Sampling noise not paired: the server of theirs"),
                            HasSubstr(" reconnections.")));
  EXPECT_THAT(Read(Path("run/report.html")), HasSubstr("Sampling noise not paired"));
  const std::vector<std::string> rows =
      absl::StrSplit(Read(Path("run/episodes.csv")), '\n', absl::SkipEmpty());
  EXPECT_EQ(rows.size(), 3u) << "a head, and a row for each method";
  for (const char* method : {"base", "ours_following"}) {
    const auto provenance = nlohmann::json::parse(Read(Unit(method) + "/provenance.json"));
    EXPECT_EQ(provenance["metadata"], R"({"reset_pose":[0.0,1.0]})");
    const std::vector<std::string> served_by =
        absl::StrSplit(Read(Unit(method) + "/servers.jsonl"), '\n', absl::SkipEmpty());
    const auto served = nlohmann::json::parse(served_by.back());
    EXPECT_EQ(served["url"], server.url() + "/");
    EXPECT_GT(served["reconnections"], 0) << "it closes after five answers";
    const auto row = nlohmann::json::parse(Read(Unit(method) + "/episodes.jsonl"));
    EXPECT_GT(row["chunks"], 5) << "it went on where the server had closed";
    EXPECT_EQ(row["chunks"], (row["steps"].get<int>() + 4) / 5);
  }
}

TEST_F(PolicyPeers, AModelServerOfVlaEvalIsSweptToItsReport) {
  const OpenpiVenv venv = OpenpiVenv::Make(VLA_EVAL_VENV, VLA_EVAL_REQUIREMENTS, "vla-eval");
  if (!venv.failure.empty()) GTEST_SKIP() << venv.failure;
  // It hangs up at every 200th observation, within an episode.
  const PythonPeer server(venv.python, {VLA_EVAL_PEER, "serve", Path("log"), "200"});
  const auto [output, code] =
      Sweep(absl::StrCat("--policy-url ", server.url(),
                         " --dialect vla_eval --policies theirs --methods base,ours_following"));
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("ours_following - base"),
                            HasSubstr("Sampling noise not paired: the server of theirs")));
  for (const char* method : {"base", "ours_following"}) {
    const auto provenance = nlohmann::json::parse(Read(Unit(method) + "/provenance.json"));
    EXPECT_THAT(std::string(provenance["metadata"]), HasSubstr(R"("model_server":"Tiny")"));
    const auto row = nlohmann::json::parse(Read(Unit(method) + "/episodes.jsonl"));
    EXPECT_EQ(row["chunks"], row["steps"]) << "it is asked at every step, as vla-eval asks";
  }
  int starts = 0, ends = 0;
  for (const absl::string_view line : absl::StrSplit(Read(Path("log")), '\n', absl::SkipEmpty()))
    ++(line.substr(0, 5) == "start" ? starts : ends);
  EXPECT_EQ(starts, ends);
  EXPECT_GT(starts, 2) << "two episodes, and one for each time that it hung up";
}

#ifdef SERVE_PROGRAM
// As anybody's: it knows no method, and draws the noise by what the session says.
TEST_F(PolicyPeers, OurOwnServerGivesTheSameTableOverEitherWire) {
  const ServeProcess serve(SERVE_PROGRAM,
                           {"--policy", "nano", "--websocket-listen", "127.0.0.1:0"});
  const std::string both = " --policies nano --methods base,ours_following";
  const auto [grpc, grpc_code] =
      Sweep(absl::StrCat("--server ", serve.Address("grpc"), both), "grpc");
  ASSERT_EQ(grpc_code, 0) << grpc;
  const auto [socket, socket_code] = Sweep(
      absl::StrCat("--policy-url ws://", serve.Address("websocket"), " --dialect robostress", both),
      "socket");
  ASSERT_EQ(socket_code, 0) << socket;
  EXPECT_THAT(socket, Not(HasSubstr("noise not paired")));
  const std::string rows = Read(Path("grpc/episodes.csv"));
  EXPECT_THAT(rows, AllOf(HasSubstr("heavy_payload"), HasSubstr("ours_following")));
  for (const char* table : {"/episodes.csv", "/table.csv"})
    EXPECT_EQ(Read(Path("socket") + table), Read(Path("grpc") + table)) << table;
}
#endif

// The pid of the worker of a run, or 0.
int WorkerOf(const std::string& run) {
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    int pid = 0;
    if (!absl::SimpleAtoi(entry.path().filename().string(), &pid)) continue;
    const std::string command = ReadFile(entry.path() / "cmdline").value_or("");
    if (absl::StrContains(command, "robostress-worker") && absl::StrContains(command, run))
      return pid;
  }
  return 0;
}

// Of three episodes of 300 steps: 60 questions each, every one answered alike.
class PolicyPeersThatDie : public PolicyPeers {
 protected:
  PolicyPeersThatDie() { episodes_ = 3; }

  static constexpr int kQuestions = 180, kOfAnEpisode = 60;
  static std::string Stay() {
    return OpenpiWriter().Map(1).Text("actions").Array(Eigen::MatrixXf::Zero(10, 7)).Take();
  }
  std::pair<std::string, int> AskThree(const std::string& url, const std::string& out) const {
    return Sweep(absl::StrCat("--policies theirs --methods base --policy-url ", url), out);
  }
  // The same with nobody hurt.
  std::string Undisturbed() const {
    const PolicyPeer server([](int, int) { return Stay(); });
    const auto [output, code] = AskThree(server.url(), "undisturbed");
    EXPECT_EQ(code, 0) << output;
    EXPECT_EQ(server.told().size(), kQuestions);
    return Read(Path("undisturbed/episodes.csv"));
  }
};

TEST_F(PolicyPeersThatDie, AKilledWorkerCostsAtMostItsEpisode) {
  std::atomic<int> questions = 0;
  const PolicyPeer server([&](int, int) {
    if (++questions == 100) kill(WorkerOf(Path("run")), SIGKILL);  // in the second episode
    return Stay();
  });
  const auto [output, code] = AskThree(server.url(), "run");
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("its worker was killed by signal 9 (Killed); another one goes on"));
  EXPECT_EQ(questions, kQuestions + 100 - kOfAnEpisode) << "the first episode was not asked again";
  EXPECT_EQ(Read(Path("run/episodes.csv")), Undisturbed());
}

TEST_F(PolicyPeersThatDie, AKilledServerCostsAtMostItsQuestion) {
  std::atomic<int> questions = 0;
  // Dead from its 100th question on, for whoever connects before the thread below has noticed, too.
  auto server = std::make_unique<PolicyPeer>(
      [&](int, int) { return questions >= 100 || ++questions == 100 ? std::string() : Stay(); });
  const uint16_t port = server->port();
  std::thread dies([&] {
    while (questions < 100) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    server.reset();
    std::this_thread::sleep_for(std::chrono::seconds(1));  // nobody is there
    server = std::make_unique<PolicyPeer>(
        [&](int, int) {
          ++questions;
          return Stay();
        },
        port);
  });
  const auto [output, code] = AskThree(server->url(), "run");
  dies.join();
  EXPECT_EQ(code, 0) << output;
  EXPECT_EQ(questions, kQuestions + 1);
  EXPECT_EQ(Read(Path("run/episodes.csv")), Undisturbed());
}

// What the user reads.
class BadPolicyPeers : public PolicyPeers {
 protected:
  static std::string Actions(int rows, int cols, float value = 0) {
    return OpenpiWriter()
        .Map(1)
        .Text("actions")
        .Array(Eigen::MatrixXf::Constant(rows, cols, value))
        .Take();
  }
  // It names the address and says all of `words`.
  void Expect(const std::pair<std::string, int>& result, const std::string& url,
              const std::vector<std::string>& words) const {
    const auto& [output, code] = result;
    EXPECT_NE(code, 0) << output;
    EXPECT_THAT(output, HasSubstr(url));
    for (const std::string& word : words) EXPECT_THAT(output, HasSubstr(word));
    EXPECT_FALSE(std::filesystem::exists(Unit("base") + "/DONE"));
    std::filesystem::remove_all(Path("run"));
  }
  // Before any unit starts.
  void ExpectAtOnce(const std::string& url, const std::vector<std::string>& words,
                    const std::string& more = "") const {
    const auto result = Ask(url, more);
    EXPECT_FALSE(std::filesystem::exists(Unit("base"))) << result.first;
    Expect(result, url, words);
  }
  void ExpectOfAnswer(const PolicyPeer::Script& answer,
                      const std::vector<std::string>& words) const {
    const PolicyPeer server(answer);
    Expect(Ask(server.url()), server.url(), words);
  }
};

TEST_F(BadPolicyPeers, AreRefusedBeforeAnyUnitStarts) {
  std::string nobody;
  {
    const ScriptedPeer gone([](ScriptedPeer::Tcp::socket) {});
    nobody = gone.url();
  }
  ExpectAtOnce(nobody,
               {"Connection refused", "start the policy server there, or correct the port"});
  const auto http = [](const char* head) {
    return [head](ScriptedPeer::Tcp::socket socket) {
      ScriptedPeer::Error ignored;
      std::string request;
      boost::asio::read_until(socket, boost::asio::dynamic_buffer(request), "\r\n\r\n", ignored);
      boost::asio::write(socket, boost::asio::buffer(std::string(head)), ignored);
    };
  };
  {
    const ScriptedPeer page(http("HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello"));
    ExpectAtOnce(page.url(), {"answers HTTP 200 to a WebSocket: hello", "policy server's port?"});
  }
  {
    const ScriptedPeer locked(http("HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\n\r\n"));
    ExpectAtOnce(locked.url(), {"answers HTTP 401", "ROBOSTRESS_TOKEN_FILE"});
  }
  {
    const ScriptedPeer ssh([](ScriptedPeer::Tcp::socket socket) {
      ScriptedPeer::Error ignored;
      boost::asio::write(socket, boost::asio::buffer(std::string("SSH-2.0-OpenSSH_9.2p1\r\n")),
                         ignored);
    });
    ExpectAtOnce(ssh.url(), {"speaks no WebSocket", "policy server's port?"});
  }
  const auto greeting = [](const std::string& bytes, bool text) {
    return [bytes, text](ScriptedPeer::Socket& web) {
      web.text(text);
      ScriptedPeer::Write(web, bytes);
      ScriptedPeer::AwaitEnd(web);
    };
  };
  {
    const auto words = ScriptedPeer::WebSocket(greeting("Traceback\nOSError: no weights", true));
    ExpectAtOnce(words.url(), {"the policy server failed: OSError: no weights"});
  }
  {
    const auto garbage = ScriptedPeer::WebSocket(greeting("\xc1garbage", false));
    ExpectAtOnce(garbage.url(), {"greets without openpi's metadata", "policy server's port?"});
  }
  {
    const auto openpi = ScriptedPeer::WebSocket(greeting(OpenpiWriter().Map(0).Take(), false));
    ExpectAtOnce(openpi.url(), {"vla-eval's type, payload and seq", "choose its keys by --dialect"},
                 "--dialect vla_eval");
  }
  {
    const auto wide = ScriptedPeer::WebSocket(greeting(
        OpenpiWriter().Map(1).Text("output").Map(1).Text("action_dim").Integer(14).Take(), false));
    ExpectAtOnce(wide.url(), {"action_dim 14, remote.action_dim is 7", "set it to the server's"});
  }
  // What needs no server to be wrong.
  const auto expect_wrong = [&](const std::string& url, const std::string& more,
                                const char* words) {
    const auto [output, code] = Ask(url, more);
    EXPECT_EQ(code, 2) << output;
    EXPECT_THAT(output, HasSubstr(words));
  };
  expect_wrong("http://127.0.0.1:8000", "", "ws://");
  expect_wrong(nobody, "--dialect opnepi", "known: libero, aloha, droid, vllm_omni");
  expect_wrong(nobody, "--dialect absent.yaml", "--dialect: cannot open 'absent.yaml'");
  const std::string keys = Path("keys.yaml");
  for (const auto& [text, words] : std::vector<std::pair<const char*, const char*>>{
           {"name: mine\nstate: [s]\nwire: grpc\n",
            "remote.dialect.wire is 'grpc', must be openpi or vla_eval"},
           {"name: mine\nstate: [s]\ncamera: [a]\n", "unknown key 'camera'"},
           {"state: [s]\n", "name is empty"},
           {"name: mine\nstate: [s]\ncameras: [a]\n", "remote.cameras names 2 cameras"}}) {
    ASSERT_TRUE(WriteFileAtomically(keys, text).ok());
    expect_wrong(nobody, "--dialect " + keys, words);
  }
}

TEST_F(BadPolicyPeers, AreNamedByTheUnitThatTheyFail) {
  const auto words = [](const char* text) {
    return [text](int, int) { return std::string(text); };
  };
  ExpectOfAnswer(words("Traceback (most recent call last):\nKeyError: 'observation/wrist_left'"),
                 {"the policy server failed: KeyError: 'observation/wrist_left'", "--dialect",
                  "remote.cameras"});
  ExpectOfAnswer(words("\xc1garbage"), {"no msgpack of openpi's", "policy server's port?"});
  ExpectOfAnswer([](int, int) { return Actions(10, 7, std::numeric_limits<float>::quiet_NaN()); },
                 {"actions[0] is nan, must be finite", "see the server's log"});
  ExpectOfAnswer([](int, int) { return Actions(10, 32); },
                 {"has shape [10, 32]", "[5..1024, 7]", "remote.action_dim"});
  ExpectOfAnswer([](int, int) { return Actions(3, 7); },
                 {"has shape [3, 7]", "[5..1024, 7]", "remote.execute_steps"});
  ExpectOfAnswer([](int, int message) { return Actions(10 + message, 7); },
                 {"has shape [11, 7]", "[10, 7]", "its first answer had 10 rows"});
  ExpectOfAnswer([](int, int) { return OpenpiWriter().Map(1).Text("status").Text("ok").Take(); },
                 {"the answer is a map of status", "an array [horizon, action_dim]"});
  // It closes at the second question, whoever asks; connection 0 is the sweep's, which hangs up.
  ExpectOfAnswer(
      [](int connection, int message) {
        return connection <= 1 && message == 0 ? Actions(10, 7) : std::string();
      },
      {"does not answer, after", "run the same command again to go on"});
}

// Arguments of a worker that gives a server one second for an answer.
std::string LateWorker(const std::string& url, const std::string& out) {
  return absl::StrCat(
      "--set suite=tabletop_goal --set policy=theirs --set tasks=[3] --set episodes=1 --set "
      "remote.dialect.name=theirs --set remote.dialect.cameras=[a,b] --set "
      "remote.dialect.state=[s] --set remote.execute_steps=100 --call-timeout 1 --server ",
      url, " --out ", out);
}

TEST_F(BadPolicyPeers, ALateAnswerIsAskedForAgain) {
  // After the first answer, which may take as long as a network is compiled.
  const PolicyPeer server([](int connection, int message) {
    if (connection == 0 && message == 1) std::this_thread::sleep_for(std::chrono::seconds(2));
    return Actions(300, 7);
  });
  const auto [output, code] = RunProgram(absl::StrCat(BIN_DIR, "/robostress-worker"),
                                         LateWorker(server.url(), Path("run")));
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("/: connected again (1 so far)"));
  EXPECT_THAT(output, HasSubstr("episode 1/1"));
}

TEST_F(BadPolicyPeers, OneThatIsLateAtEveryQuestionIsGivenUp) {
  const PolicyPeer server([](int, int message) {
    if (message > 0) std::this_thread::sleep_for(std::chrono::seconds(2));
    return Actions(300, 7);
  });
  Expect(RunProgram(absl::StrCat(BIN_DIR, "/robostress-worker"),
                    LateWorker(server.url(), Path("run"))),
         server.url(), {"does not answer within 1s", "run the same command again to go on"});
}

}  // namespace
}  // namespace robostress
