// The program itself, from its command line to its end, between openpi's own client and a server.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <thread>

#include "common/child_process.h"
#include "common/wire/openpi_connection.h"
#include "nlohmann/json.hpp"
#include "server/proxy/action_block.h"
#include "tests/common/wire/openpi_venv.h"
#include "tests/run_program.h"
#include "tests/server/proxy/proxy_policy.h"
#include "tests/server/wire/web_client.h"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr char kRobot[] = R"(name: panda
control_space: end_effector
dialect: libero
rate_hz: 20
real_time: false
execute_steps: 5
state: {position: [0, 1, 2], rotation: [3, 4, 5]}
action: {size: 7, translation: [0, 1, 2], rotation: [3, 4, 5], translation_unit: 0.05, rotation_unit: 0.5}
)";

class ProxyProgram : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = absl::StrCat(::testing::TempDir(), "/proxy-", getpid());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
    std::ofstream(folder_ + "/robot.yaml") << kRobot;
  }
  void TearDown() override {
    child_.reset();
    std::filesystem::remove_all(folder_);
  }
  // `under`: what starts the program, with its arguments behind.
  void Start(const std::vector<std::string>& more = {}, std::vector<std::string> under = {}) {
    std::vector<std::string> command = std::move(under);
    const std::vector<std::string> own = {
        PROXY_PROGRAM,           "--upstream",   upstream_.url(),   "--robot",
        folder_ + "/robot.yaml", "--listen",     "127.0.0.1:0",     "--http-listen",
        "127.0.0.1:0",           "--ports-file", folder_ + "/ports"};
    for (const auto& words : {own, more}) command.insert(command.end(), words.begin(), words.end());
    auto child = ChildProcess::Start(command, {}, folder_ + "/log");
    ASSERT_TRUE(child.ok()) << child.status();
    child_.emplace(*std::move(child));
    for (int i = 0; i < 1000 && !std::filesystem::exists(folder_ + "/ports"); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    ASSERT_TRUE(std::filesystem::exists(folder_ + "/ports")) << Log();
    const YAML::Node ports = YAML::LoadFile(folder_ + "/ports");
    port_ = ports["websocket"].as<int>();
    http_ = ports["http"].as<int>();
    for (int i = 0; i < 1000 && Page("/readyz").first != 200; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  std::pair<int, std::string> Page(const std::string& path) { return WebClient(http_).Get(path); }
  nlohmann::json State() { return nlohmann::json::parse(Page("/state").second); }
  std::pair<std::string, int> Tell(const std::string& what) {
    return RunProgram(PROXY_PROGRAM, absl::StrCat(what, " --at 127.0.0.1:", http_));
  }
  std::string Log() const {
    std::ifstream file(folder_ + "/log");
    return {std::istreambuf_iterator<char>(file), {}};
  }
  // The mode, once it is that.
  std::string ModeBecomes(const std::string& mode) {
    for (int i = 0; i < 500 && State()["mode"] != mode; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return State()["mode"];
  }

  const Upstream upstream_{LeadToGoal};
  std::string folder_;
  std::optional<ChildProcess> child_;
  int port_ = 0, http_ = 0;
};

TEST_F(ProxyProgram, IsSwitchedByOneCommandOrOneSignal) {
  Start();
  EXPECT_EQ(State()["mode"], "on");
  const auto [said, code] = Tell("off");
  EXPECT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr(R"("mode":"off")"));
  EXPECT_EQ(State()["mode"], "off");
  EXPECT_THAT(Tell("on").first, HasSubstr(R"("mode":"on")"));
  kill(child_->pid(), SIGUSR1);
  EXPECT_EQ(ModeBecomes("off"), "off");
  kill(child_->pid(), SIGUSR2);
  EXPECT_EQ(ModeBecomes("on"), "on");
  EXPECT_THAT(Tell("state").first, HasSubstr(R"("upstream_there":true)"));
  EXPECT_THAT(Page("/metrics").second, HasSubstr("robostress_proxy_corrects 1"));
  EXPECT_THAT(Page("/").second, HasSubstr("RoboStress proxy"));
  EXPECT_EQ(Page("/nowhere").first, 404);
  EXPECT_EQ(child_->Terminate(10000).code, 0) << Log();
}

TEST_F(ProxyProgram, OfSignalsThatWaitTogetherOffWins) {
  Start();
  for (const auto& [first, second] : {std::pair(SIGUSR1, SIGUSR2), std::pair(SIGUSR2, SIGUSR1)}) {
    kill(child_->pid(), SIGSTOP);
    kill(child_->pid(), first);
    kill(child_->pid(), second);
    kill(child_->pid(), SIGCONT);
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    EXPECT_EQ(State()["mode"], "off");
    kill(child_->pid(), SIGUSR2);
    EXPECT_EQ(ModeBecomes("on"), "on");
  }
}

TEST_F(ProxyProgram, SaysWhatIsWrong) {
  const auto [nothing, code] = RunProgram(PROXY_PROGRAM, "");
  EXPECT_EQ(code, 1);
  EXPECT_THAT(nothing, HasSubstr("--upstream ws://HOST:PORT --robot robot.yaml"));
  std::ofstream(folder_ + "/robot.yaml", std::ios::app) << "method: ours\n";
  const auto [refused, ends] =
      RunProgram(PROXY_PROGRAM,
                 absl::StrCat("--upstream ", upstream_.url(), " --robot ", folder_, "/robot.yaml"));
  EXPECT_EQ(ends, 1);
  EXPECT_THAT(refused, HasSubstr("adapts weights"));
  const auto [nobody, gone] = RunProgram(PROXY_PROGRAM, "off --at 127.0.0.1:1");
  EXPECT_EQ(gone, 1);
  EXPECT_THAT(nobody, HasSubstr("Connection refused"));
}

// One client and what it is answered, where the arm stands still.
class Asking {
 public:
  explicit Asking(int port) {
    auto connected = OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", port));
    EXPECT_TRUE(connected.ok()) << connected.status();
    if (connected.ok()) connection_ = *std::move(connected);
  }
  // The first action, as the client gets it.
  Eigen::VectorXd Ask(double x = 0) {
    const auto answer =
        connection_->Ask(LiberoObservation({x, 0, 0, 0, 0, 0, 0.02, -0.02}), absl::Seconds(10));
    EXPECT_TRUE(answer.ok()) << answer.status();
    return answer.ok() ? ReadActions(*answer, *FindActions(*answer)).row(0).transpose().eval()
                       : Eigen::VectorXd();
  }

 private:
  std::unique_ptr<OpenpiConnection> connection_;
};

TEST_F(ProxyProgram, ServesThroughAFloodOfSignals) {
  Start();
  std::atomic<bool> over = false;
  std::thread flood([&] {
    for (int i = 0; i < 20000; ++i) kill(child_->pid(), i % 2 == 0 ? SIGUSR1 : SIGUSR2);
    kill(child_->pid(), SIGHUP);
    over = true;
  });
  Asking client(port_);
  int asked = 0;
  for (; asked < 50 || !over; ++asked) {
    const Eigen::VectorXd action = client.Ask();
    ASSERT_EQ(action.size(), 7);
    ASSERT_LE(std::abs(action[0] - 1), 0.5 + 1e-6) << "the server says 1; at most 0.5 is ours";
  }
  flood.join();
  kill(child_->pid(), SIGUSR1);
  EXPECT_EQ(ModeBecomes("off"), "off");
  EXPECT_EQ(client.Ask()[0], 1);
  EXPECT_EQ(child_->Terminate(10000).code, 0) << Log();
}

TEST_F(ProxyProgram, AClientThatComesBackInMidChunkBeginsAtZero) {
  Start({"--set", "following_limit=0.4"});
  {
    Asking stuck(port_);
    Eigen::VectorXd action;
    for (int i = 0; i < 5; ++i) action = stuck.Ask();  // it is told to move and does not, yet
    EXPECT_NE(action[0], 1) << "it was corrected";
  }
  Asking again(port_);
  EXPECT_EQ(again.Ask(0.01)[0], 1) << "nothing is known of it";
  EXPECT_EQ(State()["clients"], 1);
}

TEST_F(ProxyProgram, SaysThatTwoClientsAreTwoRobots) {
  Start();
  Asking one(port_), two(port_);
  one.Ask();
  two.Ask();
  EXPECT_THAT(Log(), HasSubstr("--max-clients 1 lets one in"));
}

TEST_F(ProxyProgram, ARecordThatMayNotGrowEndsAndItsClientsDoNot) {
  Start({"--out", folder_ + "/record"}, {"/bin/bash", "-c", "ulimit -f 4 && exec \"$@\"", "bash"});
  Asking client(port_);
  for (int i = 0; i < 400; ++i) client.Ask();
  for (int i = 0; i < 500 && !State().contains("record_failure"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_THAT(std::string(State()["record_failure"]), HasSubstr("residuals.csv: File too large"));
  EXPECT_THAT(Page("/").second, HasSubstr("The record ended: "));
  EXPECT_THAT(Page("/metrics").second, HasSubstr("robostress_proxy_record_dropped"));
  client.Ask();
  EXPECT_EQ(child_->Terminate(10000).code, 0);
  std::ifstream file(folder_ + "/record/residuals.csv");
  const std::string rows((std::istreambuf_iterator<char>(file)), {});
  EXPECT_GT(rows.size(), 2000u);
  EXPECT_EQ(rows.back(), '\n');
}

TEST_F(ProxyProgram, AFolderThatCannotBeWrittenIsNamedAtTheStart) {
  const auto [said, code] = RunProgram(
      PROXY_PROGRAM, absl::StrCat("--upstream ", upstream_.url(), " --robot ", folder_,
                                  "/robot.yaml --listen 127.0.0.1:0 --out /proc/record"));
  EXPECT_EQ(code, 1);
  EXPECT_THAT(said, HasSubstr("/proc/record"));
}

TEST_F(ProxyProgram, WinsBackFrictionForOpenpisOwnClient) {
  if (!OpenpiVenv::Get().failure.empty()) GTEST_SKIP() << OpenpiVenv::Get().failure;
  Start({"--out", folder_ + "/record"});
  const auto drive = [](int port) {
    const auto [output, code] = RunProgram(OpenpiVenv::Get().python,
                                           absl::StrCat(PROXY_CLIENT_DRIVER, " ", port, " 60 224"));
    EXPECT_EQ(code, 0) << output;
    std::cout << output;
    const size_t at = output.find("error ");
    return at == std::string::npos ? -1 : std::atof(output.c_str() + at + 6);
  };
  const double direct = drive(upstream_.port()), corrected = drive(port_);
  EXPECT_GT(direct, 0.5);
  EXPECT_LT(corrected, 0.4 * direct);
  EXPECT_GT(State()["answers"]["corrected"], 20);
  EXPECT_EQ(State()["answers"]["doubt"], 0) << Log();
  Tell("off");
  EXPECT_NEAR(drive(port_), direct, 1e-9) << "as if the proxy were not there";
  EXPECT_EQ(child_->Terminate(10000).code, 0);
  std::ifstream record(folder_ + "/record/residuals.csv");
  std::string header, row;
  std::getline(record, header);
  EXPECT_THAT(header, HasSubstr("t_s,client,episode,chunk,outcome,doubt,residual_x"));
  int rows = 0;
  while (std::getline(record, row)) ++rows;
  EXPECT_EQ(rows, 60) << "nothing is recorded while it is off";
}

}  // namespace
}  // namespace robostress
