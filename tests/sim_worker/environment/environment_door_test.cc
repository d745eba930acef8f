#include "sim_worker/environment/environment_door.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "common/random.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using Json = nlohmann::json;
using testing::HasSubstr;

// Counts what it is told; a view is 2 x 2 pixels of the step's number.
class CountingRobot : public Robot {
 public:
  absl::Status Reset(int initial_state) override {
    if (initial_state >= 50) return absl::OutOfRangeError("initial state 50 does not exist");
    initial_state_ = initial_state;
    commands.clear();
    return absl::OkStatus();
  }
  absl::StatusOr<Observation> Observe(const PolicySpec& spec) override {
    Observation seen;
    seen.instruction = "count";
    seen.proprioception = Eigen::VectorXf::Constant(8, 0.1F * static_cast<float>(initial_state_));
    for (const std::string& camera : spec.cameras) {
      const auto width = static_cast<size_t>(spec.image_width);
      const size_t bytes = 3 * width * static_cast<size_t>(spec.image_height);
      seen.views.push_back({camera,
                            {spec.image_width, spec.image_height,
                             std::vector<uint8_t>(bytes, static_cast<uint8_t>(commands.size()))}});
    }
    return seen;
  }
  absl::StatusOr<RobotState> Measure() override {
    RobotState state;
    state.q = Eigen::VectorXd::Constant(7, 1.0 / 3);
    state.dq = Eigen::VectorXd::Zero(7);
    return state;
  }
  absl::Status Step(const Eigen::VectorXf& command) override {
    commands.push_back(command);
    return absl::OkStatus();
  }
  bool Success() const override { return commands.size() == 2; }
  int horizon() const override { return 10; }

  std::vector<Eigen::VectorXf> commands;

 private:
  int initial_state_ = 0;
};

class EnvironmentDoor : public testing::Test {
 protected:
  // The answers' lines; what stands behind them is checked for its size and first byte.
  std::vector<Json> Ask(const std::string& requests) {
    std::istringstream in(requests);
    std::ostringstream out;
    status_ = ServeEnvironment(robot_, {{"one", "two"}, 2}, 7, in, out);
    std::istringstream answers(out.str());
    std::vector<Json> lines;
    for (std::string line; std::getline(answers, line);) {
      lines.push_back(Json::parse(line));
      std::string views(lines.back().value("image_bytes", 0), '\0');
      answers.read(views.data(), static_cast<std::streamsize>(views.size()));
      const char shade = static_cast<char>(lines.back().value("step", 0));
      EXPECT_EQ(views, std::string(views.size(), shade));
      EXPECT_TRUE(views.empty() || views.size() == 24);
    }
    return lines;
  }
  std::string ErrorOf(const std::string& request) {
    const std::vector<Json> answers = Ask(R"({"reset": 3})"
                                          "\n" +
                                          request + "\n");
    EXPECT_TRUE(robot_.commands.empty()) << request;
    return answers.size() == 2 ? answers[1].value("error", "no error") : "no answer";
  }

  CountingRobot robot_;
  absl::Status status_;
};

constexpr char kStep[] = R"({"step": [0.1, 0, -0.2, 0, 0, 0, 1]})"
                         "\n";

TEST_F(EnvironmentDoor, AnswersEveryRequestWithStateAndViews) {
  const std::vector<Json> answers = Ask(std::string("{\"reset\": 3}\n") + kStep + kStep);
  EXPECT_TRUE(status_.ok()) << status_;
  ASSERT_EQ(answers.size(), 3u);
  EXPECT_EQ(answers[0]["step"], 0);
  EXPECT_EQ(answers[2]["step"], 2);
  EXPECT_EQ(answers[1]["success"], false);
  EXPECT_EQ(answers[2]["success"], true);
  EXPECT_EQ(answers[0]["instruction"], "count");
  EXPECT_EQ(answers[0]["agent_pos"][0].get<float>(), 0.1F * 3) << "to the last bit";
  EXPECT_EQ(answers[0]["state"]["q"][6].get<double>(), 1.0 / 3);
  EXPECT_EQ(answers[0]["state"]["quaternion"], Json({1.0, 0.0, 0.0, 0.0}));
  ASSERT_EQ(robot_.commands.size(), 2u);
  EXPECT_EQ(robot_.commands[0][2], -0.2F);
}

TEST_F(EnvironmentDoor, SaysWhatIsWrongAndGoesOn) {
  EXPECT_EQ(ErrorOf(R"({"step": [0, 0]})"), "step is [0,0], must be a list of 7 numbers");
  EXPECT_EQ(ErrorOf(R"({"step": [0, 0, 0, "up", 0, 0, 0]})"),
            "step[3] is \"up\", must be a number");
  EXPECT_THAT(ErrorOf(R"({"step": [0, 0, 0, 0, 0, 0, 1e99]})"),
              HasSubstr("step[6] is 1e+99, must be a finite"));
  EXPECT_THAT(ErrorOf(R"({"step": [0, 0, 0, 0, 0, 0, NaN]})"), HasSubstr("a request is"));
  EXPECT_EQ(ErrorOf(R"({"reset": 50})"), "initial state 50 does not exist");
  EXPECT_THAT(ErrorOf(R"({"reset": -1})"), HasSubstr("reset is -1, must be"));
  EXPECT_THAT(ErrorOf(R"({"reset": 5000000000})"), HasSubstr("must be the number of an initial"));
  EXPECT_THAT(ErrorOf(R"({"render": 1})"), HasSubstr("request 'render' is unknown"));
  EXPECT_THAT(ErrorOf(R"({"reset": 1, "step": 2})"), HasSubstr("a request is"));
  EXPECT_THAT(ErrorOf("[]"), HasSubstr("a request is"));
  EXPECT_THAT(ErrorOf("\xff{"), HasSubstr("a request is"));
  EXPECT_TRUE(status_.ok()) << status_;
  EXPECT_EQ(Ask(kStep).at(0)["error"], "step comes before the first reset");
}

TEST_F(EnvironmentDoor, EndsALineThatNeverEnds) {
  Ask(std::string(1 << 17, '['));
  EXPECT_THAT(status_.message(), HasSubstr("longer than 65536 bytes"));
}

TEST_F(EnvironmentDoor, NoBytesBringItDown) {
  RandomStream random(StreamKey("environment door"));
  const std::string good = std::string("{\"reset\": 3}\n") + kStep;
  for (int i = 0; i < 2000; ++i) {
    std::string text = good;
    for (int k = 0; k < 3; ++k)
      text[static_cast<size_t>(random.Uniform(0, static_cast<double>(text.size())))] =
          static_cast<char>(random.Uniform(0, 256));
    std::istringstream in(text);
    std::ostringstream out;
    EXPECT_TRUE(ServeEnvironment(robot_, {}, 7, in, out).ok());
    for (const Eigen::VectorXf& command : robot_.commands) EXPECT_TRUE(command.allFinite());
  }
}

}  // namespace
}  // namespace robostress
