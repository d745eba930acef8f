// A grid on a Slurm of one machine, with a task that is killed and a preemption of everything.

#include <poll.h>
#include <signal.h>

#include <algorithm>
#include <filesystem>
#include <functional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "eval/store/run_directory.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/grid_programs.h"
#include "tests/eval/launch/slurm_cluster.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// The process whose command line, its arguments joined by blanks, contains `text`; 0: none.
int ProcessWith(const std::string& text) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/proc", error)) {
    int pid = 0;
    if (!absl::SimpleAtoi(entry.path().filename().string(), &pid)) continue;
    std::string command = ReadFile(entry.path().string() + "/cmdline").value_or("");
    std::replace(command.begin(), command.end(), '\0', ' ');
    if (absl::StrContains(command, text) && absl::StrContains(command, "robostress-grid-job work"))
      return pid;
  }
  return 0;
}

void WaitUntil(const std::function<bool()>& condition) {
  while (!condition()) poll(nullptr, 0, 100);
}

TEST(Slurm, KilledAndPreemptedTasksLeaveTheTableOfALocalSweep) {
  if (const std::string reason = SlurmCluster::WhyNot(); !reason.empty())
    GTEST_SKIP() << "no Slurm here: " << reason;
  const std::string folder = TestFolder(), run = folder + "/a run, 50%", gate = folder + "/gate";
  const absl::StatusOr<std::unique_ptr<SlurmCluster>> cluster =
      SlurmCluster::Start(folder + "/slurm");
  if (!cluster.ok()) GTEST_SKIP() << "no Slurm here: " << cluster.status().message();
  const auto [local, local_text] =
      RunGrid(folder, "sweep", SmallGrid() + "--no-report --out '" + folder + "/local'");
  ASSERT_EQ(local, 0) << local_text;

  const std::string arguments =
      SmallGrid() +
      "--launcher slurm --wait --poll-interval 1 --workers 2 --max-tasks 2 "
      "--server-threads 1 --server-host 127.0.0.1 --split-episodes 3 --out '" +
      run + "'";
  const std::string environment = (*cluster)->Environment() + " FAKE_WORKER_GATE='" + gate + "'";
  absl::StatusOr<ChildProcess> sweep =
      ChildProcess::Start({"/bin/sh", "-c",
                           absl::StrCat(environment, " ROBOSTRESS_BIN='", FAKE_PROGRAMS, "' exec '",
                                        BIN_DIR, "/robostress-sweep' ", arguments)},
                          {}, folder + "/sweep.log");
  ASSERT_TRUE(sweep.ok()) << sweep.status();

  // Both tasks are in their first piece of work: each worker has begun and waits at the gate.
  const auto begun = [&] {
    int count = 0;
    std::error_code error;
    for (const auto& entry : fs::recursive_directory_iterator(run, error))
      count += entry.path().filename() == "episodes.jsonl" && CountLines(entry.path()) == 1;
    return count;
  };
  WaitUntil([&] { return begun() == 2 || sweep->Poll(); });
  ASSERT_FALSE(sweep->Poll()) << *ReadFile(folder + "/sweep.log");
  // Another sweep does not mix with the jobs.
  EXPECT_EQ(RunGrid(folder, "sweep", SmallGrid() + "--out '" + run + "'", (*cluster)->Environment())
                .first,
            1);

  const int victim = ProcessWith("--submission " + run + "/submissions/0001 --index 1 ");
  ASSERT_NE(victim, 0);
  EXPECT_EQ(kill(victim, SIGKILL), 0);
  // Until Slurm has seen its end, a preemption would still requeue it.
  WaitUntil([&] {
    return !absl::StrContains((*cluster)->Run("squeue --noheader --array --format=task%K."),
                              "task1.");
  });
  // A job of the other partition needs all cores: the server and the other task are preempted.
  (*cluster)->Run(
      "sbatch --wait --partition=urgent --cpus-per-task=4 --output=/dev/null "
      "--wrap 'touch " +
      folder + "/urgent'");
  EXPECT_TRUE(fs::exists(folder + "/urgent"));
  ASSERT_TRUE(WriteFileAtomically(gate, "").ok());
  const ExitState end = sweep->WaitForEnd();
  EXPECT_EQ(end.code, 1) << "the killed task's share is missing\n"
                         << *ReadFile(folder + "/sweep.log");
  EXPECT_THAT(*ReadFile(folder + "/sweep.log"), HasSubstr("FAILED"));

  const auto [again, text] = RunGrid(folder, "sweep", arguments, environment);
  EXPECT_EQ(again, 0) << text;
  EXPECT_EQ(*ReadFile(run + "/episodes.csv"), *ReadFile(folder + "/local/episodes.csv"));
  EXPECT_TRUE(fs::exists(run + "/report.html"));
  EXPECT_EQ(RunGrid(folder, "store", "verify '" + run + "'").first, 0);
}

TEST(Slurm, WithoutItTheCommandFailsAndNamesWhatIsMissing) {
  const std::string folder = TestFolder();
  const auto [code, text] =
      RunGrid(folder, "sweep", SmallGrid() + "--launcher slurm --out '" + folder + "/run'",
              "PATH=/nowhere");
  EXPECT_EQ(code, 1);
  EXPECT_THAT(text, HasSubstr("sbatch"));
}

}  // namespace
}  // namespace robostress
