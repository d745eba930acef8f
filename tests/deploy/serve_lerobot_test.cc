// deploy/robostress_serve_lerobot.py and our client. Its wire runs with openpi's client from PyPI;
// policies of LeRobot run where ROBOSTRESS_LEROBOT_PYTHON names a Python that has it. Each is
// skipped, with the reason, where that is missing.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "tests/common/wire/openpi_venv.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr const char kKey[] = "0123456789abcdef0123";

// A Python program that serves on a port of 127.0.0.1, ended with this by SIGTERM, which must be an
// orderly end.
class PythonServer {
 public:
  explicit PythonServer(std::vector<std::string> command)
      : folder_(std::filesystem::path(::testing::TempDir()) /
                absl::StrCat("python-server-", getpid(), "-", ++count_)) {
    std::filesystem::create_directories(folder_);
    std::ofstream(folder_ / "key") << kKey << "\n";
    const std::string port_file = (folder_ / "port").string();
    command.insert(command.end(), {"--port", "0", "--port-file", port_file, "--api-key-file",
                                   (folder_ / "key").string()});
    child_ = fork();
    if (child_ == 0) {
      dup2(open((folder_ / "log").c_str(), O_WRONLY | O_CREAT, 0600), STDERR_FILENO);
      std::vector<char*> argv;
      for (std::string& argument : command) argv.push_back(argument.data());
      argv.push_back(nullptr);
      execv(argv[0], argv.data());
      _exit(127);
    }
    for (int i = 0; i < 2400 && !Ended() && !std::filesystem::exists(port_file); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    std::ifstream(port_file) >> port_;
    EXPECT_GT(port_, 0) << Log();
  }
  ~PythonServer() {
    if (!Ended()) {
      kill(child_, SIGTERM);
      waitpid(child_, &status_, 0);
    }
    EXPECT_TRUE(WIFEXITED(status_) && WEXITSTATUS(status_) == 0) << Log();
    std::filesystem::remove_all(folder_);
  }

  int port() const { return port_; }
  std::unique_ptr<OpenpiConnection> Connect() const {
    OpenpiConnectionOptions options;
    options.socket.secrets.token = kKey;
    auto connection = OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", port_), options);
    if (!connection.ok())
      throw std::runtime_error(connection.status().ToString());  // ends the test
    return *std::move(connection);
  }
  std::string Log() const {
    std::ifstream log(folder_ / "log");
    return {std::istreambuf_iterator<char>(log), {}};
  }

 private:
  bool Ended() { return ended_ = ended_ || waitpid(child_, &status_, WNOHANG) == child_; }

  static inline int count_ = 0;
  const std::filesystem::path folder_;
  pid_t child_ = 0;
  int status_ = 0, port_ = 0;
  bool ended_ = false;
};

// What lerobot_toys.py shows a policy of two views of `side` and a state of 8.
Observation Seen(int side) {
  Observation observation;
  observation.instruction = "do something";
  for (int k = 0; k < 2; ++k) {
    Image image{side, side, std::vector<uint8_t>(3 * side * side)};
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = static_cast<uint8_t>(200 + k + i % 50);
    observation.views.push_back({absl::StrCat("camera", k), std::move(image)});
  }
  observation.proprioception = Eigen::VectorXf::LinSpaced(8, 0.5f, 8.5f);
  return observation;
}

constexpr absl::Duration kLong = absl::Minutes(2);

using Extras = std::vector<std::pair<std::string, std::string>>;

Extras Seed(int64_t seed) { return {{"seed", OpenpiWriter().Integer(seed).Take()}}; }

absl::StatusOr<OpenpiAnswer> Ask(OpenpiConnection& connection, const Observation& observation,
                                 const Extras& extras = {},
                                 const OpenpiDialect& dialect = *OpenpiDialectNamed("libero")) {
  const auto bytes = connection.Ask(*WriteOpenpiObservation(observation, dialect, extras), kLong);
  if (!bytes.ok()) return bytes.status();
  return ReadOpenpiAnswer(*DecodeOpenpiValue(*bytes), {1, 50}, 7);
}

int64_t Declared(const OpenpiConnection& connection, const char* key) {
  const OpenpiValue* policies = connection.metadata().Find("policies");
  const auto number =
      OpenpiInteger(key, *std::get<OpenpiValue::List>(policies->value).front().Find(key), 0, 10000);
  EXPECT_TRUE(number.ok()) << number.status();
  return number.value_or(-1);
}

class ServeLerobotWire : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!OpenpiVenv::Get().failure.empty()) GTEST_SKIP() << OpenpiVenv::Get().failure;
  }
  static std::vector<std::string> Command(const std::vector<std::string>& options = {}) {
    std::vector<std::string> command{OpenpiVenv::Get().python,
                                     DEPLOY_TESTS "/serve_lerobot_driver.py", "serve"};
    command.insert(command.end(), options.begin(), options.end());
    return command;
  }
};

TEST_F(ServeLerobotWire, AnswersWhatWeSend) {
  const PythonServer server(Command());
  const auto connection = server.Connect();
  EXPECT_EQ(Declared(*connection, "action_horizon"), 10);
  const Observation seen = Seen(224);
  for (const int64_t seed : {int64_t{0}, int64_t{1} << 20}) {
    const auto answer = Ask(*connection, seen, Seed(seed));
    ASSERT_TRUE(answer.ok()) << answer.status();
    ASSERT_EQ(answer->actions.rows(), 10);
    EXPECT_EQ(answer->actions(4, 1), seen.proprioception[1] + 4);
    EXPECT_EQ(answer->actions(0, 3), seed);
    EXPECT_EQ(answer->actions(0, 5), 200) << "the first view";
    EXPECT_EQ(answer->actions(0, 6), 201) << "the wrist's";
    EXPECT_GT(answer->infer_ms, 0);
  }
  EXPECT_EQ(Ask(*connection, seen)->actions(0, 3), -1) << "no seed";
  EXPECT_EQ(Ask(*connection, seen, {{"reset", OpenpiWriter().Boolean(true).Take()}})->actions(0, 4),
            1);
  const auto reset =
      connection->Ask(OpenpiWriter().Map(1).Text("reset").Boolean(true).Take(), kLong);
  ASSERT_TRUE(reset.ok()) << reset.status();
  EXPECT_NE(DecodeOpenpiValue(*reset)->Find("reset"), nullptr);
  EXPECT_EQ(Ask(*connection, seen)->actions(0, 4), 2);
}

TEST_F(ServeLerobotWire, ReadsTheKeysOfOtherClients) {
  const PythonServer server(Command());
  const auto connection = server.Connect();
  OpenpiDialect planes{.name = "planes",
                       .cameras = {"image", "image2"},
                       .images_in = "images",
                       .planes_first = true,
                       .state = {"state"},
                       .prompt = "task"};
  const auto answer = Ask(*connection, Seen(224), {}, planes);
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(answer->actions(0, 6), 201);
  OpenpiDialect parts{.name = "parts",
                      .cameras = {"observation.images.image", "image2"},
                      .state = {"observation/joint_position", "observation/gripper_position"},
                      .state_sizes = {7}};
  const auto other = Ask(*connection, Seen(224), {}, parts);
  ASSERT_TRUE(other.ok()) << other.status();
  EXPECT_EQ(other->actions(1, 2), Seen(224).proprioception[2] + 1);
}

TEST_F(ServeLerobotWire, TurnsViews) {
  const PythonServer server(Command({"--turn", "rotate-180"}));
  const auto connection = server.Connect();
  const auto answer = Ask(*connection, Seen(224));
  ASSERT_TRUE(answer.ok()) << answer.status();
  // Red of the last pixel: byte 3 * 224 * 224 - 3 of the view.
  EXPECT_EQ(answer->actions(0, 5), 200 + (3 * 224 * 224 - 3) % 50);
}

TEST_F(ServeLerobotWire, SaysWhatDoesNotFit) {
  const PythonServer server(Command());
  const OpenpiDialect libero = *OpenpiDialectNamed("libero");
  struct Case {
    std::function<void(Observation&, OpenpiDialect&)> change;
    const char* words;
  };
  for (const Case& c : std::vector<Case>{
           {[](auto&, auto&d) { d.cameras[1] = "wrist"; },
            "observation/wrist_image: is not in the message, and the policy's camera image2 wants "
            "it. "
            "The message holds observation/image, wrist, observation/state, prompt."},
           {[](auto&, auto&d) { d.state = {"joints"}; },
            "observation/state: is not in the message, and the policy wants a state of 8 numbers"},
           {[](auto&, auto&d) { d.prompt = "words"; }, "prompt: is not in the message"},
           {[](auto&o, auto&) { o.proprioception.conservativeResize(7); },
            "observation/state: holds 7 numbers, the policy wants 8"},
           {[](auto&o, auto&) { o.proprioception[5] = NAN; },
            "observation/state: number 5 is not finite"},
           {[](auto&o, auto&) { o = Seen(64); },
            "observation/image: is 64 x 64, the policy was trained on 224 x 224"},
           {[](auto&o, auto&) { o = Seen(1281); }, "sides are 1 to 1280"},
           {[](auto&o, auto&) { o.instruction = "fail"; }, "KeyError: 'no such weight'"},
           {[](auto&o, auto&) { o.instruction = "nan"; },
            "RuntimeError: the policy's action 2, number 1, is nan"},
       }) {
    Observation observation = Seen(224);
    OpenpiDialect dialect = libero;
    c.change(observation, dialect);
    const auto connection = server.Connect();
    const absl::Status said = Ask(*connection, observation, {}, dialect).status();
    EXPECT_EQ(said.code(), absl::StatusCode::kInternal) << c.words;
    EXPECT_THAT(std::string(said.message()), HasSubstr(c.words));
  }
  EXPECT_THAT(server.Log(), HasSubstr("KeyError: 'no such weight'")) << "with its traceback";
}

TEST_F(ServeLerobotWire, StandsAgainstBadClients) {
  const PythonServer server(Command({"--max-message-mib", "2", "--max-connections", "4"}));
  const auto [output, code] = RunProgram(
      OpenpiVenv::Get().python,
      absl::StrCat(DEPLOY_TESTS "/serve_lerobot_driver.py attack ", server.port(), " ", kKey));
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("stood"));
}

TEST_F(ServeLerobotWire, GivesAPolicyOfSingleStepsToOneClient) {
  const PythonServer server(Command({"--every-step"}));
  const auto first = server.Connect();
  EXPECT_EQ(Ask(*first, Seen(224))->actions(0, 4), 1) << "a client begins an episode";
  OpenpiConnectionOptions options;
  options.socket.secrets.token = kKey;
  const absl::Status second =
      OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", server.port()), options).status();
  EXPECT_THAT(std::string(second.message()), HasSubstr("takes 1 client at a time"));
}

// A model server of vla-eval's own class, served by deploy/robostress_serve_vla_eval.py.
class ServeVlaEval : public ::testing::Test {
 protected:
  static const OpenpiVenv& Venv() {
    static const OpenpiVenv& venv =
        *new OpenpiVenv(OpenpiVenv::Make(VLA_EVAL_VENV, VLA_EVAL_REQUIREMENTS, "vla-eval"));
    return venv;
  }
  void SetUp() override {
    if (!Venv().failure.empty()) GTEST_SKIP() << Venv().failure;
  }
  static std::vector<std::string> Command(const std::vector<std::string>& options = {}) {
    std::vector<std::string> command{Venv().python,
                                     ROBOSTRESS_SOURCE "/deploy/robostress_serve_vla_eval.py",
                                     "--model-server", DEPLOY_TESTS "/vla_eval_toy.py:Toy"};
    command.insert(command.end(), options.begin(), options.end());
    return command;
  }
};

TEST_F(ServeVlaEval, AnswersTheChunkThatVlaEvalHandsOutRowByRow) {
  const auto [output, code] = RunProgram(Venv().python, DEPLOY_TESTS "/vla_eval_toy.py");
  ASSERT_EQ(code, 0) << output;
  const PythonServer server(Command());
  const auto connection = server.Connect();
  EXPECT_EQ(Declared(*connection, "action_horizon"), 4);
  EXPECT_EQ(Declared(*connection, "state_dim"), 8);
  const auto answer = Ask(*connection, Seen(64));
  ASSERT_TRUE(answer.ok()) << answer.status();
  ASSERT_EQ(answer->actions.rows(), 4);
  const std::vector<std::string> lines = absl::StrSplit(output, '\n', absl::SkipEmpty());
  ASSERT_EQ(lines.size(), 4u) << output;
  for (int row = 0; row < 4; ++row) {
    const std::vector<std::string> numbers = absl::StrSplit(lines[row], ' ');
    ASSERT_EQ(numbers.size(), 7u) << output;
    for (int column = 0; column < 7; ++column) {
      float number = NAN;
      EXPECT_TRUE(absl::SimpleAtof(numbers[column], &number));
      // The state's last bit: Eigen and NumPy divide a range in different orders.
      EXPECT_NEAR(answer->actions(row, column), number, 1e-5) << row << ", " << column;
    }
  }
}

TEST_F(ServeVlaEval, BeginsAnEpisodeForEachClient) {
  const PythonServer server(Command());
  const auto first = server.Connect(), second = server.Connect();
  const auto step = [](OpenpiConnection& connection, const Extras& extras = {}) {
    const auto answer = Ask(connection, Seen(64), extras);
    EXPECT_TRUE(answer.ok()) << answer.status();
    return answer.ok() ? answer->actions(0, 5) : -1;
  };
  EXPECT_EQ(step(*first), 0);
  EXPECT_EQ(step(*first), 4) << "a chunk of four was handed out";
  EXPECT_EQ(step(*second), 0);
  EXPECT_EQ(step(*first, {{"reset", OpenpiWriter().Boolean(true).Take()}}), 0);
  EXPECT_EQ(step(*second), 4);
}

TEST_F(ServeVlaEval, OffersASeedWhereThePolicyObeysIt) {
  {
    const PythonServer server(Command({"--arg", "noise=numpy", "--binary-gripper"}));
    const auto connection = server.Connect();
    const auto once = Ask(*connection, Seen(64), Seed(5));
    ASSERT_TRUE(once.ok()) << once.status();
    EXPECT_EQ(once->actions(0, 6), 1) << "the gripper, by its sign";
    const Eigen::MatrixXf free = Ask(*connection, Seen(64))->actions.leftCols(5);
    EXPECT_NE(Ask(*connection, Seen(64), Seed(6))->actions.leftCols(5), once->actions.leftCols(5));
    EXPECT_EQ(Ask(*connection, Seen(64), Seed(5))->actions.leftCols(5), once->actions.leftCols(5));
    EXPECT_NE(Ask(*connection, Seen(64))->actions.leftCols(5), free)
        << "a seed leaves the other noise alone";
  }
  const PythonServer server(Command({"--arg", "noise=own"}));
  const auto connection = server.Connect();
  EXPECT_TRUE(Ask(*connection, Seen(64)).ok());
  const absl::Status said = Ask(*connection, Seen(64), Seed(5)).status();
  EXPECT_THAT(std::string(said.message()),
              HasSubstr("seed: this policy draws its noise where a seed does not reach"));
}

TEST_F(ServeVlaEval, SaysWhatCannotBeServed) {
  const auto refusal = [](const std::string& options) {
    const auto [output, code] = RunProgram(
        Venv().python,
        absl::StrCat(ROBOSTRESS_SOURCE "/deploy/robostress_serve_vla_eval.py --port 0 ", options));
    EXPECT_EQ(code, 2) << output;
    return output;
  };
  const std::string toy = "--model-server " DEPLOY_TESTS "/vla_eval_toy.py:";
  EXPECT_THAT(refusal("--model-server nothing"),
              HasSubstr("must be MODULE:CLASS or FILE.py:CLASS"));
  EXPECT_THAT(refusal("--model-server no.module:Class"), HasSubstr("ModuleNotFoundError"));
  EXPECT_THAT(refusal(toy + "Nothing"), HasSubstr("AttributeError"));
  EXPECT_THAT(refusal(toy + "SIDE"), HasSubstr("is no PredictModelServer"));
  EXPECT_THAT(refusal(toy + "Toy --arg size=3"), HasSubstr("its arguments (--arg) do not fit"));
  EXPECT_THAT(refusal(toy + "Toy --camera wrist"), HasSubstr("each must be NAME=KEY"));
}

// Policies of LeRobot at toy size, random.
class ServeLerobotPolicy : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* python = std::getenv("ROBOSTRESS_LEROBOT_PYTHON");
    if (python == nullptr)
      GTEST_SKIP() << "ROBOSTRESS_LEROBOT_PYTHON names no Python with lerobot, websockets and "
                      "msgpack; its PyTorch takes gigabytes, so no test fetches it";
    python_ = python;
  }
  // A folder with the policy.
  std::string Make(const std::string& kind) {
    const std::string folder = absl::StrCat(::testing::TempDir(), "lerobot-", getpid(), "-", kind);
    const auto [output, code] =
        RunProgram(python_, absl::StrCat(DEPLOY_TESTS "/lerobot_toys.py make ", kind, " ", folder));
    EXPECT_EQ(code, 0) << output;
    return folder;
  }
  // Six rows of seven: what LeRobot does with seed 1.
  Eigen::MatrixXf ByLerobot(const std::string& folder) {
    const auto [output, code] =
        RunProgram(python_, absl::StrCat(DEPLOY_TESTS "/lerobot_toys.py ask ", folder, " 1"));
    EXPECT_EQ(code, 0) << output;
    const std::vector<std::string> lines = absl::StrSplit(output, '\n', absl::SkipEmpty());
    const std::vector<std::string> numbers = absl::StrSplit(lines.back(), ' ');
    Eigen::Matrix<float, 6, 7, Eigen::RowMajor> rows = rows.Constant(NAN);
    EXPECT_EQ(numbers.size(), 42u) << output;
    for (size_t i = 0; i < numbers.size() && i < 42; ++i)
      EXPECT_TRUE(absl::SimpleAtof(numbers[i], rows.data() + i)) << output;
    return rows;
  }
  std::vector<std::string> Command(const std::string& folder,
                                   const std::vector<std::string>& options = {}) {
    std::vector<std::string> command{
        python_,    std::string(ROBOSTRESS_SOURCE) + "/deploy/robostress_serve_lerobot.py",
        "--policy", folder,
        "--device", "cpu"};
    command.insert(command.end(), options.begin(), options.end());
    return command;
  }
  // What the program says where it does not start.
  std::string Refusal(const std::string& folder, const std::string& options) {
    const auto [output, code] = RunProgram(
        python_, absl::StrCat(ROBOSTRESS_SOURCE "/deploy/robostress_serve_lerobot.py --policy ",
                              folder, " --device cpu --port 0 ", options));
    EXPECT_EQ(code, 2) << output;
    return output;
  }

  std::string python_;
};

TEST_F(ServeLerobotPolicy, AnswersAsLerobotDoes) {
  const std::string folder = Make("act");
  const Eigen::MatrixXf expected = ByLerobot(folder);
  {
    const PythonServer server(Command(folder, {"--state-dim", "8"}));
    const auto connection = server.Connect();
    EXPECT_EQ(Declared(*connection, "action_horizon"), 6);
    EXPECT_EQ(Declared(*connection, "action_dim"), 7);
    EXPECT_EQ(Declared(*connection, "state_dim"), 8);
    EXPECT_EQ(Declared(*connection, "image_width"), 224);
    const auto answer = Ask(*connection, Seen(224), Seed(1));
    ASSERT_TRUE(answer.ok()) << answer.status();
    // The same operations in the same order; what is left is text of nine digits.
    EXPECT_LT((answer->actions - expected).cwiseAbs().maxCoeff(), 1e-5) << answer->actions;
    const auto digest =
        OpenpiText("sha256", *connection->metadata().Find("model")->Find("sha256"), 64);
    EXPECT_EQ(digest->size(), 64u);
    if (OpenpiVenv::Get().failure.empty()) {  // openpi's own client
      const auto [output, code] = RunProgram(
          OpenpiVenv::Get().python,
          absl::StrCat(DEPLOY_TESTS "/serve_lerobot_driver.py ask ", server.port(), " ", kKey));
      EXPECT_EQ(code, 0) << output;
      EXPECT_THAT(output, HasSubstr("served 5 chunks of (6, 7)"));
      std::cout << output;
    }
  }
  {
    const PythonServer server(Command(folder, {"--every-step"}));
    const auto connection = server.Connect();
    for (int row = 0; row < 6; ++row) {
      const auto answer = Ask(*connection, Seen(224));
      ASSERT_TRUE(answer.ok()) << answer.status();
      ASSERT_EQ(answer->actions.rows(), 1);
      EXPECT_LT((answer->actions - expected.row(row)).cwiseAbs().maxCoeff(), 1e-5) << row;
    }
  }
  {
    const PythonServer server(Command(folder, {"--action-chunk", "2", "--resize", "stretch"}));
    const auto connection = server.Connect();
    const auto answer = Ask(*connection, Seen(64));
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->actions.rows(), 2);
    EXPECT_GT((answer->actions - expected.topRows(2)).cwiseAbs().maxCoeff(), 1e-5)
        << "another picture, other actions";
  }
  EXPECT_THAT(Refusal(folder, "--state-dim 7"),
              HasSubstr("--state-dim 7: the policy's observation.state has 8 numbers"));
  EXPECT_THAT(Refusal(folder, "--camera-map agentview=front"),
              HasSubstr("--camera-map agentview=front: must be KEY=CAMERA, with a camera of the "
                        "policy: image, image2"));
  EXPECT_THAT(Refusal(folder, "--action-chunk 7"),
              HasSubstr("--action-chunk 7: the policy's chunk has 6 rows"));
  EXPECT_THAT(Refusal(folder + "/nothing", ""),
              HasSubstr("nothing: is neither a folder nor a name of the hub"));
  std::filesystem::resize_file(folder + "/model.safetensors", 100);
  EXPECT_THAT(Refusal(folder, ""), HasSubstr("cannot load this act: SafetensorError"));
  std::filesystem::remove(folder + "/model.safetensors");
  EXPECT_THAT(Refusal(folder, ""), HasSubstr("holds no weights (model.safetensors)"));
  std::filesystem::remove_all(folder);
}

TEST_F(ServeLerobotPolicy, ServesAHistoryStepByStep) {
  if (RunProgram(python_, "-c 'import diffusers'").second != 0)
    GTEST_SKIP() << "this LeRobot has no diffusers, which its diffusion policy needs";
  const std::string folder = Make("diffusion");
  const Eigen::MatrixXf expected = ByLerobot(folder);
  EXPECT_THAT(Refusal(folder, ""), HasSubstr("diffusion looks at 2 observations of consecutive"));
  const PythonServer server(Command(folder, {"--every-step"}));
  const auto connection = server.Connect();
  for (int row = 0; row < 6; ++row) {  // noise is drawn when the policy plans, at the first
    const auto answer = Ask(*connection, Seen(64), row == 0 ? Seed(1) : Extras());
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_LT((answer->actions - expected.row(row)).cwiseAbs().maxCoeff(), 1e-4) << row;
  }
  std::filesystem::remove_all(folder);
}

TEST_F(ServeLerobotPolicy, PairsSamplingNoiseBySeed) {
  if (RunProgram(python_, "-c 'import transformers'").second != 0)
    GTEST_SKIP() << "this LeRobot has no transformers, which SmolVLA needs";
  const std::string folder = Make("smolvla");
  const Eigen::MatrixXf expected = ByLerobot(folder);
  const PythonServer server(Command(folder));
  const auto connection = server.Connect(), other = server.Connect();
  const auto once = Ask(*connection, Seen(64), Seed(1));
  ASSERT_TRUE(once.ok()) << once.status();
  EXPECT_LT((once->actions - expected).cwiseAbs().maxCoeff(), 1e-4) << "LeRobot's own, seeded";
  const Eigen::MatrixXf free = Ask(*connection, Seen(64))->actions;
  EXPECT_NE(Ask(*connection, Seen(64), Seed(2))->actions, once->actions);
  EXPECT_EQ(Ask(*other, Seen(64), Seed(1))->actions, once->actions) << "whoever asks, and when";
  EXPECT_NE(Ask(*connection, Seen(64))->actions, free) << "a seed leaves the other noise alone";
  Observation instructed = Seen(64);
  instructed.instruction = "do something else";
  EXPECT_NE(Ask(*connection, instructed, Seed(1))->actions, once->actions) << "it reads";
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace robostress
