#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "calibration/data/piece_writer.h"
#include "common/recordings/row_stream.h"

namespace robostress::calibration {

// Puts beside every row of positions the commands that held at its time, in constant memory.
// Messages of two topics come in the order in which they were recorded, which is not that of their
// stamps, and stamps may be of clocks that differ or are set:
//
// - A command stands by its stamp; by the recorder's time where its topic is one of
//   plan.by_recorder, or where its stamp alone is more than a second from those of the positions.
// - A row that is more than five rows from the one before waits for the next. Where that goes on
//   from it, there was a gap or a clock was set; where it goes on from the one before, the row's
//   stamp was wrong, and it is left out. After a step back no command holds until the next.
class RowMerger : public RecordingVisitor {
 public:
  RowMerger(const RecordingPlan& plan, PieceWriter* writer);

  void OnChannel(size_t, const RecordedChannel&) override {}
  void OnSignal(size_t, const RecordedSignal&) override {}
  void OnNote(const std::string&) override {}
  void OnEpisode(const std::string&) override;
  absl::Status OnRow(const JointRow& row) override;
  // The recording, or an episode of it, ends here.
  absl::Status Finish();

  int64_t bad_rows() const { return bad_rows_; }
  int64_t rows_without_command() const { return rows_without_command_; }
  int64_t wrong_stamps() const { return wrong_stamps_; }

 private:
  struct Waiting {
    PlannedRow row;
    bool by_log = false;
    int64_t log_ns = 0, stamp_ns = 0;
  };

  absl::Status TakePositions(Waiting row);
  absl::Status Accept(Waiting row);
  bool IsOfAnotherClock(const JointRow& row) const;
  // What was recorded until then is not compared with what comes.
  absl::Status Settle(int64_t until_log_ns, bool back);
  absl::Status Emit(int64_t until_log_ns);
  // The commands up to the row's time become those that hold.
  void Hold(const Waiting& row);
  void TakeFirstCommand();
  absl::Status Write(PlannedRow row);

  const RecordingPlan& plan_;
  PieceWriter* const writer_;
  const int64_t gap_ns_;
  // By signal: joints and what of them.
  std::map<size_t, std::vector<std::pair<size_t, std::vector<double> PlannedRow::*>>> places_;
  std::deque<Waiting> rows_, commands_;
  std::vector<double> held_;
  std::optional<Waiting> doubted_;       // a row that waits for the next
  std::optional<int64_t> last_at_;       // of the rows taken
  std::optional<int64_t> last_log_;      // the same
  std::optional<int64_t> ahead_of_log_;  // the last position's stamp minus log
  std::optional<int64_t> newest_ns_;     // log
  int64_t bad_rows_ = 0, rows_without_command_ = 0, wrong_stamps_ = 0;
  absl::Status status_;
};

}  // namespace robostress::calibration
