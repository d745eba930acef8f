#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"

namespace robostress {

// `robostress serve` with nano's graph and random weights, where no policy is named, in a folder of
// its own; terminated, and its exit code checked, at the end.
class ServeProcess {
 public:
  ServeProcess(const std::string& program, std::vector<std::string> arguments)
      : folder_(std::filesystem::path(::testing::TempDir()) /
                absl::StrCat("serve-", getpid(), "-", ++count_)) {
    std::filesystem::create_directories(folder_);
    std::vector<std::string> common{program, "--threads", "1", "--ports-file", Path("ports")};
    if (std::find(arguments.begin(), arguments.end(), "--policy") == arguments.end())
      common.insert(common.end(), {"--policy", "nano:random"});
    arguments.insert(arguments.begin(), common.begin(), common.end());
    child_ = fork();
    if (child_ == 0) {
      if (freopen(Path("log").c_str(), "w", stderr) == nullptr) _exit(126);
      std::vector<char*> argv;
      for (std::string& argument : arguments) argv.push_back(argument.data());
      argv.push_back(nullptr);
      execv(argv[0], argv.data());
      _exit(127);
    }
    for (int i = 0; i < 1200 && !std::filesystem::exists(Path("ports")); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    ports_ = YAML::LoadFile(Path("ports"));  // published whole, so any content is complete
  }
  ~ServeProcess() {
    if (child_ > 0) End(SIGTERM);
    std::filesystem::remove_all(folder_);
  }

  pid_t pid() const { return child_; }
  int port(const char* name) const { return ports_[name].as<int>(); }
  std::string Address(const char* name) const { return absl::StrCat("127.0.0.1:", port(name)); }
  std::string Path(const std::string& name) const { return (folder_ / name).string(); }
  // Sends the signal (0: none) and waits for the end, which must be an orderly one.
  void End(int signal) {
    if (signal != 0) kill(child_, signal);
    int status = 0;
    waitpid(child_, &status, 0);
    EXPECT_TRUE(WIFEXITED(status));
    EXPECT_EQ(WEXITSTATUS(status), 0);
    child_ = 0;
  }

 private:
  static inline int count_ = 0;
  const std::filesystem::path folder_;
  pid_t child_ = 0;
  YAML::Node ports_;
};

}  // namespace robostress
