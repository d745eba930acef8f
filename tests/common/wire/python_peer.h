#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"

namespace robostress {

// A Python program that serves on a port of this machine, whose number is the first line that it
// prints; ended with this.
class PythonPeer {
 public:
  // `python` is the one that knows its packages.
  PythonPeer(const std::string& python, std::vector<std::string> arguments) {
    int ends[2];
    EXPECT_EQ(pipe(ends), 0);
    child_ = fork();
    if (child_ == 0) {
      dup2(ends[1], STDOUT_FILENO);
      dup2(open("/dev/null", O_WRONLY), STDERR_FILENO);
      arguments.insert(arguments.begin(), python);
      std::vector<char*> argv;
      for (std::string& argument : arguments) argv.push_back(argument.data());
      argv.push_back(nullptr);
      execv(argv[0], argv.data());
      _exit(127);
    }
    close(ends[1]);
    for (char c; read(ends[0], &c, 1) == 1 && c != '\n';) port_ += c;
    close(ends[0]);
    EXPECT_FALSE(port_.empty()) << "it ended before it served";
  }
  ~PythonPeer() {
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
  }
  PythonPeer(const PythonPeer&) = delete;
  PythonPeer& operator=(const PythonPeer&) = delete;

  const std::string& port() const { return port_; }
  std::string url() const { return absl::StrCat("ws://127.0.0.1:", port_); }

 private:
  pid_t child_ = 0;
  std::string port_;
};

}  // namespace robostress
