// The tables of docs/results/scenario-parameters.md are what `robostress scenarios --markdown`
// prints.
#include <gtest/gtest.h>

#include <cstdio>
#include <string>

#include "common/atomic_file.h"

namespace robostress {
namespace {

std::string OutputOf(const std::string& command) {
  std::string output;
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return output;
  char buffer[4096];
  for (size_t n; (n = fread(buffer, 1, sizeof(buffer), pipe)) > 0;) output.append(buffer, n);
  EXPECT_EQ(pclose(pipe), 0) << command;
  return output;
}

TEST(JointErrorReadme, ItsTablesAreWhatTheProgramPrints) {
  const std::string begin = "<!-- robostress scenarios --markdown -->\n", end = "<!-- end -->";
  const absl::StatusOr<std::string> readme =
      ReadFile(ROBOSTRESS_SOURCE_DIR "/docs/results/scenario-parameters.md");
  ASSERT_TRUE(readme.ok()) << readme.status();
  const size_t from = readme->find(begin), to = readme->find(end, from);
  ASSERT_NE(from, std::string::npos);
  ASSERT_NE(to, std::string::npos);
  EXPECT_EQ(readme->substr(from + begin.size(), to - from - begin.size()),
            OutputOf(BIN_DIR "/robostress-scenarios --markdown"))
      << "write the program's output between the two marks of that page";
}

}  // namespace
}  // namespace robostress
