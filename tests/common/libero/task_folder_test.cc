#include "common/libero/task_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/libero/own_tasks.h"
#include "common/libero/protocols.h"
#include "common/suites.h"
#include "common/unit/unit_plan.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

// A folder with these files.
std::string Folder(const std::string& path, const std::vector<std::string>& files) {
  const fs::path folder = fs::path(::testing::TempDir()) / "suites" / path;
  fs::create_directories(folder);
  for (const std::string& file : files)
    EXPECT_TRUE(WriteFileAtomically((folder / file).string(), "").ok());
  return folder.string();
}

TEST(TaskFolder, IsASuiteNamedAsTheFolder) {
  const std::string folder = Folder("mine", {"b.bddl", "a.bddl", "tasks_info.txt"});
  EXPECT_EQ(FindSuite("mine"), nullptr);
  const absl::StatusOr<std::string> name = AddTaskFolder(folder + "/");
  ASSERT_TRUE(name.ok()) << name.status();
  EXPECT_EQ(*name, "mine");
  EXPECT_TRUE(AddTaskFolder(folder).ok()) << "again";
  const SuiteInfo* suite = FindSuite("mine");
  ASSERT_NE(suite, nullptr);
  EXPECT_EQ(suite->num_tasks, 2);
  EXPECT_EQ(suite->horizon, 400);
  EXPECT_TRUE(suite->needs_libero);
  EXPECT_THAT(SuitesOf("panda"), Contains("mine"));
  EXPECT_THAT(SuitesOf("piper"), Not(Contains("mine")));
  EXPECT_EQ(TaskFolderOf("mine"), folder);
  EXPECT_EQ(TaskFolderOf("libero_goal"), "");
  EXPECT_THAT(ReadLiberoTaskFolder(folder)->tasks, ElementsAre("a", "b"));
}

TEST(TaskFolder, ATaskThatIsNoFileIsRefusedForItMovesTheOthers) {
  const std::string folder = Folder("links", {"a.bddl", "c.bddl"});
  fs::remove(folder + "/b.bddl");
  fs::create_symlink("gone", folder + "/b.bddl");
  EXPECT_THAT(std::string(ReadLiberoTaskFolder(folder).status().message()),
              HasSubstr("/b.bddl: a link to a file that is not there"));
  fs::remove(folder + "/b.bddl");
  fs::create_symlink("b.bddl", folder + "/b.bddl");
  EXPECT_THAT(std::string(ReadLiberoTaskFolder(folder).status().message()),
              HasSubstr("/b.bddl: Too many levels of symbolic links; mend or remove it"));
}

TEST(TaskFolder, NamesThatNoTableCanShowAreRefused) {
  for (const char* name : {"open_\xFF.bddl", "two\nlines.bddl", "a\"quote.bddl"}) {
    const std::string folder = Folder("names", {name});
    EXPECT_THAT(std::string(ReadLiberoTaskFolder(folder).status().message()),
                AllOf(HasSubstr(folder), HasSubstr("rename it")))
        << name;
    fs::remove_all(folder);
  }
  EXPECT_TRUE(ReadLiberoTaskFolder(Folder("names", {"\u00d6ffne.bddl"})).ok());
}

TEST(TaskFolder, LiberosOwnTasksLieWhereItsCheckoutOrPackageHasThem) {
  fs::remove_all(fs::path(::testing::TempDir()) / "suites/root");
  const std::string root = Folder("root", {});
  EXPECT_EQ(LiberosOwnFolder(root, "libero_goal"), "");
  for (const std::string inside : {"", "/libero", "/libero/libero"}) {
    const std::string folder = Folder("root" + inside + "/bddl_files/libero_goal", {});
    EXPECT_EQ(LiberosOwnFolder(root, "libero_goal"), folder);
  }
  EXPECT_EQ(LiberosOwnFolder(root, "libero_10"), "");
  EXPECT_EQ(LiberosOwnFolder(root, "tabletop_goal"), "");
  // What is played counts, and nothing beside it.
  const std::string folder = LiberosOwnFolder(root, "libero_goal");
  const std::string empty = LiberosOwnSha256(folder);
  Folder("root/libero/libero/bddl_files/libero_goal",
         {"my_variant.bddl", "turn_on_the_stove.pruned_init"});
  EXPECT_EQ(LiberosOwnSha256(folder), empty);
  Folder("root/libero/libero/bddl_files/libero_goal", {"turn_on_the_stove.bddl"});
  const std::string task = LiberosOwnSha256(folder);
  EXPECT_NE(task, empty);
  Folder("root/libero/libero/init_files/libero_goal", {"turn_on_the_stove.pruned_init"});
  EXPECT_NE(LiberosOwnSha256(folder), task);
}

TEST(TaskFolder, AVariantHasTheHorizonAndTheLimitsOfItsSuite) {
  ASSERT_TRUE(AddTaskFolder(Folder("libero_goal_swap", {"a.bddl"})).ok());
  ASSERT_TRUE(AddTaskFolder(Folder("libero_10_lan", {"a.bddl"})).ok());
  EXPECT_EQ(FindSuite("libero_goal_swap")->horizon, 300);
  EXPECT_EQ(FindSuite("libero_10_lan")->horizon, 520);
  ASSERT_TRUE(AddTaskFolder(Folder("libero_100", {"a.bddl"})).ok());
  EXPECT_EQ(FindSuite("libero_100")->horizon, 400) << "no variant of libero_10";
  const absl::StatusOr<LiberoProtocol> lerobot = FindLiberoProtocol("lerobot");
  EXPECT_EQ(lerobot->StepLimit("libero_spatial_swap"), 280);
  EXPECT_EQ(lerobot->StepLimit("libero_90"), 400);
  EXPECT_EQ(lerobot->StepLimit("libero_spatials"), 0);
}

TEST(TaskFolder, WhatCannotBeASuiteSaysWhy) {
  EXPECT_THAT(std::string(AddTaskFolder(Folder("empty", {"a.txt"})).status().message()),
              HasSubstr("no .bddl file in it"));
  EXPECT_THAT(std::string(AddTaskFolder("/no/such/folder").status().message()),
              HasSubstr("/no/such/folder: No such file"));
  EXPECT_THAT(std::string(AddTaskFolder(Folder("libero_goal", {"a.bddl"})).status().message()),
              HasSubstr("would be suite 'libero_goal', which is the name of a suite that comes"));
  ASSERT_TRUE(AddTaskFolder(Folder("one/twice", {"a.bddl"})).ok());
  EXPECT_THAT(std::string(AddTaskFolder(Folder("two/twice", {"a.bddl"})).status().message()),
              HasSubstr("one/twice; give the folder, or a link to it, another name"));
}

TEST(TaskFolder, InitialStatesLieBesideTheTaskOrWhereLiberoHasThem) {
  const auto read = [](const std::string& path) { return *ReadLiberoTaskFolder(path); };
  const std::string plain =
      Folder("plain", {"a.bddl", "b.bddl", "c.bddl", "a.pruned_init", "a.init", "b.init.npz"});
  EXPECT_EQ(InitialStatesOf(read(plain), "a"), plain + "/a.pruned_init");
  EXPECT_EQ(InitialStatesOf(read(plain), "b"), plain + "/b.init.npz");
  EXPECT_EQ(InitialStatesOf(read(plain), "c"), "");
  // One that cannot be read is not passed over for states that are others.
  fs::remove(plain + "/a.pruned_init");
  fs::create_symlink("gone", plain + "/a.pruned_init");
  EXPECT_EQ(InitialStatesOf(read(plain), "a"), plain + "/a.pruned_init");
  const std::string tree = Folder("tree/bddl_files/pro", {"a.bddl"});
  const std::string states = Folder("tree/init_files/pro", {"a.pruned_init.npz"});
  EXPECT_EQ(InitialStatesOf(read(tree), "a"), states + "/a.pruned_init.npz");
}

// What the message of a name that is taken advises.
TEST(TaskFolder, ALinkHasAnotherNameAndTheSameFiles) {
  const std::string tasks = Folder("linked/bddl_files/libero_90", {"a.bddl"});
  const std::string states = Folder("linked/init_files/libero_90", {"a.pruned_init"});
  const fs::path link = fs::path(Folder("links", {})) / "ninety";
  fs::remove(link);
  fs::create_directory_symlink(tasks, link);
  const LiberoTaskFolder folder = *ReadLiberoTaskFolder(link.string());
  EXPECT_EQ(folder.suite, "ninety");
  EXPECT_EQ(folder.SuiteOfFiles(), "libero_90");
  EXPECT_EQ(InitialStatesOf(folder, "a"), fs::canonical(states).string() + "/a.pruned_init");
}

TEST(TaskFolder, WhatArchivesLeaveIsNoTask) {
  const std::string folder = Folder("unpacked", {"a.bddl", "._a.bddl", ".b.bddl"});
  fs::create_directories(folder + "/c.bddl");
  EXPECT_THAT(ReadLiberoTaskFolder(folder)->tasks, ElementsAre("a"));
}

TEST(TaskFolder, AUnitNamesTheFoldersSuite) {
  UnitConfig unit;
  unit.policy = "expert";
  unit.method.Edit().method = "base";
  unit.libero_tasks = Folder("unit_suite", {"a.bddl", "b.bddl", "c.bddl"});
  unit.suite = "unit_suite";
  const absl::StatusOr<UnitConfig> resolved = ResolveUnit(unit);
  ASSERT_TRUE(resolved.ok()) << resolved.status();
  EXPECT_THAT(resolved->tasks, ElementsAre(0, 1, 2));
  unit.suite = "libero_goal";
  EXPECT_THAT(std::string(ResolveUnit(unit).status().message()),
              HasSubstr("is suite 'unit_suite'; suite must be the folder's name"));
}

}  // namespace
}  // namespace robostress
