// The program itself, as a sweep or a person starts it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

struct Outcome {
  int code = -1;  // of exit, or -signal
  std::string output;
};

// Runs the worker and gathers stdout and stderr; kills it after `kill_after_lines` lines (0:
// never).
Outcome Worker(std::vector<std::string> arguments, int kill_after_lines = 0) {
  int ends[2];
  if (pipe(ends) != 0) return {};
  const pid_t child = fork();
  if (child == 0) {
    dup2(ends[1], 1);
    dup2(ends[1], 2);
    close(ends[0]);
    close(ends[1]);
    arguments.insert(arguments.begin(), ROBOSTRESS_WORKER);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    execv(argv[0], argv.data());
    _exit(127);
  }
  close(ends[1]);
  Outcome outcome;
  int lines = 0;
  for (char byte; read(ends[0], &byte, 1) == 1;) {
    outcome.output.push_back(byte);
    if (byte == '\n' && ++lines == kill_after_lines) kill(child, SIGKILL);
  }
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  return outcome;
}

struct WorkerProgramTest : public testing::Test {
  WorkerProgramTest() {
    const testing::TestInfo* info = testing::UnitTest::GetInstance()->current_test_info();
    root = (fs::path(testing::TempDir()) / absl::StrCat("worker_", info->name(), "_", getpid()))
               .string();
    fs::create_directories(root);
  }
  ~WorkerProgramTest() override { fs::remove_all(root); }
  std::string Path(const std::string& name) const { return absl::StrCat(root, "/", name); }
  // Unit of the scripted expert, which needs no server and no weights.
  std::string WriteUnit(const std::string& more = "") const {
    const std::string file = Path("unit.yaml");
    EXPECT_TRUE(
        WriteFileAtomically(
            file,
            absl::StrCat("suite: tabletop_goal\npolicy: expert\nscenario: thermal_drift_stribeck\n"
                         "tasks: [0, 1]\nepisodes: 6\n",
                         more))
            .ok());
    return file;
  }
  std::string root;
};

TEST_F(WorkerProgramTest, HelpShowsExamples) {
  const Outcome help = Worker({"--help"});
  EXPECT_EQ(help.code, 0);
  EXPECT_THAT(help.output, HasSubstr("Examples:"));
}

TEST_F(WorkerProgramTest, BadInputExitsWithTwoAndLeavesNothing) {
  const std::string out = Path("out");
  const std::pair<std::vector<std::string>, const char*> cases[] = {
      {{}, "--out is required"},
      {{"--out", out, "--colour"}, "--colour"},
      {{"--out", out, "--unit", Path("absent.yaml")}, "absent.yaml"},
      {{"--out", out, "--unit", WriteUnit("sead: 3\n")}, "unknown key 'sead'"},
      {{"--out", out, "--set", "suite=tabletop_gaol"}, "unknown suite 'tabletop_gaol'"},
      {{"--out", out, "--set", "policy=nano"}, "robostress serve --policy nano"},
      {{"--out", out, "--set", "seed"}, "must have the form key.key=value"},
  };
  for (const auto& [arguments, message] : cases) {
    const Outcome outcome = Worker(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(message));
    EXPECT_FALSE(fs::exists(out)) << message;
  }
}

TEST_F(WorkerProgramTest, MissingServerExitsWithOne) {
  const Outcome outcome = Worker({"--out", Path("out"), "--set", "policy=nano", "--server",
                                  "127.0.0.1:1", "--connect-timeout", "0.2"});
  EXPECT_EQ(outcome.code, 1);
  EXPECT_THAT(outcome.output, HasSubstr("no policy server answers at 127.0.0.1:1"));
}

TEST_F(WorkerProgramTest, KilledExpertUnitContinuesToTheSameBytes) {
  const std::string unit = WriteUnit();
  const Outcome straight = Worker({"--unit", unit, "--out", Path("straight")});
  ASSERT_EQ(straight.code, 0) << straight.output;
  EXPECT_TRUE(fs::exists(Path("straight/DONE")));
  const Outcome killed = Worker({"--unit", unit, "--out", Path("killed")}, /*kill_after_lines=*/2);
  EXPECT_EQ(killed.code, -SIGKILL) << killed.output;
  EXPECT_FALSE(fs::exists(Path("killed/DONE")));
  const Outcome resumed = Worker({"--unit", unit, "--out", Path("killed")});
  ASSERT_EQ(resumed.code, 0) << resumed.output;
  EXPECT_THAT(resumed.output, HasSubstr("continuing after"));
  EXPECT_EQ(*ReadFile(Path("killed/episodes.jsonl")), *ReadFile(Path("straight/episodes.jsonl")));
  EXPECT_THAT(Worker({"--unit", unit, "--out", Path("killed")}).output,
              HasSubstr("already complete"));
}

// The replay is exact: without errors to take away, it leaves what the episode left.
TEST_F(WorkerProgramTest, LagOfACleanEpisodeIsItsResidual) {
  const std::string unit = WriteUnit();
  for (const std::string scenario : {"clean", "aged_transmission"}) {
    for (const char* reference : {"achieved", "desired"}) {
      const std::string out = Path(absl::StrCat(scenario, reference));
      const Outcome outcome =
          Worker({"--unit", unit, "--set", "tasks=[0]", "--set", "episodes=1", "--set",
                  "scenario=" + scenario, "--set", absl::StrCat("sim.goal_reference=", reference),
                  "--lag", "--out", out});
      ASSERT_EQ(outcome.code, 0) << outcome.output;
      const nlohmann::json row = nlohmann::json::parse(*ReadFile(out + "/episodes.jsonl"));
      EXPECT_GT(row["lag_residual"], 0);
      if (scenario == "clean") {
        EXPECT_EQ(row["lag_eta_sq"], row["eta_sq"]) << reference;
      } else {
        EXPECT_NE(row["lag_eta_sq"], row["eta_sq"]) << reference;
      }
    }
  }
}

// Rows of the version before scenario files could list effects (2026-11-21, MuJoCo 2.2.2, x86-64).
TEST_F(WorkerProgramTest,
       ScenariosWithoutEffectsPlayAsBeforeThereWereAnyAlsoWhenJointsAreRecorded) {
  const std::pair<std::string, const char*> kRows[] = {
      {"nominal", "a6e17e517c1314cc39d68fb3e72ac5c7e91e3a9acc8f21fc36839f149b3491fb"},
      {"aged_joint_uniform", "45b7cbd7c62c64384b1a80aafeb3bee603986bb25884726b7c604ca0128c45df"}};
  for (const auto& [scenario, hash] : kRows) {
    const std::string out = Path(scenario);
    const Outcome outcome = Worker({"--set", "suite=tabletop_goal", "--set", "policy=expert",
                                    "--set", "tasks=[1]", "--set", "episodes=2", "--set",
                                    "scenario=" + scenario, "--out", out, "--record-joints"});
    ASSERT_EQ(outcome.code, 0) << outcome.output;
    EXPECT_EQ(Sha256Hex(*ReadFile(out + "/episodes.jsonl")), hash) << scenario;
    EXPECT_TRUE(fs::exists(out + "/joints/task1_episode1.safetensors"));
  }
}

TEST_F(WorkerProgramTest, PlaysAScenarioFileAndCallsItByItsName) {
  const std::string file = Path("stiff_wrist.yaml");
  ASSERT_TRUE(
      WriteFileAtomically(file, "joints: [{name: J6, effects: [{type: deadzone, width: 0.5}]}]\n")
          .ok());
  const std::string unit = WriteUnit();
  const auto row = [&](const std::string& scenario, const std::string& out) {
    const Outcome outcome = Worker({"--unit", unit, "--set", "tasks=[0]", "--set", "episodes=1",
                                    "--set", "scenario=" + scenario, "--out", out});
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    return nlohmann::json::parse(*ReadFile(out + "/episodes.jsonl"));
  };
  const nlohmann::json worn = row(file, Path("worn")), clean = row("clean", Path("clean"));
  EXPECT_EQ(worn["scenario"], "stiff_wrist");
  EXPECT_NE(worn["residual"], clean["residual"]);
  const Outcome absent =
      Worker({"--unit", unit, "--set", "scenario=" + Path("absent.yaml"), "--out", Path("out")});
  EXPECT_EQ(absent.code, 2);
  EXPECT_THAT(absent.output, HasSubstr("absent.yaml"));
}

TEST_F(WorkerProgramTest, FilmsAnEmbeddedSceneWithoutADisplay) {
  const Outcome outcome = Worker({"--unit", WriteUnit(), "--set", "tasks=[0]", "--set",
                                  "episodes=1", "--set", "videos=1", "--out", Path("out")});
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_GT(fs::file_size(Path("out/videos/task0_episode0.webp")), 5000u);
}

}  // namespace
}  // namespace robostress
