#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cmath>
#include <csignal>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "sim_worker/worker/sim_unit.h"
#include "tests/common/rollout/fake_robot.h"
#include "tests/common/rpc/fake_policy_server.h"

namespace robostress {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

// Moves 1 along x.
class FakeExpert : public PolicyEndpoint {
 public:
  FakeExpert() {
    spec_.name = "expert";
    spec_.state_dim = 2;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk prediction;
    prediction.actions = Eigen::MatrixXf::Constant(50, 7, 0.5f);
    prediction.policy_actions = prediction.actions;
    return prediction;
  }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats{}; }

 private:
  PolicySpec spec_;
};

FakeServerOptions ServerOptions() {
  FakeServerOptions options{.spec = FakeSpec()};
  options.spec.action_dim = 7;
  return options;
}

struct UnitRunnerTest : public testing::Test {
  UnitRunnerTest() {
    const testing::TestInfo* info = testing::UnitTest::GetInstance()->current_test_info();
    root =
        (fs::path(testing::TempDir()) / absl::StrCat("unit_runner_", info->name(), "_", getpid()))
            .string();
    fs::remove_all(root);
    unit.policy = "fake";
    unit.tasks = {0, 3};
    unit.episodes = 3;
    unit.method = *MakeMethod("ours", {"learning_rate=0.01"});
  }
  ~UnitRunnerTest() override { fs::remove_all(root); }

  std::string Dir(const std::string& name) const { return absl::StrCat(root, "/", name); }

  // steps_before_failure < 0: the robot never fails.
  absl::Status Run(const std::string& name, int steps_before_failure = -1) {
    SimUnitOptions options;
    options.run.out = Dir(name);
    options.server = server == nullptr ? "" : server->address();
    options.connect_timeout_s = 60;
    options.measure_lag = measure_lag;
    options.record_views = record_views;
    options.run.episodes = range;
    options.run.progress = [this](std::string_view line) { lines.emplace_back(line); };
    return RunSimUnit(
        unit, options, [&](const UnitConfig& made, int task) -> absl::StatusOr<UnitTask> {
          auto robot = std::make_shared<FakeRobot>(0.012 + 0.004 * task, 15);
          if (made.scenario != "clean") robot->follow = 0.2;
          robot->steps_to_failure = steps_before_failure;
          robots.push_back(robot);
          UnitTask out;
          out.robot = robot;
          out.make_expert = []() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
            return std::make_unique<FakeExpert>();
          };
          out.name = absl::StrCat("task ", task);
          out.problem = "libero_tabletop_manipulation";
          out.mjcf = [robot] { return absl::StrCat("<mujoco/> ", robot->commands.size()); };
          out.moment = [robot](int side) -> absl::StatusOr<RecordedMoment> {
            RecordedMoment moment;
            RS_ASSIGN_OR_RETURN(moment.observation, robot->Observe({}));
            moment.observation.proprioception.conservativeResizeLike(Eigen::VectorXf::Zero(8));
            moment.observation.views = {
                {"agentview", {side, side, std::vector<uint8_t>(size_t{3} * side * side)}}};
            moment.simulator = {};
            moment.simulator.state = {static_cast<double>(robot->commands.size())};
            return moment;
          };
          out.film = [this](int height) -> absl::StatusOr<Image> {
            ++frames;
            return Image{
                2 * height, height,
                std::vector<uint8_t>(size_t{6} * height * height, static_cast<uint8_t>(frames))};
          };
          return out;
        });
  }
  std::string Read(const std::string& name, const char* file) const {
    const absl::StatusOr<std::string> text = ReadFile(absl::StrCat(Dir(name), "/", file));
    EXPECT_TRUE(text.ok()) << text.status();
    return text.ok() ? *text : "";
  }
  std::vector<json> Rows(const std::string& name, const char* file = "episodes.jsonl") const {
    std::vector<json> rows;
    for (const absl::string_view line : absl::StrSplit(Read(name, file), '\n', absl::SkipEmpty())) {
      rows.push_back(json::parse(line));
    }
    return rows;
  }
  bool Has(const std::string& name, const char* file) const {
    return fs::exists(absl::StrCat(Dir(name), "/", file));
  }

  UnitConfig unit;
  std::string root;
  std::unique_ptr<FakePolicyServer> server = std::make_unique<FakePolicyServer>(ServerOptions());
  std::vector<std::shared_ptr<FakeRobot>> robots;
  std::vector<std::string> lines;
  int frames = 0;
  bool measure_lag = false;
  int record_views = 0;
  std::string range;
};

TEST_F(UnitRunnerTest, RangesOfAMethodWithoutAdaptationAreTheRowsOfTheWholeUnit) {
  for (const char* method : {"base", "gain", "null", "direct"}) {
    unit.method = *MakeMethod(method);
    range = "";
    const std::string name = method;
    ASSERT_TRUE(Run(name).ok());
    std::string rows;
    for (const char* part : {"0-1", "2-4", "5-5"}) {
      range = part;
      ASSERT_TRUE(Run(absl::StrCat(name, part)).ok());
      rows += Read(absl::StrCat(name, part), "episodes.jsonl");
      EXPECT_TRUE(Has(absl::StrCat(name, part), "DONE"));
    }
    EXPECT_EQ(rows, Read(name, "episodes.jsonl")) << method;
  }
  unit.method = *MakeMethod("base");
  range = "0-1";
  EXPECT_EQ(Run("base2-4").code(), absl::StatusCode::kDataLoss) << "a folder of another range";
}

TEST_F(UnitRunnerTest, WritesOneRowPerEpisodeAndDoneLast) {
  ASSERT_TRUE(Run("a").ok());
  const std::vector<json> rows = Rows("a");
  ASSERT_EQ(rows.size(), 6u);
  EXPECT_EQ(rows[4]["task"], 3);
  EXPECT_EQ(rows[4]["episode"], 1);
  EXPECT_EQ(rows[4]["method"], "ours");
  for (const char* key : {"success", "steps", "chunks", "updates", "residual", "eta_sq", "a_sq",
                          "intent", "intent_eta_sq", "intent_a_sq", "residual_tracking",
                          "mean_abs_action", "clipped_share", "adapter_distance"}) {
    EXPECT_TRUE(rows[0].contains(key)) << key;
  }
  EXPECT_GT(rows[5]["updates"], 0);
  EXPECT_FALSE(rows[0].contains("wall_s")) << "timings are kept apart";
  EXPECT_EQ(Rows("a", "timing.jsonl").size(), 6u);
  EXPECT_TRUE(Has("a", "DONE"));
  EXPECT_TRUE(Has("a", "adapter.safetensors"));
  EXPECT_FALSE(Has("a", "adapter_state.safetensors"));
  EXPECT_EQ(server->open_sessions(), 0);
  EXPECT_EQ(lines.size(), 6u);
}

TEST_F(UnitRunnerTest, ResidualOfARobotThatFollowsThirtyPercentIsSeventyPercent) {
  ASSERT_TRUE(Run("a").ok());
  for (const json& row : Rows("a")) {
    // The point follows 0.3 of the translation and none of the rotation.
    EXPECT_GT(row["residual"], 0.7);
    EXPECT_LT(row["residual"], 1.0);
    for (const auto& [ratio, above, below] :
         {std::tuple{"residual", "eta_sq", "a_sq"},
          std::tuple{"residual_tracking", "tracking_eta_sq", "a_sq"},
          std::tuple{"intent", "intent_eta_sq", "intent_a_sq"},
          std::tuple{"intent_tracking", "intent_tracking_eta_sq", "intent_a_sq"}}) {
      const double squared = row[above].get<double>() / row[below].get<double>();
      EXPECT_NEAR(row[ratio].get<double>(), std::sqrt(squared), 1e-9) << ratio;
    }
  }
}

TEST_F(UnitRunnerTest, LagIsWhatTheSameCommandsLeaveWithoutErrors) {
  unit.policy = "expert";  // 0.5 in every entry
  unit.method = *MakeMethod("base");
  unit.scenario = "heavy_payload";
  ASSERT_TRUE(Run("plain").ok());
  measure_lag = true;
  ASSERT_TRUE(Run("lag").ok());
  std::vector<json> plain = Rows("plain"), lag = Rows("lag");
  for (size_t i = 0; i < lag.size(); ++i) {
    // Follows 0.2 of the translation with errors, 0.3 without, and none of the rotation.
    EXPECT_NEAR(lag[i]["residual"], std::sqrt((0.8 * 0.8 + 1) / 2), 1e-6);
    EXPECT_NEAR(lag[i]["lag_residual"], std::sqrt((0.7 * 0.7 + 1) / 2), 1e-6);
    EXPECT_NEAR(lag[i]["lag_eta_sq"].get<double>() / lag[i]["a_sq"].get<double>(),
                (0.7 * 0.7 + 1) / 2, 1e-6);
    EXPECT_FALSE(plain[i].contains("lag_residual"));
    lag[i].erase("lag_residual");
    lag[i].erase("lag_eta_sq");
    EXPECT_EQ(lag[i], plain[i]) << "measuring the lag changes nothing else";
  }
}

TEST_F(UnitRunnerTest, AnswersThatAreLateStandInTheUnitAndItsRows) {
  unit.policy = "expert";
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("now").ok());
  EXPECT_EQ(Read("now", "config.yaml").find("latency"), std::string::npos);
  EXPECT_FALSE(Rows("now")[0].contains("jerk"));
  unit.latency.ms = 120;  // three control steps
  unit.latency.mode = LateChunks::kWaiting;
  EXPECT_EQ(Run("now").code(), absl::StatusCode::kFailedPrecondition) << "another unit";
  ASSERT_TRUE(Run("late").ok());
  EXPECT_NE(Read("late", "config.yaml").find("latency:\n  ms: 120\n  mode: waiting"),
            std::string::npos)
      << Read("late", "config.yaml");
  const std::vector<json> now = Rows("now"), late = Rows("late");
  for (size_t i = 0; i < now.size(); ++i) {
    EXPECT_EQ(late[i]["steps"].get<int>(), now[i]["steps"].get<int>() + 3) << "one answer's hold";
    EXPECT_TRUE(late[i].contains("jerk") && late[i].contains("jump"));
    EXPECT_EQ(late[i]["residual"], now[i]["residual"]) << "of the steps that it commanded";
  }
  measure_lag = true;
  EXPECT_EQ(Run("lag").code(), absl::StatusCode::kInvalidArgument);
}

TEST_F(UnitRunnerTest, FinishedUnitReturnsAtOnce) {
  ASSERT_TRUE(Run("a").ok());
  const int predictions = server->predictions();
  server.reset();
  unit.method.Edit().method = "ours";
  lines.clear();
  SimUnitOptions options;
  options.run.out = Dir("a");
  options.server = "127.0.0.1:1";  // nobody is asked
  options.run.progress = [this](std::string_view line) { lines.emplace_back(line); };
  const absl::Status status =
      RunSimUnit(unit, options, [](const UnitConfig&, int) -> absl::StatusOr<UnitTask> {
        return absl::InternalError("no task may be made");
      });
  EXPECT_TRUE(status.ok()) << status;
  ASSERT_EQ(lines.size(), 1u);
  EXPECT_THAT(lines[0], HasSubstr("already complete: 6 episodes"));
  EXPECT_GT(predictions, 0);
}

// Stops after every possible number of control steps and continues: nothing that is kept depends on
// where.
TEST_F(UnitRunnerTest, InterruptedUnitContinuesToTheSameBytes) {
  for (const char* method : {"ours", "base"}) {
    unit.method = *MakeMethodOf({"ours"}, method, {"learning_rate=0.01"});
    const std::string straight = absl::StrCat(method, "_straight");
    ASSERT_TRUE(Run(straight).ok());
    int interrupted = 0;
    for (int stop = 0; stop < 45; stop += 3) {
      const std::string name = absl::StrCat(method, "_", stop);
      if (Run(name, stop).ok()) continue;
      ++interrupted;
      EXPECT_FALSE(Has(name, "DONE"));
      const absl::Status status = Run(name);
      ASSERT_TRUE(status.ok()) << status;
      EXPECT_EQ(Read(name, "episodes.jsonl"), Read(straight, "episodes.jsonl"));
      EXPECT_EQ(Rows(name, "timing.jsonl").size(), 6u);
      EXPECT_EQ(Has(name, "adapter.safetensors"), method == std::string("ours"));
      if (method == std::string("ours")) {
        EXPECT_EQ(Read(name, "adapter.safetensors"), Read(straight, "adapter.safetensors"));
      }
    }
    EXPECT_GT(interrupted, 3);
  }
}

TEST_F(UnitRunnerTest, FinishedEpisodesAreNotRepeated) {
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("straight").ok());
  const int steps = static_cast<int>(robots[0]->commands.size() + robots[1]->commands.size());
  robots.clear();
  EXPECT_FALSE(Run("a", 20).ok());
  const size_t kept = Rows("a").size();
  ASSERT_GT(kept, 0u);
  robots.clear();
  ASSERT_TRUE(Run("a").ok());
  int repeated = 0;
  for (const auto& robot : robots) repeated += static_cast<int>(robot->commands.size());
  EXPECT_LT(repeated, steps);
}

TEST_F(UnitRunnerTest, StopBetweenStateAndRowLosesNothing) {
  ASSERT_TRUE(Run("straight").ok());
  EXPECT_FALSE(Run("a", 13).ok());
  const std::string rows = Read("a", "episodes.jsonl");
  ASSERT_FALSE(rows.empty());
  // As if the last row had not reached the disk.
  const size_t end = rows.rfind('\n', rows.size() - 2);
  ASSERT_TRUE(WriteFileAtomically(Dir("a") + "/episodes.jsonl",
                                  end == std::string::npos ? "" : rows.substr(0, end + 1))
                  .ok());
  ASSERT_TRUE(Run("a").ok());
  EXPECT_EQ(Read("a", "episodes.jsonl"), Read("straight", "episodes.jsonl"));
}

TEST_F(UnitRunnerTest, TornRowIsDroppedAndRunAgain) {
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("straight").ok());
  EXPECT_FALSE(Run("a", 20).ok());
  const std::string rows = Read("a", "episodes.jsonl");
  ASSERT_TRUE(WriteFileAtomically(Dir("a") + "/episodes.jsonl", rows + "{\"task\": 0, \"epi").ok());
  ASSERT_TRUE(Run("a").ok());
  EXPECT_EQ(Read("a", "episodes.jsonl"), Read("straight", "episodes.jsonl"));
}

TEST_F(UnitRunnerTest, LostDamagedOrForeignAdapterStateStartsOver) {
  ASSERT_TRUE(Run("straight").ok());
  for (const std::string damage : {"lost", "damaged", "foreign"}) {
    EXPECT_FALSE(Run(damage, 13).ok());
    ASSERT_FALSE(Rows(damage).empty());
    const std::string state = Dir(damage) + "/adapter_state.safetensors";
    if (damage == "lost") fs::remove(state);
    if (damage == "damaged") {
      const std::string half = Read(damage, "adapter_state.safetensors").substr(0, 50);
      ASSERT_TRUE(WriteFileAtomically(state, half).ok());
    }
    if (damage == "foreign") {
      std::string rows = Read(damage, "episodes.jsonl");
      const size_t steps = rows.find("\"steps\":");
      rows[steps + 8] = '9';
      ASSERT_TRUE(WriteFileAtomically(Dir(damage) + "/episodes.jsonl", rows).ok());
    }
    lines.clear();
    ASSERT_TRUE(Run(damage).ok());
    EXPECT_THAT(lines[0], HasSubstr("starting over"));
    EXPECT_EQ(Read(damage, "episodes.jsonl"), Read("straight", "episodes.jsonl")) << damage;
  }
}

TEST_F(UnitRunnerTest, RefusesADirectoryOfAnotherUnit) {
  ASSERT_TRUE(Run("a").ok());
  unit.seed = 8;
  const absl::Status status = Run("a");
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()),
              HasSubstr("belongs to another unit: it has 'seed: 0', asked for 'seed: 8'"));
  EXPECT_EQ(Rows("a").size(), 6u);
}

TEST_F(UnitRunnerTest, RefusesRowsThatChangedAfterDone) {
  ASSERT_TRUE(Run("a").ok());
  std::string rows = Read("a", "episodes.jsonl");
  rows[rows.find("\"steps\":") + 8] = '9';
  ASSERT_TRUE(WriteFileAtomically(Dir("a") + "/episodes.jsonl", rows).ok());
  EXPECT_THAT(std::string(Run("a").message()), HasSubstr("is not what DONE says"));
}

TEST_F(UnitRunnerTest, RefusesRecordsOfAnotherType) {
  ASSERT_TRUE(Run("a").ok());
  ASSERT_TRUE(WriteFileAtomically(Dir("a") + "/DONE", "{\"episodes_sha256\": 5}").ok());
  EXPECT_THAT(std::string(Run("a").message()), HasSubstr("is not what DONE says"));
  std::filesystem::remove(Dir("a") + "/DONE");
  for (const char* hash : {"null", "5"}) {
    ASSERT_TRUE(WriteFileAtomically(Dir("a") + "/provenance.json",
                                    absl::StrCat("{\"model_hash\": ", hash, "}"))
                    .ok());
    EXPECT_THAT(std::string(Run("a").message()), HasSubstr("was begun with weights"));
  }
}

TEST_F(UnitRunnerTest, RefusesToContinueWithOtherWeights) {
  EXPECT_FALSE(Run("a", 13).ok());
  FakeServerOptions other = ServerOptions();
  other.spec.model_hash = "ffff";
  server = std::make_unique<FakePolicyServer>(other);
  EXPECT_THAT(std::string(Run("a").message()),
              HasSubstr("was begun with weights 0123abcd, policy 'fake' now has ffff"));
}

TEST_F(UnitRunnerTest, OtherWeightsThanThoseOfAFinishedUnitAreRefusedBeforeAnythingIsPlayed) {
  ASSERT_TRUE(Run("units/a").ok());
  FakeServerOptions other = ServerOptions();
  other.spec.model_hash = "ffff";
  server = std::make_unique<FakePolicyServer>(other);
  EXPECT_THAT(std::string(Run("units/b").message()),
              HasSubstr("a was played with weights 0123abcd of policy 'fake', which now has ffff"));
  EXPECT_TRUE(Run("elsewhere/b").ok()) << "no run directory";
}

TEST_F(UnitRunnerTest, SecondWorkerOnTheSameDirectoryIsRefused) {
  absl::Status inner;
  SimUnitOptions options;
  options.run.out = Dir("a");
  options.server = server->address();
  const absl::Status outer =
      RunSimUnit(unit, options, [&](const UnitConfig&, int) -> absl::StatusOr<UnitTask> {
        inner = Run("a");
        return absl::InternalError("enough");
      });
  EXPECT_FALSE(outer.ok());
  EXPECT_EQ(inner.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(inner.message()), HasSubstr("another worker is writing"));
}

TEST_F(UnitRunnerTest, ExpertRunsWithoutAServerAndHasNoIntent) {
  server.reset();
  unit.policy = "expert";
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("a").ok());
  EXPECT_TRUE(Rows("a")[0]["intent"].is_null());
  EXPECT_TRUE(Rows("a")[0]["success"]);
  EXPECT_FALSE(Has("a", "adapter.safetensors"));
}

TEST_F(UnitRunnerTest, ReplayRunsWithoutAServer) {
  server.reset();
  SafetensorsWriter writer;
  writer.AddFloats("actions", {2, 7}, std::vector<float>(14, 1.0f));
  ASSERT_TRUE(MakeDirectories(root).ok());
  ASSERT_TRUE(writer.Write(Dir("actions.safetensors")).ok());
  unit.policy = "replay";
  unit.replay_file = Dir("actions.safetensors");
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("a").ok());
  EXPECT_EQ(Rows("a").size(), 6u);
  unit.replay_file = Dir("absent.safetensors");
  EXPECT_THAT(std::string(Run("b").message()), HasSubstr("absent.safetensors"));
}

TEST_F(UnitRunnerTest, RecordsWhatWasAskedForSentAndMeasured) {
  unit.method = *MakeMethod("gain", {"gain=1.5"});
  unit.tasks = {3};
  unit.episodes = 1;
  ASSERT_TRUE(Run("plain").ok());
  record_views = 24;
  ASSERT_TRUE(Run("recorded").ok());
  EXPECT_EQ(Read("plain", "episodes.jsonl"), Read("recorded", "episodes.jsonl"));
  EXPECT_FALSE(Has("plain", "episodes"));
  const auto read = ReadEpisodeRecording(Dir("recorded") + "/episodes/task3_episode0.safetensors");
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->task_name, "task 3");
  EXPECT_EQ(read->problem, "libero_tabletop_manipulation");
  EXPECT_EQ(read->model_file, absl::StrCat("<mujoco/> ", read->steps.size()))
      << "of the scene in this episode";
  EXPECT_EQ(read->method, "gain");
  EXPECT_EQ(read->instruction, "move along x");
  ASSERT_EQ(static_cast<int>(read->steps.size()), Rows("recorded")[0]["steps"].get<int>());
  const FakeRobot& robot = *robots.back();
  const auto image = DecodePng(read->pictures[0].back());
  ASSERT_TRUE(image.ok()) << image.status();
  EXPECT_EQ(image->width, 24);
  bool scaled = false;
  for (size_t i = 0; i < read->steps.size(); ++i) {
    const EpisodeRecording::Step& step = read->steps[i];
    EXPECT_EQ(step.sent, robot.commands[i]);
    scaled = scaled || step.sent != step.commanded;
    EXPECT_EQ(step.simulator.state[0], static_cast<double>(i)) << "before the step";
    EXPECT_NEAR(step.proprioception[0], step.before.tool.p_base_tool.x(), 1e-7);
    EXPECT_NEAR(step.measured[0], robot.follow * step.sent[0], 1e-6);
    EXPECT_EQ(step.measured[6], step.sent[6]);
  }
  EXPECT_TRUE(scaled);
}

TEST_F(UnitRunnerTest, FilmsTheFirstEpisodesOfEachTask) {
  unit.videos = 1;
  ASSERT_TRUE(Run("a").ok());
  const std::string video = Read("a", "videos/task3_episode0.webp");
  EXPECT_EQ(video.substr(0, 4), "RIFF");
  EXPECT_EQ(video.substr(8, 4), "WEBP");
  EXPECT_FALSE(Has("a", "videos/task3_episode1.webp"));
}

TEST_F(UnitRunnerTest, MissingServerIsNamedWithTheRemedy) {
  const std::string address = server->address();
  server.reset();
  EXPECT_THAT(std::string(Run("a").message()),
              HasSubstr("start one with `robostress serve --policy fake`"));
  EXPECT_FALSE(fs::exists(Dir("a"))) << "nothing is written before the server is known";
  SimUnitOptions options;
  options.run.out = Dir("b");
  options.server = address;
  options.connect_timeout_s = 0.2;
  const absl::Status status = RunSimUnit(unit, options, nullptr);
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr(address));
  EXPECT_FALSE(Has("b", "DONE"));
}

TEST_F(UnitRunnerTest, UnknownPolicyListsWhatTheServerHolds) {
  unit.policy = "pi9";
  const absl::Status status = Run("a");
  EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(status.message()), HasSubstr("known: fake"));
  unit.policy = "fake";
  EXPECT_TRUE(Run("a").ok()) << "nothing was begun under the wrong name";
}

TEST_F(UnitRunnerTest, PolicyWithoutActionExpertCannotBeAdapted) {
  FakeServerOptions rigid = ServerOptions();
  rigid.spec.adaptable = false;
  server = std::make_unique<FakePolicyServer>(rigid);
  EXPECT_THAT(std::string(Run("a").message()),
              HasSubstr("policy 'fake' cannot be adapted, method 'ours' needs that"));
}

TEST_F(UnitRunnerTest, DirectoryThatCannotBeMadeIsNamed) {
  ASSERT_TRUE(MakeDirectories(root).ok());
  ASSERT_TRUE(WriteFileAtomically(Dir("file"), "in the way").ok());
  const absl::Status status = Run("file/a");
  EXPECT_FALSE(status.ok());
  EXPECT_THAT(std::string(status.message()), HasSubstr("file/a"));
}

// A limit on the size of files stands for a full disk: writes fail half-way.
TEST_F(UnitRunnerTest, FullDiskStopsWithoutDoneAndTheSameCommandContinues) {
  unit.method = *MakeMethod("base");
  ASSERT_TRUE(Run("straight").ok());
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  rlimit full = before;
  full.rlim_cur = Read("straight", "episodes.jsonl").size() - 10;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &full), 0);
  const absl::Status status = Run("a");
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, handler);
  EXPECT_FALSE(status.ok());
  EXPECT_THAT(std::string(status.message()), HasSubstr("episodes.jsonl"));
  EXPECT_FALSE(Has("a", "DONE"));
  EXPECT_EQ(Rows("a").size(), 5u) << "no half row";
  ASSERT_TRUE(Run("a").ok());
  EXPECT_EQ(Read("a", "episodes.jsonl"), Read("straight", "episodes.jsonl"));
}

}  // namespace
}  // namespace robostress
