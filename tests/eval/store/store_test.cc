// Verifying, merging and indexing run directories.

#include <sqlite3.h>

#include <filesystem>

#include "eval/store/run_store.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/common/libero/init_file.h"
#include "tests/eval/grid_programs.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

// Everything an index answers; stamps apart, which are of the disk.
std::string Rows(const std::string& index) {
  sqlite3* db = nullptr;
  std::string text;
  EXPECT_EQ(sqlite3_open(index.c_str(), &db), SQLITE_OK);
  const auto add = [](void* out, int count, char** values, char**) {
    for (int i = 0; i < count; ++i)
      absl::StrAppend(static_cast<std::string*>(out), values[i] == nullptr ? "-" : values[i], "|");
    static_cast<std::string*>(out)->push_back('\n');
    return 0;
  };
  EXPECT_EQ(sqlite3_exec(db,
                         "SELECT store, unit, state, episodes, successes, wall_s, model_hash, "
                         "episodes_sha256, machines FROM units; SELECT * FROM episodes",
                         add, &text, nullptr),
            SQLITE_OK);
  sqlite3_close(db);
  return text;
}

constexpr char kCleanBase[] = "/units/tabletop_goal-clean-L5-nano-base-s0";
constexpr char kCleanOurs[] = "/units/tabletop_goal-clean-L5-nano-ours-s0";
constexpr char kHeavyBase[] = "/units/tabletop_goal-heavy_payload-L5-nano-base-s0";
constexpr char kHeavyOurs[] = "/units/tabletop_goal-heavy_payload-L5-nano-ours-s0";

class Store : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = TestFolder();
    ASSERT_EQ(Sweep("a", ""), 0) << output_;
  }
  int Sweep(const std::string& name, const std::string& more) {
    return Run("sweep",
               SmallGrid() + more + " --no-report --quiet --out '" + folder_ + "/" + name + "'");
  }
  int Run(const std::string& program, const std::string& arguments) {
    const auto [code, text] = RunGrid(folder_, program, arguments);
    output_ = text;
    return code;
  }
  // `robostress store COMMAND STORES...`, names within the test's folder.
  int StoreCommand(const std::string& command, const std::vector<std::string>& names,
                   const std::string& more = "") {
    std::string arguments = command;
    for (const std::string& name : names)
      absl::StrAppend(&arguments, " '", folder_, "/", name, "'");
    return Run("store", arguments + more);
  }
  std::string Out(const std::string& name) const { return " --out '" + folder_ + "/" + name + "'"; }
  void Write(const std::string& file, const std::string& text) {
    ASSERT_TRUE(WriteFileAtomically(folder_ + "/" + file, text).ok());
  }
  std::string Text(const std::string& file) const {
    return ReadFile(folder_ + "/" + file).value_or("(none)");
  }
  std::string folder_, output_;
};

TEST_F(Store, SoundStoreIsComplete) {
  EXPECT_EQ(StoreCommand("verify", {"a"}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("4 finished units, 0 findings"));
  EXPECT_EQ(StoreCommand("verify", {"nowhere", "a", "elsewhere"}), 1);
  EXPECT_THAT(output_, AllOf(HasSubstr("nowhere is not a run directory"),
                             HasSubstr("elsewhere is not a run directory")));
}

TEST_F(Store, EverythingWrongIsListedAtOnce) {
  const std::string episodes = Text(std::string("a") + kCleanBase + "/episodes.jsonl");
  std::string changed = episodes;
  changed.replace(changed.find("\"steps\":"), 9, "\"steps\":9");
  Write(std::string("a") + kCleanBase + "/episodes.jsonl", changed);
  Write(std::string("a") + kCleanOurs + "/episodes.jsonl",
        episodes.substr(0, episodes.size() - 10));
  fs::remove(folder_ + "/a" + kHeavyBase + "/DONE");
  fs::remove_all(folder_ + "/a" + kHeavyOurs);
  fs::create_directories(folder_ + "/a/units/stray");
  EXPECT_EQ(StoreCommand("verify", {"a"}), 3);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("clean-L5-nano-base-s0/episodes.jsonl is not what DONE says"),
                    HasSubstr("clean-L5-nano-ours-s0/episodes.jsonl ends in a torn line"),
                    HasSubstr("unfinished: "), HasSubstr("6 of 6 episodes"), HasSubstr("missing: "),
                    HasSubstr("heavy_payload-L5-nano-ours-s0"), HasSubstr("unplanned: ")));
  // A report refuses the damaged units, and names both.
  EXPECT_EQ(Run("report", "'" + folder_ + "/a'"), 1);
  EXPECT_THAT(output_, AllOf(HasSubstr("nano-base-s0/episodes.jsonl is not what DONE says"),
                             HasSubstr("nano-ours-s0/episodes.jsonl")));
}

TEST_F(Store, LinesOfAnotherUnitAreNotReadAsThisOnes) {
  for (const char* file : {"/episodes.jsonl", "/DONE"})
    Write(std::string("a") + kCleanBase + file, Text(std::string("a") + kHeavyBase + file));
  EXPECT_EQ(StoreCommand("verify", {"a"}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("clean-L5-nano-base-s0/episodes.jsonl: the line of task "),
                             HasSubstr("says scenario \"heavy_payload\", config.yaml \"clean\"")));
  EXPECT_EQ(Run("report", "'" + folder_ + "/a'"), 1) << output_;
}

TEST_F(Store, UnfinishedStoreIsNoErrorOfTheData) {
  fs::remove(folder_ + "/a" + kHeavyBase + "/DONE");
  EXPECT_EQ(StoreCommand("verify", {"a"}, " --json"), 1);
  EXPECT_THAT(output_, HasSubstr("\"fault\": \"unfinished\""));
}

TEST_F(Store, MergeOfPartialStoresIsTheWholeRun) {
  ASSERT_EQ(Sweep("b", "--only scenario=clean"), 0) << output_;
  ASSERT_EQ(Sweep("c", "--only method=base"), 0) << output_;
  EXPECT_EQ(StoreCommand("merge", {"b", "c"}, Out("merged")), 1) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("duplicate: "), HasSubstr("3 units merged")));
  ASSERT_EQ(Sweep("d", "--only scenario=heavy_payload,method=ours"), 0) << output_;
  EXPECT_EQ(StoreCommand("merge", {"d"}, Out("merged")), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("1 units merged"), HasSubstr("3 were there")));
  EXPECT_EQ(Text("merged/episodes.csv"), Text("a/episodes.csv"));
  EXPECT_EQ(StoreCommand("merge", {"b", "c", "d"}, Out("merged")), 0) << "again changes nothing";
  EXPECT_THAT(output_, HasSubstr("0 units merged"));
  // What merged is a run directory: the sweep finds everything done.
  ASSERT_EQ(Run("sweep", SmallGrid() + "--no-report" + Out("merged")), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("4 of 4 units were already done"));
}

TEST_F(Store, ConflictingVersionsAreListedAndNothingIsMerged) {
  ASSERT_EQ(Sweep("b", "--set method.tracking_gain=0.3"), 0) << output_;
  EXPECT_EQ(StoreCommand("merge", {"a", "b"}, Out("merged")), 3);
  for (const char* unit : {kCleanBase, kCleanOurs, kHeavyBase, kHeavyOurs})
    EXPECT_THAT(output_,
                HasSubstr("conflict: " + folder_ + "/b/" + fs::path(unit).filename().string()));
  EXPECT_FALSE(fs::exists(folder_ + "/merged"));
}

TEST_F(Store, ScenarioFilesAreComparedByWhatTheyHold) {
  const auto sweep = [this](const std::string& store, const std::string& method,
                            const std::string& delay_s) {
    const std::string file = "from_" + store + "/worn.yaml";
    fs::create_directories(folder_ + "/from_" + store);
    Write(file,
          "joints: [{name: J4, effects: [{type: transport_delay, delay_s: " + delay_s + "}]}]");
    return Run("sweep", "--suites tabletop_goal --tasks 1 --episodes 2 --methods " + method +
                            " --scenarios '" + folder_ + "/" + file + "' --no-report" + Out(store));
  };
  ASSERT_EQ(sweep("b", "base", "0.02"), 0) << output_;
  ASSERT_EQ(sweep("c", "base,ours", "0.02"), 0) << output_;
  ASSERT_EQ(sweep("d", "ours", "0.04"), 0) << output_;
  EXPECT_EQ(StoreCommand("merge", {"b", "c"}, Out("merged")), 0)
      << "where the file lay is nothing\n"
      << output_;
  EXPECT_THAT(output_, HasSubstr("2 units merged"));
  // One row, though the configurations name two places.
  EXPECT_EQ(Run("report", "'" + folder_ + "/merged' --bootstrap 50"), 0) << output_;
  EXPECT_THAT(Text("merged/table.csv"),
              AllOf(HasSubstr("\nnano,5,all,worn,base,"), HasSubstr("\nnano,5,all,worn,ours,"),
                    Not(HasSubstr(folder_))));
  EXPECT_EQ(Run("compare", "'" + folder_ + "/c' '" + folder_ + "/d'" + Out("compared")), 1);
  EXPECT_THAT(output_, HasSubstr("Not compared, because the file holds another scenario"));
  EXPECT_EQ(StoreCommand("merge", {"b", "d"}, Out("mixed")), 3);
  EXPECT_THAT(output_, HasSubstr("conflict: " + folder_ +
                                 "/d: scenarios/worn.yaml is another "
                                 "scenario in " +
                                 folder_ + "/b"));
  EXPECT_FALSE(fs::exists(folder_ + "/mixed"));
}

TEST_F(Store, RunsOfATaskFolderAreReadWithAndWithoutIt) {
  const std::string tasks = folder_ + "/my_tasks";
  fs::create_directories(tasks);
  for (const char* name : {"one", "two"}) {
    Write(absl::StrCat("my_tasks/", name, ".bddl"), libero::TaskFile(name));
    Write(absl::StrCat("my_tasks/", name, ".init"), libero::InitFile(2));
  }
  ASSERT_EQ(Run("sweep", "--libero-tasks '" + tasks +
                             "' --libero-root here --robosuite-root here --episodes 2 --scenarios "
                             "clean,heavy_payload --policies expert --methods base --no-report" +
                             Out("b")),
            0)
      << output_;
  const auto is_read = [this] {
    EXPECT_EQ(StoreCommand("verify", {"b"}), 0) << output_;
    EXPECT_THAT(output_, HasSubstr("2 finished units, 0 findings"));
    EXPECT_EQ(StoreCommand("outcomes", {"b"}, Out("b.jsonl")), 0) << output_;
    fs::remove_all(folder_ + "/merged");
    EXPECT_EQ(StoreCommand("merge", {"b"}, Out("merged")), 0) << output_;
    EXPECT_EQ(Run("report", "'" + folder_ + "/merged' --export '" + folder_ + "/b.json'"), 0)
        << output_;
    EXPECT_THAT(Text("b.json"), HasSubstr("\"suite\": \"my_tasks\""));
    EXPECT_THAT(Text("b.json"), ::testing::Not(HasSubstr(folder_)));
  };
  is_read();
  fs::remove_all(tasks);
  is_read();
}

TEST_F(Store, OtherWeightsUnderTheSamePolicyAreNamed) {
  const std::string other = R"({"model_hash":"0123456789abcdef","policy":"nano","version":"0"})";
  ASSERT_EQ(Sweep("b", "--only method=ours"), 0) << output_;
  Write(std::string("b") + kCleanOurs + "/provenance.json", other);
  EXPECT_EQ(StoreCommand("verify", {"a", "b"}), 3);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("other model: policy nano has weights 0123456789ab in 1 units"),
                    HasSubstr("/b/tabletop_goal-clean-L5-nano-ours-s0")));
  EXPECT_THAT(std::string(LoadRun(folder_ + "/b").status().message()),
              HasSubstr("policy nano has weights 0123456789ab"));
}

TEST_F(Store, OutcomesMakeThePapersTableAgain) {
  const std::string tables = "anchor ablation --tasks 2 --episodes 3 --bootstrap 50 ";
  ASSERT_EQ(Run("paper", tables + Out("paper")), 0) << output_;
  EXPECT_EQ(StoreCommand("outcomes", {"paper"}, Out("kept.jsonl")), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("outcomes of 42 units"));
  const std::string kept = " --outcomes '" + folder_ + "/kept.jsonl'";
  ASSERT_EQ(Run("paper", tables + kept + Out("again")), 0) << output_;
  EXPECT_FALSE(fs::exists(folder_ + "/again/units")) << "nothing ran";
  for (const char* file : {"/tables/anchor.csv", "/tables/ablation.md"})
    EXPECT_EQ(Text("again" + std::string(file)), Text("paper" + std::string(file)));
  EXPECT_EQ(Run("paper", "residual dob" + kept + Out("again")), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("table residual is not one of success"),
                             HasSubstr("table dob is not one of success")));
  EXPECT_EQ(StoreCommand("outcomes", {"nowhere"}, Out("none.jsonl")), 1);
  EXPECT_FALSE(fs::exists(folder_ + "/none.jsonl"));
}

TEST_F(Store, IndexFollowsTheRunsAndCanBeRebuilt) {
  const std::string index = folder_ + "/index.sqlite";
  EXPECT_EQ(StoreCommand("index", {"a"}, " --index '" + index + "'"), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("4 units read, 0 unchanged, 0 removed"));
  EXPECT_EQ(StoreCommand("index", {"a"}, " --index '" + index + "'"), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("0 units read, 4 unchanged"));
  fs::remove_all(folder_ + "/a" + kHeavyOurs);
  fs::remove(folder_ + "/a" + kHeavyBase + "/DONE");
  EXPECT_EQ(StoreCommand("index", {"a"}, " --index '" + index + "'"), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("1 units read, 2 unchanged, 1 removed"));
  EXPECT_EQ(StoreCommand("index", {"a"}, " --index '" + folder_ + "/new.sqlite'"), 0) << output_;
  EXPECT_EQ(Rows(index), Rows(folder_ + "/new.sqlite"));
  Write("no.sqlite",
        "this is no database, and long enough for SQLite to look at its header ......");
  EXPECT_EQ(StoreCommand("index", {"a"}, " --index '" + folder_ + "/no.sqlite'"), 1);
  EXPECT_THAT(output_, HasSubstr("delete it"));
}

}  // namespace
}  // namespace robostress
