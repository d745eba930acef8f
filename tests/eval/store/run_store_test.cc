#include "eval/store/run_store.h"

#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "eval/plan/plan.h"
#include "eval/store/work_list.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr char kLine[] =
    R"({"task":0,"episode":0,"initial_state":0,"success":true,"steps":10,"chunks":2,"updates":0,"residual":0.25,"intent":null})";

// Writes a unit with `record` as its episodes; its id.
std::string WriteUnit(const std::string& run, int seed, int episodes, const std::string& record,
                      bool done) {
  UnitConfig config;
  config.seed = seed;
  config.tasks = {0};
  config.episodes = episodes;
  const std::string id = UnitId(config), dir = run + "/units/" + id;
  EXPECT_TRUE(MakeDirectories(dir).ok());
  EXPECT_TRUE(WriteFileAtomically(dir + "/config.yaml", DumpConfig(config)).ok());
  EXPECT_TRUE(WriteFileAtomically(dir + "/episodes.jsonl", record).ok());
  if (done) {
    EXPECT_TRUE(WriteFileAtomically(dir + "/DONE", "").ok());
  }
  return id;
}

TEST(LoadRun, LeavesUnfinishedUnitsOut) {
  const std::string run = TestFolder();
  WriteUnit(run, 0, 1, std::string(kLine) + "\n", true);
  const std::string open = WriteUnit(run, 1, 1, "", false);
  const absl::StatusOr<RunData> data = LoadRun(run);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->units.size(), 1u);
  EXPECT_THAT(data->unfinished, ::testing::ElementsAre(open));
}

// Six episodes of two parts of four and two, both done.
PlannedUnit UnitInParts(const RunDirectory& run, int seed) {
  PlannedUnit unit;
  unit.config.seed = seed;
  unit.config.tasks = {0};
  unit.config.episodes = 6;
  unit.id = UnitId(unit.config);
  const WorkItem parts[] = {{&unit, 0, 4, 4}, {&unit, 4, 2, 4}};
  for (const WorkItem& item : parts) {
    EXPECT_TRUE(PublishItem(run, item).ok());
    const std::string folder = item.Folder(run);
    EXPECT_TRUE(MakeDirectories(folder).ok());
    EXPECT_TRUE(WriteFileAtomically(folder + "/config.yaml", DumpConfig(unit.config)).ok());
    for (const char* name : {"/timing.jsonl", "/episodes.jsonl"}) {
      for (int k = 0; k < item.count; ++k) EXPECT_TRUE(AppendLine(folder + name, kLine).ok());
    }
    EXPECT_TRUE(WriteFileAtomically(folder + "/DONE", "").ok());
  }
  return unit;
}

// Tasks of a scheduler that finish the last two parts of a unit in the same moment.
TEST(JoinParts, MayBeDoneBySeveralProcessesAtOnce) {
  const RunDirectory run(TestFolder());
  ASSERT_TRUE(MakeDirectories(run.path() + "/plan").ok());
  for (int round = 0; round < 40; ++round) {
    const PlannedUnit unit = UnitInParts(run, round);
    int gate[2];
    ASSERT_EQ(pipe(gate), 0);
    std::vector<pid_t> processes;
    for (int k = 0; k < 4; ++k) {
      const pid_t process = fork();
      if (process == 0) {
        close(gate[1]);
        char byte;
        [[maybe_unused]] const ssize_t opened = read(gate[0], &byte, 1);  // at its end
        const absl::Status status = JoinParts(run, unit);
        if (!status.ok()) std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
        _exit(status.ok() ? 0 : 1);
      }
      processes.push_back(process);
    }
    close(gate[0]), close(gate[1]);
    for (const pid_t process : processes) {
      int status = -1;
      ASSERT_EQ(waitpid(process, &status, 0), process);
      EXPECT_EQ(status, 0) << "round " << round;
    }
    EXPECT_EQ(CountLines(run.Unit(unit.id) + "/episodes.jsonl"), 6);
    EXPECT_FALSE(std::filesystem::exists(run.Parts(unit.id))) << "round " << round;
  }
}

// One of the machines that played them lacked a texture.
TEST(JoinParts, WhatMachinesSayOfLiberosFilesMayDiffer) {
  const RunDirectory run(TestFolder());
  ASSERT_TRUE(MakeDirectories(run.path() + "/plan").ok());
  const auto joined = [&](int seed, const std::string& first, const std::string& second) {
    const PlannedUnit unit = UnitInParts(run, seed);
    for (const auto& [part, text] :
         {std::pair{WorkItem{&unit, 0, 4, 4}, first}, {WorkItem{&unit, 4, 2, 4}, second}})
      EXPECT_TRUE(WriteFileAtomically(part.Folder(run) + "/provenance.json", text).ok());
    const absl::Status status = JoinParts(run, unit);
    return status.ok() ? *ReadFile(run.Unit(unit.id) + "/provenance.json")
                       : std::string(status.message());
  };
  const std::string whole = R"({"libero_files":"as published","policy":"nano"})";
  const std::string lacks = R"({"libero_files":"1 of 300 differ","policy":"nano"})";
  EXPECT_EQ(joined(0, whole, lacks), lacks + "\n");
  EXPECT_EQ(joined(1, lacks, whole), lacks + "\n");
  EXPECT_EQ(joined(2, whole, R"({"policy":"nano"})"), whole + "\n");
  EXPECT_THAT(joined(3, whole, R"({"policy":"nano-bc"})"), HasSubstr("provenance.json"));
}

TEST(LoadRun, RefusesAFinishedUnitThatContradictsItsConfiguration) {
  const std::string run = TestFolder();
  WriteUnit(run, 0, 2, std::string(kLine) + "\n", true);
  EXPECT_THAT(std::string(LoadRun(run).status().message()),
              HasSubstr("has 1 episodes, its configuration says 2"));
  WriteUnit(run, 0, 2, std::string(kLine) + "\n" + kLine + "\n", true);
  EXPECT_THAT(std::string(LoadRun(run).status().message()), HasSubstr("recorded twice"));
}

TEST(LoadRun, RefusesARecordThatIsNotTheOneThatWasFinished) {
  const std::string run = TestFolder(), record = std::string(kLine) + "\n";
  const std::string done = run + "/units/" + WriteUnit(run, 0, 1, record, true) + "/DONE";
  const auto stamped = [](const std::string& sum) {
    return nlohmann::json{{"episodes_sha256", sum}}.dump();
  };
  ASSERT_TRUE(WriteFileAtomically(done, stamped(Sha256Hex(record))).ok());
  EXPECT_TRUE(LoadRun(run).ok()) << LoadRun(run).status();
  ASSERT_TRUE(WriteFileAtomically(done, stamped(Sha256Hex("another record\n"))).ok());
  const absl::Status refused = LoadRun(run).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(refused.message()), HasSubstr(Sha256Hex(record).substr(0, 12)));
}

TEST(LoadRun, RefusesRecordsOfAnotherType) {
  const std::string run = TestFolder(), record = std::string(kLine) + "\n";
  const std::string folder = run + "/units/" + WriteUnit(run, 0, 1, record, true);
  const auto refusal = [&](const char* file, const std::string& text) {
    EXPECT_TRUE(WriteFileAtomically(folder + file, text).ok());
    const absl::Status status = LoadRun(run).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << text;
    return std::string(status.message());
  };
  const std::string sound = run + "/units/" + WriteUnit(run, 1, 1, record, true);
  ASSERT_TRUE(WriteFileAtomically(sound + "/provenance.json", "{\"model_hash\": \"a\"}").ok());
  for (const char* value : {"null", "5", "[]", "{}"}) {
    EXPECT_THAT(refusal("/provenance.json", absl::StrCat("{\"model_hash\": ", value, "}")),
                AllOf(HasSubstr(absl::StrCat("provenance.json: model_hash is ", value)),
                      ::testing::Not(HasSubstr("has weights"))));
  }
  EXPECT_THAT(refusal("/provenance.json", "{\"noise_paired\": false}"),
              HasSubstr("noise_paired is false, must be a text"));
  EXPECT_THAT(refusal("/provenance.json", "5"), HasSubstr("is not a JSON object"));
  EXPECT_THAT(refusal("/DONE", "{\"episodes_sha256\": 7}"),
              HasSubstr("DONE: episodes_sha256 is 7, must be a text"));
}

TEST(EpisodeTable, SortsBySuiteAlsoWhereNoneIsOurs) {
  RunData run;
  for (const char* scenario : {"clean", "heavy_payload"}) {
    for (const char* suite : {"their_tasks", "my_tasks"})
      run.units.push_back(SyntheticUnit(scenario, "base", {1}, {}, suite));
  }
  SortUnits(run.units);
  EXPECT_EQ(run.units[0].config.suite, "my_tasks");
  EXPECT_EQ(run.units[1].config.suite, "my_tasks");
}

TEST(LoadRun, RefusesOnePolicyWithTwoWeights) {
  const std::string run = TestFolder();
  for (const auto& [seed, hash] : {std::pair{0, "0123456789ab"}, std::pair{1, "fedcba987654"}}) {
    const std::string id = WriteUnit(run, seed, 1, std::string(kLine) + "\n", true);
    ASSERT_TRUE(WriteFileAtomically(run + "/units/" + id + "/provenance.json",
                                    nlohmann::json{{"model_hash", hash}}.dump())
                    .ok());
  }
  EXPECT_THAT(std::string(LoadRun(run).status().message()),
              AllOf(HasSubstr("has weights 0123456789ab"), HasSubstr("fedcba987654")));
}

TEST(LoadRun, CallsAPolicyByItsLabelHoweverItsPathIsSpelled) {
  const std::string run = TestFolder();
  const auto write = [&](int seed, const std::string& policy, const std::string& hash) {
    const std::string id = WriteUnit(run, seed, 1, std::string(kLine) + "\n", true);
    UnitConfig config = *LoadConfig<UnitConfig>(run + "/units/" + id + "/config.yaml");
    config.policy = policy;
    const std::string folder = run + "/units/" + UnitId(config);
    std::filesystem::rename(run + "/units/" + id, folder);
    ASSERT_TRUE(WriteFileAtomically(folder + "/config.yaml", DumpConfig(config)).ok());
    ASSERT_TRUE(WriteFileAtomically(folder + "/provenance.json",
                                    nlohmann::json{{"model_hash", hash}}.dump())
                    .ok());
  };
  write(0, "mine.safetensors", "0123456789ab");
  write(1, "/somewhere/mine.safetensors", "0123456789ab");
  const absl::StatusOr<RunData> data = LoadRun(run);
  ASSERT_TRUE(data.ok()) << data.status();
  for (const UnitResult& unit : data->units) EXPECT_EQ(unit.config.policy, "mine");
  write(2, "/elsewhere/mine.safetensors", "fedcba987654");
  EXPECT_THAT(std::string(LoadRun(run).status().message()),
              AllOf(HasSubstr("policy mine has weights 0123456789ab in 2 units"),
                    HasSubstr("fedcba987654")));
}

TEST(WorkList, OnlyEpisodesThatCarryNothingOverAreDivided) {
  for (const auto& [method, divided] :
       {std::pair{"base", true}, std::pair{"gain", true}, std::pair{"ours", false},
        std::pair{"ours_integral", false}, std::pair{"ours_following", false}}) {
    PlannedUnit unit;
    unit.config.method = *MakeMethod(method);
    EXPECT_EQ(MaySplit(unit), divided) << method;
  }
}

TEST(LoadRun, RefusesAUnitUnderAnotherName) {
  const std::string run = TestFolder();
  const std::string id = WriteUnit(run, 0, 1, std::string(kLine) + "\n", true);
  std::filesystem::copy(run + "/units/" + id, run + "/units/" + id + ".bak",
                        std::filesystem::copy_options::recursive);
  EXPECT_THAT(std::string(LoadRun(run).status().message()),
              HasSubstr("is that of unit " + id + ", its folder is called " + id + ".bak"));
  std::filesystem::remove_all(run + "/units/" + id + ".bak");
  EXPECT_TRUE(LoadRun(run).ok());
  ASSERT_TRUE(WriteFileAtomically(run + "/units/" + id + "/config.yaml", "\n").ok());
  EXPECT_THAT(std::string(LoadRun(run).status().message()), HasSubstr("config.yaml is empty"));
}

// Versions up to 0.2 called a checkpoint pi0.5 "pi0".
TEST(LoadRun, ReadsAUnitUnderItsOlderName) {
  const std::string run = TestFolder();
  UnitConfig config;
  config.policy = "checkpoints/pi0.5";
  config.tasks = {0};
  config.episodes = 1;
  const std::string dir = run + "/units/" + OlderUnitId(config);
  ASSERT_TRUE(MakeDirectories(dir).ok());
  for (const auto& [name, text] :
       {std::pair{"/config.yaml", DumpConfig(config)},
        std::pair{"/episodes.jsonl", std::string(kLine) + "\n"}, std::pair{"/DONE", std::string()}})
    ASSERT_TRUE(WriteFileAtomically(dir + name, text).ok());
  SweepGrid grid;
  grid.suites = {config.suite};
  grid.scenarios = {"clean"};
  grid.policies = {config.policy};
  grid.methods = {"base"};
  ASSERT_TRUE(WriteFileAtomically(run + "/sweep.yaml", DumpConfig(grid)).ok());
  const absl::StatusOr<RunData> data = LoadRun(run);
  ASSERT_TRUE(data.ok()) << data.status();
  ASSERT_EQ(data->units.size(), 1u);
  EXPECT_EQ(PolicyLabel(data->units[0].config.policy), "pi0.5");
  EXPECT_TRUE(data->unfinished.empty()) << "the grid's unit is that one";
}

TEST(RunDirectory, DoesNotPlayAUnitAgainThatHasAnOlderName) {
  const RunDirectory run(TestFolder());
  PlannedUnit unit;
  unit.config.policy = "checkpoints/pi0.5";
  unit.id = UnitId(unit.config);
  const std::string older = run.Unit(OlderUnitId(unit.config));
  ASSERT_TRUE(MakeDirectories(older).ok());
  ASSERT_TRUE(WriteFileAtomically(older + "/config.yaml", DumpConfig(unit.config)).ok());
  EXPECT_THAT(std::string(run.CheckStarted({}, {unit}).message()),
              AllOf(HasSubstr(older +
                              " was begun by a version up to 0.2, and this one calls the "
                              "unit " +
                              unit.id),
                    HasSubstr("Choose another --out")));
}

TEST(LoadRun, SaysWhenAFolderIsNoRun) {
  const std::string folder = TestFolder();
  EXPECT_THAT(std::string(LoadRun(folder).status().message()), HasSubstr("not a run directory"));
  std::filesystem::create_directories(folder + "/units");
  EXPECT_THAT(std::string(LoadRun(folder).status().message()), HasSubstr("no finished unit"));
}

TEST(EpisodeTable, QuotesTextsAndWritesNumbersAsTheyWere) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1})};
  run.units[0].episodes[0].record = R"({"policy":"a,\"b\"","residual":0.1})";
  const std::string csv = EpisodeTableCsv(run);
  EXPECT_THAT(csv, HasSubstr("suite,scenario,severity,policy,method"));
  EXPECT_THAT(csv, HasSubstr("\"a,\"\"b\"\"\""));
  EXPECT_THAT(csv, HasSubstr(",0.1\n"));
}

}  // namespace
}  // namespace robostress
