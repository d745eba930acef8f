#pragma once

#include <sys/wait.h>

#include <cstdio>
#include <string>
#include <utility>

// Runs a program to its end through the shell; output of both streams and the exit code.
inline std::pair<std::string, int> RunProgram(const std::string& program,
                                              const std::string& arguments) {
  FILE* pipe = popen((program + " " + arguments + " 2>&1").c_str(), "r");
  std::string output;
  char buffer[4096];
  while (const size_t n = fread(buffer, 1, sizeof buffer, pipe)) output.append(buffer, n);
  return {output, WEXITSTATUS(pclose(pipe))};
}
