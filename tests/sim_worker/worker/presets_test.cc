// Every shipped method with the embedded policy on the simulated arm, through both programs.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/safetensors.h"
#include "common/unit/robots.h"
#include "common/unit_config.h"
#include "nlohmann/json.hpp"
#include "tests/run_program.h"
#include "tests/server/serve_process.h"

namespace robostress {
namespace {

std::vector<std::string> PandasMethods() { return FindRobot("panda")->methods; }

namespace fs = std::filesystem;
using nlohmann::json;

constexpr int kDof = 7, kGripper = 6;
constexpr int kExecuted = 5;            // steps of a chunk
constexpr double kParameters = 50'176;  // of nano's adapter

// One episode of one method: its row, its resolved method and the commands as they were sent.
struct Episode {
  json row;
  MethodOptions method;
  std::vector<double> actions;  // [steps, 7]
  int steps() const { return static_cast<int>(actions.size()) / kDof; }
  double at(int step, int axis) const { return actions[step * kDof + axis]; }
};

class Presets : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    root_ = new fs::path(fs::path(testing::TempDir()) / absl::StrCat("presets_", getpid()));
    fs::create_directories(*root_);
    ASSERT_TRUE(WriteFileAtomically(*root_ / "aged_joint_uniform_found.yaml", R"(title: Identified
joints:
  - name: J2
    effects: [{type: gravity_error, beta: 0.1}]
)")
                    .ok());
    serve_ =
        new ServeProcess(SERVE_PROGRAM, {"--policy", "nano", "--websocket-listen", "127.0.0.1:0"});
    episodes_ = new std::map<std::string, Episode>();
    for (const std::string& method : PandasMethods()) (*episodes_)[method] = Run(method);
  }
  static void TearDownTestSuite() {
    delete serve_;
    fs::remove_all(*root_);
    delete root_;
    delete episodes_;
  }

  // Where a method reads what was identified of the arm: a file of this test.
  static std::vector<std::string> Overrides(const std::string& method) {
    if (method != "ours_identified") return {};
    return {absl::StrCat("arm_model=", root_->string(), "/{scenario}_found.yaml")};
  }

  static Episode Run(const std::string& method) {
    return Run(method, method, serve_->Address("grpc"));
  }
  static Episode Run(const std::string& method, const std::string& folder,
                     const std::string& server) {
    const std::string out = (*root_ / folder).string();
    std::string set;
    for (const std::string& assignment : Overrides(method))
      absl::StrAppend(&set, " --set method.", assignment);
    const auto [output, code] = RunProgram(
        WORKER_PROGRAM,
        absl::StrCat("--quiet --set suite=tabletop_goal --set scenario=aged_joint_uniform --set "
                     "policy=nano --set method.method=",
                     method, " --set tasks=[0] --set episodes=1 --record-joints --server ", server,
                     " --out ", out, set));
    EXPECT_EQ(code, 0) << output;
    Episode episode;
    if (code != 0) return episode;
    episode.row = json::parse(*ReadFile(out + "/episodes.jsonl"));
    episode.method = *ParseConfig<UnitConfig>("config", *ReadFile(out + "/config.yaml"))->method;
    episode.actions = *SafetensorsFile::Open(out + "/joints/task0_episode0.safetensors")
                           ->ReadDoubles("actions", {-1, kDof});
    return episode;
  }
  static const Episode& Of(const std::string& method) { return episodes_->at(method); }

  // The first step whose command is not that of `other`.
  static int FirstDifference(const std::string& method, const std::string& other = "base") {
    const Episode& ours = Of(method);
    const Episode& base = Of(other);
    const auto end = std::min(ours.actions.size(), base.actions.size());
    const auto [a, b] =
        std::mismatch(ours.actions.begin(), ours.actions.begin() + end, base.actions.begin());
    return static_cast<int>(a - ours.actions.begin()) / kDof;
  }
  // What the second chunk's commands have beside base's, which saw the same first one.
  static std::vector<double> Correction(const std::string& method) {
    EXPECT_EQ(FirstDifference(method), kExecuted) << method;
    std::vector<double> correction;
    for (int axis = 0; axis < kDof; ++axis) {
      const auto added = [&](int step) {
        return Of(method).at(step, axis) - Of("base").at(step, axis);
      };
      correction.push_back(added(kExecuted));
      for (int step = kExecuted; step < 2 * kExecuted; ++step)
        EXPECT_NEAR(added(step), correction[axis], 1e-6) << method << " " << step << " " << axis;
    }
    return correction;
  }

  static fs::path* root_;
  static ServeProcess* serve_;
  static std::map<std::string, Episode>* episodes_;
};

fs::path* Presets::root_ = nullptr;
ServeProcess* Presets::serve_ = nullptr;
std::map<std::string, Episode>* Presets::episodes_ = nullptr;

// As a server of somebody else, which knows no method: what is added is the worker's.
TEST_F(Presets, GiveTheSameRowsAroundAPolicyBehindOpenpisWire) {
  const std::string foreign =
      absl::StrCat("ws://", serve_->Address("websocket"),
                   " --set remote.dialect.name=robostress --set remote.dialect.state=[state] --set "
                   "remote.dialect.episode=episode --set remote.dialect.session=session --set "
                   "remote.dialect.describes_session=true");
  for (const std::string method : {"base", "gain", "direct", "ours_following"}) {
    const Episode episode = Run(method, method + "_foreign", foreign);
    EXPECT_EQ(episode.row, Of(method).row) << method;
    EXPECT_EQ(episode.actions, Of(method).actions) << method;
  }
}

TEST_F(Presets, RunAnEpisodeAsWhatTheyAre) {
  for (const std::string& method : PandasMethods()) {
    const Episode& episode = Of(method);
    EXPECT_EQ(DumpConfig(episode.method), DumpConfig(*MakeMethod(method, Overrides(method))));
    EXPECT_EQ(episode.row["method"], method);
    EXPECT_EQ(episode.row["steps"], episode.steps());
    EXPECT_GT(episode.steps(), 0) << method;
    for (const auto& [key, value] : episode.row.items())
      EXPECT_TRUE(!value.is_number() || std::isfinite(value.get<double>())) << method << " " << key;
    for (const double action : episode.actions) ASSERT_LE(std::abs(action), 3) << method;
    EXPECT_LT(episode.row["mean_abs_action"], 0.4) << method;
  }
}

TEST_F(Presets, UpdateAtChunk32And40AndSoOnOrNever) {
  for (const std::string& method : PandasMethods()) {
    const json& row = Of(method).row;
    const int chunks = row["chunks"], due = chunks < 32 ? 0 : 1 + (chunks - 32) / 8;
    EXPECT_EQ(row["updates"], Of(method).method.adapts() ? due : 0) << method;
    EXPECT_EQ(row["adapter_distance"] > 0, row["updates"] > 0) << method;
  }
}

TEST_F(Presets, EqualWhatTheyAreOnTopOfBitForBitUntilTheirFirstUpdate) {
  for (const std::string& method : PandasMethods()) {
    if (!Of(method).method.adapts()) continue;
    if (method == "ours_learning") {
      EXPECT_EQ(FirstDifference(method, "ours_replanning"),
                std::min(32 * Of(method).method.execute_steps, Of(method).steps()));
    } else {
      EXPECT_EQ(FirstDifference(method), 32 * kExecuted) << method;
    }
  }
}

// The worker's nominal arm is the method's.
TEST_F(Presets, ANominalPandaCorrectsOtherwise) {
  EXPECT_LT(FirstDifference("ours_panda", "ours_replanning"), Of("ours_panda").steps());
}

TEST_F(Presets, AStepOfAdamIsAboutTheLearningRateForEveryParameter) {
  for (const std::string& method : PandasMethods()) {
    const Episode& episode = Of(method);
    if (!episode.method.adapts() || episode.row["updates"] == 0) continue;
    const double steps = episode.row["updates"].get<double>() * std::sqrt(kParameters);
    const double rate = episode.row["adapter_distance"].get<double>() / steps;
    EXPECT_LT(rate, episode.method.Find<LoraOptions>()->learning_rate) << method;
    EXPECT_GT(rate, 0.35 * episode.method.Find<LoraOptions>()->learning_rate) << method;
  }
}

TEST_F(Presets, GainScalesAllButTheGripper) {
  EXPECT_EQ(FirstDifference("gain"), 0);
  for (int step = 0; step < kExecuted; ++step) {
    for (int axis = 0; axis < kDof; ++axis) {
      const double base = Of("base").at(step, axis);
      EXPECT_NEAR(Of("gain").at(step, axis), axis == kGripper ? base : 1.15 * base, 1e-6);
    }
  }
}

TEST_F(Presets, NullHasOtherNoiseFromTheFirstStepOn) { EXPECT_EQ(FirstDifference("null"), 0); }

TEST_F(Presets, ControlsChangeWhatThePolicySees) {
  EXPECT_EQ(FirstDifference("shuffled_instruction"), 0);
  EXPECT_EQ(FirstDifference("blank_images"), 0);
  EXPECT_EQ(FirstDifference("frozen_state"), kExecuted) << "the first state is the first state";
}

TEST_F(Presets, CorrectionsWithoutALearnerStayOnTheirAxesAndWithinTheirBounds) {
  const std::vector<double> direct = Correction("direct"), integral = Correction("ours_integral"),
                            following = Correction("ours_following");
  for (int axis = 0; axis < kDof; ++axis) {
    EXPECT_EQ(direct[axis] != 0, axis != kGripper) << "of all of the arm's axes";
    EXPECT_EQ(integral[axis] != 0, axis < 3) << "of translation";
    EXPECT_LE(std::abs(integral[axis]), 0.5);
    EXPECT_LE(std::abs(following[axis]), 0.5 + 0.5);
  }
  // Integral action of 5 steps of a hundredth: a twentieth of what `direct` takes off at once, or
  // less. Model following moves x and y, but for what integral action gives z above its threshold.
  EXPECT_LT(std::hypot(integral[0], integral[1], integral[2]),
            0.05 * std::hypot(direct[0], direct[1], direct[2]));
  EXPECT_GT(std::hypot(following[0], following[1]), 0.2) << "following_gain 1, above the threshold";
  for (int axis = 2; axis < kDof; ++axis) EXPECT_EQ(following[axis], 0) << axis;
}

}  // namespace
}  // namespace robostress
