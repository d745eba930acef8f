#pragma once

#include <map>
#include <string>
#include <vector>

#include "common/recordings/row_stream.h"

namespace robostress::recording_test {

// Everything of a recording, in memory.
class CollectedRows : public RecordingVisitor {
 public:
  struct Row {
    std::string channel;
    int64_t log_ns = 0, stamp_ns = 0;
    bool stamped = false;
    std::map<std::string, double> values;  // "position elbow"
  };
  void OnChannel(size_t, const RecordedChannel& description) override {
    channels.push_back(description);
  }
  void OnSignal(size_t, const RecordedSignal& description) override {
    signals.push_back(description);
  }
  void OnEpisode(const std::string& name) override { episodes.push_back(name); }
  void OnNote(const std::string& note) override { notes.push_back(note); }
  absl::Status OnRow(const JointRow& row) override {
    Row kept{channels[row.channel].name, row.log_ns, row.stamp_ns, row.stamped, {}};
    for (const SignalValue& value : row.values) {
      const RecordedSignal& signal = signals[value.signal];
      kept.values[std::string(QuantityName(signal.quantity)) + " " + signal.joint] = value.value;
    }
    rows.push_back(std::move(kept));
    return absl::OkStatus();
  }

  std::vector<RecordedChannel> channels;
  std::vector<RecordedSignal> signals;
  std::vector<std::string> episodes, notes;
  std::vector<Row> rows;
};

}  // namespace robostress::recording_test
