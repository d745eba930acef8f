#pragma once

#include <cstdio>
#include <optional>
#include <string>
#include <type_traits>

#include "absl/status/statusor.h"
#include "common/command_line.h"

namespace robostress {

inline constexpr int kFailed = 1;
inline constexpr int kWrongCommand = 2;

// Alone on a command line, it makes a program print its options as data (common/option_table.h).
inline constexpr char kOptionTableFlag[] = "--option-table";

// Adds what every program understands (--version, kOptionTableFlag) and parses; the exit code where
// the program shall end: help or the like was asked for, or the command line is wrong.
std::optional<int> ParseCommandLine(cli::App& app, int argc, char** argv);

// How a program's main ends. Parses the command line and runs; `run` returns an exit code, an
// absl::Status or an absl::StatusOr of an exit code. An error is said on standard error as
// "NAME: message", NAME being the app's.
// Exit codes: 0 done, or help or the version was asked for; 2 the command line is wrong; after an
// error `code_of(status)`, which is 1 unless given.
template <class Run>
int RunMain(
    cli::App& app, int argc, char** argv, Run run,
    int (*code_of)(const absl::Status&) = [](const absl::Status&) { return kFailed; }) {
  if (const std::optional<int> code = ParseCommandLine(app, argc, argv)) return *code;
  using Result = std::invoke_result_t<Run>;
  absl::StatusOr<int> code = 0;
  if constexpr (std::is_same_v<Result, absl::Status>) {
    if (absl::Status status = run(); !status.ok()) code = std::move(status);
  } else {
    code = run();
  }
  if (code.ok()) return *code;
  const std::string message(code.status().message());
  std::fprintf(stderr, "%s: %s\n", app.name().c_str(),
               message.empty() ? code.status().ToString().c_str() : message.c_str());
  return code_of(code.status());
}

}  // namespace robostress
