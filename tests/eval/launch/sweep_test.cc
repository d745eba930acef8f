// The sweep through its program, with stand-ins for worker and server.

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "eval/launch/progress.h"
#include "eval/plan/titles.h"
#include "eval/store/run_directory.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class SweepProgram : public ::testing::Test {
 protected:
  void SetUp() override { folder_ = TestFolder(); }

  // Runs the sweep with stand-ins; returns its exit code, output in output().
  int Sweep(const std::string& arguments, const std::string& environment = "") {
    output_file_ = folder_ + "/output.txt";
    const std::string command =
        absl::StrCat("ROBOSTRESS_BIN='", FAKE_PROGRAMS, "' ", environment, " '", BIN_DIR,
                     "/robostress-sweep' ", arguments, " > '", output_file_, "' 2>&1");
    const int status = std::system(command.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string output() const { return *ReadFile(output_file_); }
  std::string Small(const std::string& name) const {
    return absl::StrCat(
        "--suites tabletop_goal --tasks 2 --episodes 3 --scenarios clean,heavy_payload --methods "
        "base,ours --out '",
        folder_, "/", name, "' ");
  }
  int Starts(const std::string& name, const std::string& unit) const {
    return CountLines(absl::StrCat(folder_, "/", name, "/units/", unit, "/starts.txt"));
  }

  std::string folder_, output_file_;
};

TEST_F(SweepProgram, EpisodeTableIsByteEqualForOneAndTwoWorkers) {
  ASSERT_EQ(Sweep(Small("one") + "--workers 1"), 0) << output();
  ASSERT_EQ(Sweep(Small("two") + "--workers 2"), 0) << output();
  const std::string one = *ReadFile(folder_ + "/one/episodes.csv");
  EXPECT_EQ(one, *ReadFile(folder_ + "/two/episodes.csv"));
  EXPECT_EQ(std::count(one.begin(), one.end(), '\n'), 1 + 4 * 6);
  EXPECT_THAT(one, ::testing::Not(HasSubstr("wall_s")));
  EXPECT_EQ(*ReadFile(folder_ + "/one/table.csv"), *ReadFile(folder_ + "/two/table.csv"));
}

TEST_F(SweepProgram, SecondRunRepeatsNothing) {
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  const std::string table = *ReadFile(folder_ + "/run/episodes.csv");
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  EXPECT_THAT(output(), HasSubstr("4 of 4 units were already done"));
  EXPECT_EQ(Starts("run", "tabletop_goal-clean-L5-nano-base-s0"), 1);
  EXPECT_EQ(*ReadFile(folder_ + "/run/episodes.csv"), table);
}

TEST_F(SweepProgram, AnotherRobotsUnitsAreRunByItsProgramInTheSameEngine) {
  const std::string grid = folder_ + "/piper.yaml";
  ASSERT_TRUE(WriteFileAtomically(grid,
                                  "robot: piper\nsuites: [piper_3_on_box, piper_4_open_drawer]\n"
                                  "methods: [base, dob, ours]\nepisodes: 4\n")
                  .ok());
  const std::string command =
      absl::StrCat("--grid '", grid, "' --split-episodes 2 --out '", folder_, "/run'");
  ASSERT_EQ(Sweep(command), 0) << output();
  EXPECT_THAT(output(), HasSubstr("Robot B, used for a year"));
  EXPECT_THAT(output(), HasSubstr("dob - base"));
  const std::string id = "piper_4_open_drawer-used_one_year-L5-nano-piper-base-s0";
  EXPECT_THAT(*ReadFile(absl::StrCat(folder_, "/run/units/", id, "/starts.txt")),
              ::testing::EndsWith("/robostress-piper-worker\n"));
  EXPECT_EQ(Starts("run", id), 1) << "its episodes depend on each other: it is not divided";
  const std::string table = *ReadFile(folder_ + "/run/episodes.csv");
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 1 + 2 * 2 * 3 * 4);
  std::filesystem::remove(absl::StrCat(folder_, "/run/units/", id, "/DONE"));
  ASSERT_EQ(Sweep(command), 0) << output();
  EXPECT_THAT(output(), HasSubstr("11 of 12 units were already done"));
  EXPECT_EQ(*ReadFile(folder_ + "/run/episodes.csv"), table);
  EXPECT_EQ(Sweep(absl::StrCat(command, " --record-joints")), 2) << output();
  EXPECT_THAT(output(), HasSubstr("only the Panda's worker"));
}

TEST_F(SweepProgram, CompletesWhatIsMissing) {
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  const std::string table = *ReadFile(folder_ + "/run/episodes.csv");
  const std::string unit = folder_ + "/run/units/tabletop_goal-heavy_payload-L5-nano-ours-s0";
  std::filesystem::remove(unit + "/DONE");
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  EXPECT_EQ(Starts("run", "tabletop_goal-heavy_payload-L5-nano-ours-s0"), 2);
  EXPECT_EQ(Starts("run", "tabletop_goal-heavy_payload-L5-nano-base-s0"), 1);
  EXPECT_EQ(*ReadFile(folder_ + "/run/episodes.csv"), table);
}

TEST_F(SweepProgram, FailedUnitIsReportedWithItsLogAndTheOthersGoOn) {
  EXPECT_EQ(Sweep(Small("run"), "FAKE_FAIL_SCENARIO=heavy_payload"), 1);
  EXPECT_THAT(output(), HasSubstr("exit code 3"));
  EXPECT_THAT(output(), HasSubstr("2/4 units (2 failed)  12/24 episodes"));
  EXPECT_THAT(output(), HasSubstr("no simulator for scenario heavy_payload"));
  EXPECT_THAT(output(), HasSubstr("FAILED tabletop_goal-heavy_payload-L5-nano-ours-s0"));
  const std::string table = *ReadFile(folder_ + "/run/episodes.csv");
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 1 + 2 * 6);
  // The same command completes the run once the cause is gone.
  EXPECT_EQ(Sweep(Small("run")), 0) << output();
  EXPECT_EQ(Starts("run", "tabletop_goal-clean-L5-nano-base-s0"), 1);
}

// What memory running out does. One that is killed once: PolicyPeers.
TEST_F(SweepProgram, WorkerThatIsKilledAgainAndAgainFailsItsUnit) {
  EXPECT_EQ(Sweep(Small("run"), "FAKE_KILL_SCENARIO=heavy_payload"), 1);
  EXPECT_THAT(output(), HasSubstr("unit tabletop_goal-heavy_payload-L5-nano-ours-s0: its worker "
                                  "was killed by signal 9 (Killed); another one goes on"));
  EXPECT_THAT(output(), HasSubstr("nano-ours-s0 failed (killed by signal 9 (Killed))"));
  EXPECT_THAT(output(), HasSubstr("2/4 units (2 failed)  12/24 episodes"));
}

TEST_F(SweepProgram, ServerThatDoesNotStartIsReportedWithItsLog) {
  EXPECT_EQ(Sweep(Small("run"), "FAKE_SERVER_FAILS=1"), 1);
  EXPECT_THAT(output(), HasSubstr("weights not found"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run/report.html"));
}

TEST_F(SweepProgram, ServerThatDiesEndsTheSweepWithItsLog) {
  EXPECT_EQ(Sweep(Small("run"), "FAKE_SERVER_LIFETIME_MS=300 FAKE_EPISODE_MS=400"), 1);
  EXPECT_THAT(output(), HasSubstr("exit code 5"));
  EXPECT_THAT(output(), HasSubstr("out of memory"));
  // Nothing half-done looks whole, and the same command completes it.
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run/report.html"));
  EXPECT_EQ(Sweep(Small("run")), 0) << output();
}

TEST_F(SweepProgram, ExpertNeedsNoServer) {
  EXPECT_EQ(
      Sweep(absl::StrCat(
                "--policies expert --methods base --tasks 1 --episodes 2 --scenarios clean --out '",
                folder_, "/run'"),
            "FAKE_SERVER_FAILS=1"),
      0)
      << output();
}

TEST_F(SweepProgram, PolicyOfAServerElsewhereNeedsNoneHere) {
  const std::string pi0 =
      absl::StrCat("--policies pi0 --methods base --tasks 1 --episodes 2 --scenarios clean --out '",
                   folder_, "/run' ");
  EXPECT_EQ(Sweep(pi0), 2) << output();
  EXPECT_THAT(output(), HasSubstr("needs --server HOST:PORT"));
  EXPECT_EQ(Sweep(pi0 + "--server 10.0.0.7:50051", "FAKE_SERVER_FAILS=1"), 0) << output();
  EXPECT_EQ(*ReadFile(folder_ + "/run/units/tabletop_goal-clean-L5-pi0-base-s0/server.txt"),
            "10.0.0.7:50051\n");
}

TEST_F(SweepProgram, OtherConfigurationOfAStartedUnitIsRefused) {
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  const std::string table = *ReadFile(folder_ + "/run/episodes.csv");
  EXPECT_EQ(Sweep(Small("run") + "--set sim.goal_reference=desired"), 1);
  EXPECT_THAT(output(), HasSubstr("another configuration, and it has been started: "
                                  "sim.goal_reference is achieved in it, and desired in this "
                                  "command"));
  EXPECT_EQ(*ReadFile(folder_ + "/run/episodes.csv"), table);
}

// Base and a method with other simulators would be paired as the same episodes.
TEST_F(SweepProgram, AUnitThatWouldBePlayedUnlikeTheOthersIsRefused) {
  const std::string goal = "--tasks 1 --episodes 2 --scenarios heavy_payload ";
  const std::string run = absl::StrCat("--out '", folder_, "/run' "),
                    other = absl::StrCat("--out '", folder_, "/other' ");
  ASSERT_EQ(Sweep(goal + "--methods base " + run), 0) << output();
  const std::string gain = goal + "--methods gain --set sim.controller_kp=300 ";
  EXPECT_EQ(Sweep(gain + run), 1);
  EXPECT_THAT(output(), HasSubstr("suite tabletop_goal: sim.controller_kp is 300 in this command, "
                                  "and its default in "
                                  "tabletop_goal-heavy_payload-L5-nano-base-s0"));
  EXPECT_THAT(output(), HasSubstr("Choose another --out, or repeat the options of"));
  EXPECT_EQ(Sweep("--tasks 1 --episodes 1 --scenarios heavy_payload --methods null " + run), 0)
      << "fewer episodes pair as well\n"
      << output();
  EXPECT_EQ(Sweep(goal + "--methods ours --seeds 1 --set method.rank=2 " + run), 0)
      << "options of another method\n"
      << output();
  EXPECT_EQ(Sweep(goal + "--methods ours --seeds 2 " + run), 1);
  EXPECT_THAT(output(), HasSubstr("method ours: method.rank is "));
  // A run of an older version that has both.
  ASSERT_EQ(Sweep(gain + other), 0) << output();
  const std::string id = "/units/tabletop_goal-heavy_payload-L5-nano-gain-s0";
  std::filesystem::copy(folder_ + "/other" + id, folder_ + "/run" + id,
                        std::filesystem::copy_options::recursive);
  const auto say = [this](const std::string& program) {
    const int status = std::system(absl::StrCat("'", BIN_DIR, "/robostress-", program, " '",
                                                folder_, "/run' > '", output_file_, "' 2>&1")
                                       .c_str());
    return WEXITSTATUS(status);
  };
  EXPECT_EQ(say("store' verify"), 3);
  EXPECT_THAT(output(), HasSubstr("unlike: suite tabletop_goal: sim.controller_kp is its default"));
  EXPECT_EQ(say("report'"), 0);
  EXPECT_THAT(output(), HasSubstr("These units were not played alike"));
  EXPECT_THAT(*ReadFile(folder_ + "/run/report.html"), HasSubstr("sim.controller_kp is"));
}

TEST_F(SweepProgram, AScenarioFileThatIsGoneChangesNoReport) {
  const std::string file = folder_ + "/worn.yaml", out = folder_ + "/run";
  ASSERT_TRUE(WriteFileAtomically(file,
                                  "title: Worn elbow\n"
                                  "joints: [{name: J4, effects: [{type: transport_delay, "
                                  "delay_s: 0.02}]}]\n")
                  .ok());
  const std::string command =
      absl::StrCat("--tasks 1 --episodes 2 --severities 1,3 --methods base --scenarios '", file,
                   "' --out '", out, "'");
  ASSERT_EQ(Sweep(command), 0) << output();
  EXPECT_THAT(*ReadFile(out + "/plan/tabletop_goal-worn-L3-nano-base-s0.yaml"),
              HasSubstr("scenario: " + out + "/scenarios/worn.yaml\n"));
  const std::string table = *ReadFile(out + "/table.md"), json = *ReadFile(out + "/report.json");
  EXPECT_THAT(table, HasSubstr("Worn elbow"));
  std::filesystem::remove(file);
  const std::string report =
      absl::StrCat("'", BIN_DIR, "/robostress-report' '", out, "' > /dev/null && '", BIN_DIR,
                   "/robostress-store' verify '");
  ASSERT_EQ(std::system(absl::StrCat(report, out, "'").c_str()), 0);
  EXPECT_EQ(*ReadFile(out + "/table.md"), table);
  EXPECT_EQ(*ReadFile(out + "/report.json"), json);
}

TEST_F(SweepProgram, WidensARunDirectory) {
  ASSERT_EQ(Sweep(Small("run")), 0) << output();
  ASSERT_EQ(Sweep(absl::StrCat("--suites tabletop_goal --tasks 2 --episodes 3 --scenarios "
                               "clean,heavy_payload --methods base,ours,null --out '",
                               folder_, "/run'")),
            0)
      << output();
  EXPECT_EQ(Starts("run", "tabletop_goal-clean-L5-nano-base-s0"), 1);
  EXPECT_THAT(*ReadFile(folder_ + "/run/table.csv"), HasSubstr(",null,"));
}

TEST_F(SweepProgram, UnknownNamesEndWithCodeTwoAndWriteNothing) {
  EXPECT_EQ(Sweep(absl::StrCat("--suites tabletop_gaol --out '", folder_, "/run'")), 2);
  EXPECT_THAT(output(), HasSubstr("tabletop_goal"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run"));
  EXPECT_EQ(Sweep("--no-such-flag"), 2);
}

TEST_F(SweepProgram, SecondSweepInTheSameDirectoryIsRefused) {
  const std::string out = folder_ + "/run";
  absl::StatusOr<ChildProcess> first = ChildProcess::Start(
      {absl::StrCat(BIN_DIR, "/robostress-sweep"), "--tasks", "1", "--episodes", "10",
       "--scenarios", "clean", "--out", out},
      {{"FAKE_EPISODE_MS", "300"}, {"ROBOSTRESS_BIN", FAKE_PROGRAMS}}, folder_ + "/first.txt");
  ASSERT_TRUE(first.ok()) << first.status();
  const std::string episodes = out + "/units/tabletop_goal-clean-L5-nano-base-s0/episodes.jsonl";
  while (CountLines(episodes) == 0 && !first->Poll()) usleep(10000);
  EXPECT_EQ(Sweep(absl::StrCat("--tasks 1 --episodes 10 --scenarios clean --out '", out, "'")), 1);
  EXPECT_THAT(output(), HasSubstr("another sweep is running"));
  // SIGINT ends it with its workers and leaves the unit unfinished.
  kill(first->pid(), SIGINT);
  while (!first->Poll()) usleep(10000);
  EXPECT_EQ(first->Poll()->code, 130) << *ReadFile(folder_ + "/first.txt");
  EXPECT_FALSE(std::filesystem::exists(out + "/units/tabletop_goal-clean-L5-nano-base-s0/DONE"));
}

TEST(Dispatcher, RunsTheProgramAndListsWhatThereIs) {
  const std::string folder = TestFolder();
  const auto run = [&](const std::string& arguments) {
    const int status = std::system(
        absl::StrCat("'", BIN_DIR, "/robostress' ", arguments, " > '", folder, "/out.txt' 2>&1")
            .c_str());
    return std::pair(WEXITSTATUS(status), *ReadFile(folder + "/out.txt"));
  };
  EXPECT_EQ(run("").first, 0);
  EXPECT_THAT(run("--help").second, HasSubstr("sweep"));
  EXPECT_THAT(run("report --help").second, HasSubstr("RUN_DIR"));
  EXPECT_EQ(run("fly").first, 2);
  EXPECT_THAT(run("fly").second, HasSubstr("robostress-fly"));
  EXPECT_EQ(run("report " + folder).first, 1);
}

TEST(Progress, UnitsThatFailedAreNotCountedAsDone) {
  Progress progress(Progress::Output::kNone);
  for (const std::string id : {"a", "b"}) {
    progress.Expect(id, "absent.jsonl", 10);
    progress.Start(id);
    progress.Finish(id, /*failed=*/true);
  }
  EXPECT_THAT(progress.Line(), HasSubstr("0/2 units (2 failed)  0/20 episodes (0 %)"));
  EXPECT_THAT(progress.Line(), HasSubstr("ETA 0:00"));
}

TEST(Progress, FormatsDurations) {
  EXPECT_EQ(FormatDuration(0), "0:00");
  EXPECT_EQ(FormatDuration(62.4), "1:02");
  EXPECT_EQ(FormatDuration(3723), "1:02:03");
}

}  // namespace
}  // namespace robostress
