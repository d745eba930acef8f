// Recordings that other people's libraries wrote (PyPI's mcap, rosbags, pyarrow, h5py) read as they
// say: every number to the bit. Skipped, with the reason, without python3-venv or the network.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/recordings/recording.h"
#include "nlohmann/json.hpp"
#include "tests/common/recordings/collected_rows.h"
#include "tests/common/recordings/peers_environment.h"
#include "tests/run_program.h"

namespace robostress::recording_test {
namespace {

namespace fs = std::filesystem;

// First difference, or empty.
std::string Difference(const nlohmann::json& expected, const CollectedRows& found) {
  if (expected.size() != found.rows.size())
    return absl::StrCat(found.rows.size(), " rows, not ", expected.size());
  for (size_t i = 0; i < expected.size(); ++i) {
    const CollectedRows::Row& row = found.rows[i];
    if (row.stamp_ns != expected[i][0].get<int64_t>())
      return absl::StrCat("row ", i, ": stamp ", row.stamp_ns, ", not ", expected[i][0].dump());
    if (row.values != expected[i][1].get<std::map<std::string, double>>())
      return absl::StrCat("row ", i, ": ", nlohmann::json(row.values).dump(), ", not ",
                          expected[i][1].dump());
  }
  return "";
}

TEST(RecordingPeersTest, ReadsWhatOthersWroteToTheBit) {
  const std::string& failure = RecordingPeersFailure();
  if (!failure.empty()) GTEST_SKIP() << failure;
  const fs::path folder = fs::path(testing::TempDir()) / "recording_peers";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const auto [output, code] = RunProgram("nice -n 19 " RECORDINGS_VENV
                                         "/bin/python " RECORDINGS_TESTS "/write_recordings.py",
                                         folder.string());
  ASSERT_EQ(code, 0) << output;
  std::ifstream file(folder / "expected.json");
  const auto expected = nlohmann::json::parse(file);
  EXPECT_EQ(expected.size(), 27);
  for (const auto& [name, rows] : expected.items()) {
    CollectedRows found;
    const absl::Status status = ReadRecording((folder / name).string(), {}, &found);
    ASSERT_TRUE(status.ok()) << name << ": " << status;
    EXPECT_EQ(Difference(rows, found), "") << name;
  }
  fs::remove_all(folder);
}

}  // namespace
}  // namespace robostress::recording_test
