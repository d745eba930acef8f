#include "robot_client/operator_console.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <csignal>
#include <string>

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Standard input is the reading end of a pipe, or of a terminal, that the test types into.
class Input {
 public:
  explicit Input(bool terminal) : before_(dup(STDIN_FILENO)) {
    int ends[2];
    if (terminal) {
      EXPECT_EQ(openpty(&ends[1], &ends[0], nullptr, nullptr, nullptr), 0);
    } else {
      EXPECT_EQ(pipe(ends), 0);
    }
    typed_ = ends[1];
    dup2(ends[0], STDIN_FILENO);
    close(ends[0]);
  }
  ~Input() {
    Close();
    dup2(before_, STDIN_FILENO);
    close(before_);
  }
  void Type(const std::string& text) {
    ASSERT_EQ(write(typed_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }
  void Close() {
    if (typed_ >= 0) close(typed_);
    typed_ = -1;
  }

 private:
  const int before_;
  int typed_ = -1;
};

constexpr int kWait_ms = 2000, kNothing_ms = 20;

OperatorCommand NextOf(OperatorConsole& console, bool busy = false) {
  const auto order = console.Next(kWait_ms, busy);
  EXPECT_TRUE(order.has_value());
  return order.value_or(OperatorOrder{OperatorCommand::kQuitLimp}).command;
}

TEST(OperatorConsole, AtATerminalTheEndOfInputHoldsAndEnterGoesOnHolding) {
  Input input(/*terminal=*/true);
  OperatorConsole console;
  input.Type("home\n");
  EXPECT_EQ(NextOf(console), OperatorCommand::kHome);
  for (int again = 0; again < 2; ++again) {
    input.Type("\x04");  // Ctrl-D
    EXPECT_EQ(NextOf(console, /*busy=*/true), OperatorCommand::kHold);
    EXPECT_THAT(console.TakeComplaint(), HasSubstr("Enter goes on stopping it"));
    input.Type("\n");
    EXPECT_EQ(NextOf(console, /*busy=*/true), OperatorCommand::kHold);
    EXPECT_THAT(console.TakeComplaint(), IsEmpty());
  }
  EXPECT_FALSE(console.input_ended());
}

TEST(OperatorConsole, AClosedTerminalHoldsOnce) {
  Input input(/*terminal=*/true);
  OperatorConsole console;
  input.Type("home\n");
  EXPECT_EQ(NextOf(console), OperatorCommand::kHome);
  input.Close();
  EXPECT_EQ(NextOf(console, /*busy=*/true), OperatorCommand::kHold);
  EXPECT_TRUE(console.input_ended());
  EXPECT_FALSE(console.Next(kNothing_ms));
}

TEST(OperatorConsole, APipeThatEndsHoldsOnceItsLinesWereObeyed) {
  Input input(/*terminal=*/false);
  OperatorConsole console;
  input.Type("enable\nhome\n");
  EXPECT_EQ(NextOf(console), OperatorCommand::kEnable);
  input.Close();
  EXPECT_FALSE(console.Next(kNothing_ms, /*busy=*/true)) << "home waits for enable";
  EXPECT_EQ(NextOf(console), OperatorCommand::kHome);
  EXPECT_THAT(console.TakeComplaint(), IsEmpty());
  EXPECT_EQ(NextOf(console, /*busy=*/true), OperatorCommand::kHold) << "nobody can press Enter";
  EXPECT_THAT(console.TakeComplaint(), HasSubstr("kill -TERM " + std::to_string(getpid())));
  EXPECT_FALSE(console.Next(kNothing_ms));
}

TEST(OperatorConsole, AScriptThatQuitsIsNotHeldBefore) {
  Input input(/*terminal=*/false);
  OperatorConsole console;
  input.Type("home\nquit\n");
  input.Close();
  EXPECT_EQ(NextOf(console), OperatorCommand::kHome);
  EXPECT_FALSE(console.Next(kNothing_ms, /*busy=*/true));
  EXPECT_EQ(NextOf(console), OperatorCommand::kQuit);
}

TEST(OperatorConsole, AnInputThatNobodyEverTypedIntoHoldsNothing) {
  Input input(/*terminal=*/false);
  OperatorConsole console;
  input.Close();
  EXPECT_FALSE(console.Next(kNothing_ms));
  EXPECT_FALSE(console.Next(kNothing_ms));
  EXPECT_TRUE(console.input_ended());
}

// A terminal in the background, for one, whose flags another process has changed: poll says that
// there is something, and another reader was faster.
TEST(OperatorConsole, WhatIsNotThereYetIsNoEnd) {
  Input input(/*terminal=*/true);
  OperatorConsole console;
  fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
  EXPECT_FALSE(console.Next(kNothing_ms));
  input.Type("home\n");
  EXPECT_EQ(NextOf(console), OperatorCommand::kHome);
  EXPECT_FALSE(console.input_ended());
}

}  // namespace
}  // namespace robostress
