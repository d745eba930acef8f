// A recording of ROS 2 in an MCAP file: its records, chunks, schemas and messages.
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "common/recordings/recording.h"
#include "tests/fuzz/fuzz_check.h"

namespace robostress {
namespace {

// Checks what every visitor is promised.
class CheckingVisitor : public RecordingVisitor {
 public:
  void OnChannel(size_t channel, const RecordedChannel&) override {
    FuzzCheck(channel == channels_++, "a channel out of turn");
  }
  void OnSignal(size_t signal, const RecordedSignal& description) override {
    FuzzCheck(signal == signals_++, "a signal out of turn");
    FuzzCheck(description.channel < channels_, "a signal of no channel");
  }
  void OnEpisode(const std::string&) override {}
  void OnNote(const std::string& note) override { FuzzCheck(!note.empty(), "an empty note"); }
  absl::Status OnRow(const JointRow& row) override {
    FuzzCheck(row.channel < channels_, "a row of no channel");
    FuzzCheck(row.log_ns >= 0 && row.log_ns <= int64_t{1} << 62, "a time beyond the last");
    FuzzCheck(std::abs(static_cast<double>(row.stamp_ns)) <= 0x1p62, "a stamp beyond the last");
    for (const SignalValue& value : row.values)
      FuzzCheck(value.signal < signals_, "a value of no signal");
    return absl::OkStatus();
  }

 private:
  size_t channels_ = 0, signals_ = 0;
};

}  // namespace
}  // namespace robostress

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  static const auto& path = *new std::string(
      (std::filesystem::temp_directory_path() / absl::StrCat("fuzz_", getpid(), ".mcap")).string());
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  CheckingVisitor visitor;
  const absl::Status status = ReadRecording(path, {}, &visitor);
  if (!status.ok()) CheckRefusal(status, path);
  unlink(path.c_str());
  return 0;
}
