// The bash script ./run with stand-ins for the package tools and cmake: what it installs, when, and
// what it says.

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

class RunScript : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = TestFolder();
    // A checkout with only what the script reads, and a PATH with only what a bare Debian has, so
    // no sudo.
    fs::create_directories(folder_ + "/repo/deploy");
    fs::create_directories(folder_ + "/bin");
    fs::copy(ROBOSTRESS_SOURCE_DIR "/run", folder_ + "/repo/run");
    fs::copy(ROBOSTRESS_SOURCE_DIR "/deploy/packages.txt", folder_ + "/repo/deploy/packages.txt");
    for (const char* tool :
         {"bash", "sed", "awk", "nproc", "env", "dirname", "cat", "mkdir", "chmod"}) {
      fs::create_symlink(absl::StrCat("/usr/bin/", tool), absl::StrCat(folder_, "/bin/", tool));
    }
    Tool("dpkg-query", "[ \"$INSTALLED\" = all ] && echo 'ii ' && exit 0; exit 1");
    Tool("apt-get", absl::StrCat("echo \"apt-get $DEBIAN_FRONTEND $*\" >> '", folder_,
                                 "/calls'; exit ${APT_EXIT:-0}"));
    // Configures and builds: leaves a build.ninja and a program, as cmake does.
    Tool("cmake",
         absl::StrCat("echo \"cmake $*\" >> '", folder_,
                      "/calls'; mkdir -p build/release/bin; echo > build/release/build.ninja; ",
                      "printf '#!/usr/bin/bash\\necho program \"$@\"\\n' > "
                      "build/release/bin/robostress; chmod +x build/release/bin/robostress"));
    Tool("ctest", absl::StrCat("echo \"ctest $*\" >> '", folder_, "/calls'"));
    chmod(folder_.c_str(), 0777);
  }

  void Tool(const std::string& name, const std::string& script) {
    const std::string path = absl::StrCat(folder_, "/bin/", name);
    ASSERT_TRUE(WriteFileAtomically(path, absl::StrCat("#!/usr/bin/bash\n", script, "\n")).ok());
    chmod(path.c_str(), 0755);
  }

  int Run(const std::string& arguments, const std::string& environment,
          const std::string& as = "") {
    const std::string command =
        absl::StrCat(as, " /usr/bin/env -i PATH='", folder_, "/bin' ", environment, " '", folder_,
                     "/repo/run' ", arguments, " > '", folder_, "/output' 2>&1");
    const int status = std::system(command.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string output() const { return *ReadFile(folder_ + "/output"); }
  std::string calls() const { return ReadFile(folder_ + "/calls").value_or(""); }

  std::string folder_;
};

TEST_F(RunScript, ExplainsItselfWithoutDoingAnything) {
  EXPECT_EQ(Run("", ""), 0);
  EXPECT_THAT(output(), HasSubstr("./run bench"));
  EXPECT_EQ(Run("--help", ""), 0);
  EXPECT_THAT(output(), HasSubstr("Examples"));
  EXPECT_EQ(calls(), "");
}

TEST_F(RunScript, RootInstallsWhatIsMissingWithoutQuestions) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root";
  EXPECT_EQ(Run("build", ""), 0) << output();
  EXPECT_THAT(calls(), HasSubstr("apt-get noninteractive update"));
  EXPECT_THAT(
      calls(),
      HasSubstr("apt-get noninteractive install -q -y --no-install-recommends build-essential"));
  EXPECT_THAT(calls(), HasSubstr("libtorch-dev"));
  EXPECT_THAT(calls(), Not(HasSubstr("#")));
}

TEST_F(RunScript, SecondRunInstallsAndConfiguresNothing) {
  EXPECT_EQ(Run("build", "INSTALLED=all"), 0) << output();
  EXPECT_THAT(calls(), Not(HasSubstr("apt-get")));
  EXPECT_THAT(calls(), HasSubstr("cmake --preset release"));
  fs::remove(folder_ + "/calls");
  EXPECT_EQ(Run("build", "INSTALLED=all"), 0) << output();
  EXPECT_THAT(calls(), Not(HasSubstr("cmake --preset")));
  EXPECT_THAT(calls(), HasSubstr("cmake --build --preset release"));
}

TEST_F(RunScript, WithoutRootOrSudoItPrintsThePackagesAndStops) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  EXPECT_EQ(Run("bench", "", "setpriv --reuid=65534 --regid=65534 --clear-groups"), 1) << output();
  EXPECT_THAT(output(), HasSubstr("neither root nor sudo"));
  EXPECT_THAT(output(), HasSubstr("libmujoco-dev"));
  EXPECT_EQ(calls(), "");
}

TEST_F(RunScript, WithoutRootItUsesSudo) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root to become another user";
  Tool("sudo", absl::StrCat("echo sudo >> '", folder_, "/calls'; exec \"$@\""));
  chmod((folder_ + "/repo").c_str(), 0777);
  EXPECT_EQ(Run("build", "", "setpriv --reuid=65534 --regid=65534 --clear-groups"), 0) << output();
  EXPECT_THAT(calls(), HasSubstr("sudo\napt-get noninteractive update"));
}

TEST_F(RunScript, FailedInstallationStopsBeforeTheBuild) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root";
  EXPECT_EQ(Run("build", "APT_EXIT=100"), 1);
  EXPECT_THAT(output(), HasSubstr("apt-get update failed"));
  EXPECT_THAT(calls(), Not(HasSubstr("cmake")));
}

TEST_F(RunScript, PassesBenchAndOtherCommandsOn) {
  EXPECT_EQ(Run("bench --tasks 2", "INSTALLED=all"), 0) << output();
  EXPECT_THAT(output(), HasSubstr("program sweep --quick --tasks 2"));
  EXPECT_EQ(Run("report 'a b'", "INSTALLED=all"), 0) << output();
  EXPECT_THAT(output(), HasSubstr("program report a b"));
  EXPECT_EQ(Run("test -R floors", "INSTALLED=all"), 0) << output();
  EXPECT_THAT(calls(), HasSubstr("ctest --preset release --parallel"));
  EXPECT_THAT(calls(), HasSubstr("-R floors"));
}

}  // namespace
}  // namespace robostress
