// A policy behind vla-eval's own server, from PyPI: asked by us, and by vla-eval's own client. It
// is skipped, with the reason, where they cannot be installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/remote_policy.h"
#include "tests/common/wire/openpi_venv.h"
#include "tests/common/wire/python_peer.h"

namespace robostress {
namespace {

class VlaEvalPeer : public ::testing::Test {
 protected:
  VlaEvalPeer() {
    setting_.policy = "tiny";
    setting_.suite = "tabletop_goal";
    UseDialect(*OpenpiDialectNamed("vla_eval"), options_);
    // What vla_eval_peer.py's client shows.
    observation_.instruction = "do something";
    for (int k = 0; k < 2; ++k) {
      Image image{256, 256, std::vector<uint8_t>(3 * 256 * 256)};
      for (size_t i = 0; i < image.data.size(); ++i)
        image.data[i] = static_cast<uint8_t>(k + i % 251);
      observation_.views.push_back({absl::StrCat("camera", k), std::move(image)});
    }
    observation_.proprioception = Eigen::VectorXf::LinSpaced(8, 0.5f, 2.25f);
  }
  void SetUp() override {
    if (!Venv().failure.empty()) GTEST_SKIP() << Venv().failure;
    log_ = absl::StrCat(::testing::TempDir(), "vla_eval_peer_", getpid());
    std::filesystem::remove(log_);
  }
  void TearDown() override { std::filesystem::remove(log_); }
  static const OpenpiVenv& Venv() {
    static const OpenpiVenv& venv =
        *new OpenpiVenv(OpenpiVenv::Make(VLA_EVAL_VENV, VLA_EVAL_REQUIREMENTS, "vla-eval"));
    return venv;
  }
  std::unique_ptr<RemotePolicy> Connect(const PythonPeer& server) {
    auto policy = RemotePolicy::Connect(server.url(), options_, setting_);
    EXPECT_TRUE(policy.ok()) << policy.status();
    if (!policy.ok() || !(*policy)->StartEpisode({0, 0}).ok()) return nullptr;
    return *std::move(policy);
  }
  std::string Log() const {
    std::ifstream file(log_);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  SessionSetting setting_;
  RemotePolicyOptions options_;
  Observation observation_;
  std::string log_;
};

TEST_F(VlaEvalPeer, GivesUsTheRowsThatItGivesItsOwnClient) {
  const PythonPeer server(Venv().python, {VLA_EVAL_PEER, "serve", log_});
  const auto [output, code] =
      RunProgram(Venv().python, absl::StrCat(VLA_EVAL_PEER, " ask ", server.port()));
  ASSERT_EQ(code, 0) << output;
  const std::vector<std::string> lines = absl::StrSplit(output, '\n', absl::SkipEmpty());
  ASSERT_EQ(lines.size(), 4u) << output;
  const auto policy = Connect(server);
  ASSERT_NE(policy, nullptr);
  EXPECT_NE(policy->metadata().find(R"("model_server":"Tiny")"), std::string::npos);
  for (int row = 0; row < 4; ++row) {
    const auto predicted = policy->Predict(observation_, row);
    ASSERT_TRUE(predicted.ok()) << predicted.status();
    const std::vector<std::string> numbers = absl::StrSplit(lines[row], ' ');
    ASSERT_EQ(numbers.size(), 7u) << output;
    for (int column = 0; column < 7; ++column) {
      float number = NAN;
      EXPECT_TRUE(absl::SimpleAtof(numbers[column], &number));
      EXPECT_EQ(predicted->actions(0, column), number) << row << ", " << column;
    }
  }
}

TEST_F(VlaEvalPeer, HearsOfEveryEpisodeAlsoAfterItHungUp) {
  const PythonPeer server(Venv().python, {VLA_EVAL_PEER, "serve", log_, "3"});
  {
    const auto policy = Connect(server);
    ASSERT_NE(policy, nullptr);
    for (int chunk = 0; chunk < 4; ++chunk) {
      const auto predicted = policy->Predict(observation_, chunk);
      ASSERT_TRUE(predicted.ok()) << predicted.status();
    }
    EXPECT_EQ(policy->reconnections(), 1);
    ExecutedChunk last;
    last.last_of_episode = true;
    ASSERT_TRUE(policy->SendFeedback(last).ok());
    ASSERT_TRUE(policy->StartEpisode({0, 1}).ok());
    observation_.instruction = "do something else";
    ASSERT_TRUE(policy->Predict(observation_, 0).ok());
    EXPECT_EQ(policy->reconnections(), 2);
  }
  // Its last end comes when it sees that we are gone.
  const std::string expected =
      "start do something\nend do something\nstart do something\nend do something\n"
      "start do something else\nend do something else\nstart do something else\n";
  EXPECT_EQ(Log().substr(0, expected.size()), expected);
}

TEST_F(VlaEvalPeer, SaysWhyItsModelFailed) {
  const PythonPeer server(Venv().python, {VLA_EVAL_PEER, "serve", log_});
  const auto policy = Connect(server);
  ASSERT_NE(policy, nullptr);
  observation_.views[1].image = {2, 2, std::vector<uint8_t>(12)};
  const absl::Status failed = policy->Predict(observation_, 0).status();
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(failed.message()),
              ::testing::HasSubstr(absl::StrCat(server.url(),
                                                "/: the policy server failed: "
                                                "observation_failed: AssertionError: (dtype('uint8'"
                                                "), (2, 2, 3))")));
}

}  // namespace
}  // namespace robostress
