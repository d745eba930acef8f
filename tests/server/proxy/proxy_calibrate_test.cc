// The worked example of docs/results/proxy.md: a joint with friction that nobody knows of is driven
// through `robostress proxy --shadow --out`, and `robostress calibrate` names the friction from
// what the proxy recorded.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/random.h"
#include "common/wire/openpi_connection.h"
#include "server/proxy/action_block.h"
#include "tests/run_program.h"
#include "tests/server/proxy/proxy_messages.h"
#include "tests/server/proxy/upstream.h"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr double kRateHz = 50;

// A bar on a hinge under a servo kp (target - q) - kd dq, with Stribeck friction.
class RubbingHinge {
 public:
  void Step(double target) {
    constexpr int kSubSteps = 400;
    constexpr double h = 1 / kRateHz / kSubSteps;
    for (int i = 0; i < kSubSteps; ++i) {
      const double push = kKp * (target - q_) - kKd * v_ - kGravity * std::sin(q_);
      const double dry = kFc + (kFs - kFc) * std::exp(-(v_ / kVs) * (v_ / kVs));
      if (v_ == 0 && std::abs(push) <= dry) continue;
      const double way = v_ != 0 ? v_ : push;
      const double next = v_ + h / kInertia * (push - std::copysign(dry, way) - kViscous * v_);
      v_ = next * v_ < 0 ? 0 : next;
      q_ += h * v_;
    }
  }
  double q() const { return q_; }

 private:
  // The rig of the page knows these ...
  static constexpr double kKp = 40, kKd = 2, kInertia = 0.05, kGravity = 1 * 9.81 * 0.2;
  // ... and not these.
  static constexpr double kFc = 0.5, kFs = 0.8, kVs = 0.1, kViscous = 0.15;
  double q_ = 0, v_ = 0;
};

// What its policy asks for at a step: sways of three speeds, reversals, and rests.
double Target(int run, int step) {
  const double t = step / kRateHz;
  if (std::fmod(t, 12) > 11) return 0.3 * std::sin(0.9 * (t - std::fmod(t, 12) + 11));
  return 0.3 * std::sin(0.9 * t) + 0.25 * std::sin((2.3 + 0.2 * run) * t) +
         0.06 * std::sin((7.1 + 0.3 * run) * t);
}

class ProxyCalibrate : public ::testing::Test {
 protected:
  ProxyCalibrate()
      : folder_(absl::StrCat(::testing::TempDir(), "/proxy-calibrate-", getpid())),
        page_(ReadFile("docs/results/proxy.md").value_or("")) {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
    Write("hinge.xml",
          "<mujoco><option gravity=\"0 0 -9.81\"/><worldbody><body>"
          "<joint name=\"hinge\" type=\"hinge\" axis=\"0 1 0\"/>"
          "<inertial pos=\"0 0 -0.2\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/>"
          "</body></worldbody></mujoco>\n");
    // It does not wait for the clock.
    Write("robot.yaml", Block("name: hinge_arm") + "real_time: false\n");
    Write("rig.yaml", Block("name: tuesday"));
  }
  ~ProxyCalibrate() override { std::filesystem::remove_all(folder_); }

  void Write(const std::string& name, const std::string& text) const {
    ASSERT_TRUE(WriteFileAtomically(folder_ + "/" + name, text).ok());
  }
  // The page's block that begins so.
  std::string Block(const std::string& begin) const {
    const size_t at = page_.find("```yaml\n" + begin);
    EXPECT_NE(at, std::string::npos) << "docs/results/proxy.md has no block " << begin;
    if (at == std::string::npos) return "";
    return page_.substr(at + 8, page_.find("```", at + 8) - at - 8);
  }
  // Port of a proxy that runs.
  int Start(const std::vector<std::string>& more) {
    std::vector<std::string> command = {PROXY_PROGRAM,
                                        "--upstream",
                                        upstream_.url(),
                                        "--robot",
                                        folder_ + "/robot.yaml",
                                        "--listen",
                                        "127.0.0.1:0",
                                        "--http-listen",
                                        "",
                                        "--out",
                                        folder_ + "/runs/tuesday",
                                        "--ports-file",
                                        folder_ + "/ports"};
    command.insert(command.end(), more.begin(), more.end());
    auto child = ChildProcess::Start(command, {}, folder_ + "/log");
    EXPECT_TRUE(child.ok()) << child.status();
    proxy_.emplace(*std::move(child));
    for (int i = 0; i < 1000 && !std::filesystem::exists(folder_ + "/ports"); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return YAML::LoadFile(folder_ + "/ports")["websocket"].as<int>();
  }
  // A minute of the arm, in as little time as it takes.
  void Drive(int port, int run) {
    absl::StatusOr<std::unique_ptr<OpenpiConnection>> server = absl::UnavailableError("");
    for (int i = 0; i < 500 && !server.ok(); ++i) {
      if (i > 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      server = OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", port));
    }
    ASSERT_TRUE(server.ok()) << server.status();
    RubbingHinge hinge;
    RandomStream random(StreamKey("proxy calibrate").With(static_cast<uint64_t>(run)));
    for (int step = 0; step < 60 * static_cast<int>(kRateHz); ++step) {
      const double reading = hinge.q() + 5e-5 * random.Normal();
      const auto answer = (*server)->Ask(JointObservation({reading, 0}), absl::Seconds(10));
      ASSERT_TRUE(answer.ok()) << answer.status();
      hinge.Step(ReadActions(*answer, *FindActions(*answer))(0, 0));
    }
  }

  std::atomic<int> runs_ = 0;
  const Upstream upstream_{[this](Upstream::Socket& socket, const Upstream::Request&) {
    const int run = runs_++;
    Upstream::Write(socket, std::string(1, '\x80'));
    for (int step = 0; Upstream::Read(socket); ++step)
      Upstream::Write(socket, ActionAnswer<double>({Target(run, step), 0}, 1));
  }};
  const std::string folder_, page_;
  std::optional<ChildProcess> proxy_;
};

TEST_F(ProxyCalibrate, NamesTheFrictionOfWhatAProxyRecorded) {
  const int port = Start({"--shadow"});
  for (int run = 0; run < 3; ++run) Drive(port, run);
  ASSERT_EQ(proxy_->Terminate(10000).code, 0) << *ReadFile(folder_ + "/log");
  for (int client = 1; client <= 3; ++client) {
    EXPECT_TRUE(
        std::filesystem::exists(absl::StrCat(folder_, "/runs/tuesday/joints-", client, "-0.csv")));
  }
  const auto [output, code] =
      RunProgram("cd " + folder_ + " && OMP_NUM_THREADS=1 " + CALIBRATE_PROGRAM,
                 "--rig rig.yaml --surrogates 199 --out runs/found");
  std::cout << output;
  EXPECT_EQ(code, 0);
  EXPECT_THAT(output, AllOf(HasSubstr("hinge: attributed"), HasSubstr("+ stribeck_friction: ")));
}

}  // namespace
}  // namespace robostress
