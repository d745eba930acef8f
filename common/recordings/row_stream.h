#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace robostress {

enum class JointQuantity {
  kPosition,  // measured [rad, or m], where the recording's unit is that
  kVelocity,  // measured [rad/s]
  kEffort,    // measured or estimated [Nm, or whatever the driver puts there]
  kCommand,   // position that was asked of the servo, or of what stands before it (caution)
  kGoal,      // where a trajectory ends: asked of a controller, not of a servo
};
inline constexpr int kJointQuantities = 5;
// "position", "velocity", ...
const char* QuantityName(JointQuantity quantity);

// One topic of a bag, one group of arrays of a dataset.
struct RecordedChannel {
  std::string name, type;
  // What its numbers are not, in a sentence: "a requested action is not a sent command".
  std::string caution;
  std::string unit, unit_because;  // of positions: "rad"; empty: it is not known
  // Where rows have no times of their own, what was taken: "rows at 20 Hz, by control_freq".
  std::string times;
  bool decoded = false;  // whether joints are read from it
};

struct RecordedSignal {
  size_t channel = 0;
  std::string joint;  // "[3]": the recording names none, the place in its array
  JointQuantity quantity = JointQuantity::kPosition;
};

struct SignalValue {
  size_t signal = 0;
  double value = 0;  // as recorded; may be no finite number
};

// One message, or row, of one channel.
struct JointRow {
  size_t channel = 0;
  int64_t log_ns = 0;    // when it was recorded
  int64_t stamp_ns = 0;  // when its sender says it was measured; where it says nothing, log_ns
  bool stamped = false;
  absl::Span<const SignalValue> values;  // empty: of a channel that is not decoded
};

// What takes a recording as it streams by. Numbers of channels and signals count from 0, each is
// announced before its first row.
class RecordingVisitor {
 public:
  virtual ~RecordingVisitor() = default;
  virtual void OnChannel(size_t channel, const RecordedChannel& description) = 0;
  virtual void OnSignal(size_t signal, const RecordedSignal& description) = 0;
  // Time begins anew: the next episode of a dataset.
  virtual void OnEpisode(const std::string& name) = 0;
  virtual absl::Status OnRow(const JointRow& row) = 0;
  // What was repaired or left out, a sentence that names the file.
  virtual void OnNote(const std::string& note) = 0;
};

// Numbers channels and signals for a visitor, and bounds how many there are: names that are made
// up anew in every message would fill the memory.
class RowStream {
 public:
  static constexpr size_t kMostChannels = 4096, kMostSignals = 8192;

  explicit RowStream(RecordingVisitor* visitor) : visitor_(visitor) {}
  absl::StatusOr<size_t> Channel(const RecordedChannel& description);
  // RESOURCE_EXHAUSTED where there are too many.
  absl::StatusOr<size_t> Signal(size_t channel, const std::string& joint, JointQuantity quantity);
  RecordingVisitor& visitor() { return *visitor_; }

 private:
  RecordingVisitor* const visitor_;
  std::map<std::string, size_t> channels_;
  std::map<std::tuple<size_t, JointQuantity, std::string>, size_t> signals_;
};

}  // namespace robostress
