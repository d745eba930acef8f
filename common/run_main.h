#pragma once

#include <cstdio>
#include <string>
#include <type_traits>

#include "CLI/CLI.hpp"
#include "absl/status/statusor.h"

namespace robostress {

inline constexpr int kFailed = 1;
inline constexpr int kWrongCommand = 2;

// How a program's main ends. Parses the command line and runs; `run` returns an exit code, an
// absl::Status or an absl::StatusOr of an exit code. An error is said on standard error as
// "NAME: message", NAME being the app's.
// Exit codes: 0 done, or help was asked for; 2 the command line is wrong; after an error
// `code_of(status)`, which is 1 unless given.
template <class Run>
int RunMain(
    CLI::App& app, int argc, char** argv, Run run,
    int (*code_of)(const absl::Status&) = [](const absl::Status&) { return kFailed; }) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kWrongCommand;
  }
  using Result = std::invoke_result_t<Run>;
  absl::StatusOr<int> code = 0;
  if constexpr (std::is_same_v<Result, absl::Status>) {
    if (absl::Status status = run(); !status.ok()) code = std::move(status);
  } else {
    code = run();
  }
  if (code.ok()) return *code;
  const std::string message(code.status().message());
  std::fprintf(stderr, "%s: %s\n", app.get_name().c_str(),
               message.empty() ? code.status().ToString().c_str() : message.c_str());
  return code_of(code.status());
}

}  // namespace robostress
