#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "calibration/data/recording_plan.h"

namespace robostress::calibration {

// One row of a log: what a plan's joints read at a time.
struct PlannedRow {
  int64_t at_ns = 0;
  std::vector<double> q, dq, tau, command;  // [joints of the plan]; as recorded
};

// Writes rows as CSV logs, a file per piece, in the order of time and in constant memory. A piece
// that is short or in which a joint stands still leaves no file.
class PieceWriter {
 public:
  PieceWriter(const RecordingPlan& plan, std::string folder)
      : plan_(plan), folder_(std::move(folder)) {}
  ~PieceWriter();
  PieceWriter(const PieceWriter&) = delete;
  PieceWriter& operator=(const PieceWriter&) = delete;

  // UNAVAILABLE where the disk is full.
  absl::Status Add(const PlannedRow& row);
  // The piece in hand ends here.
  absl::Status End();

  const std::vector<std::string>& files() const { return files_; }  // in the folder
  double seconds() const { return seconds_; }
  double seconds_left_out() const { return seconds_left_out_; }
  int64_t late_rows() const { return late_rows_; }

 private:
  absl::Status Begin(const PlannedRow& row);
  absl::Status Failed() const;

  const RecordingPlan& plan_;
  const std::string folder_;
  std::FILE* file_ = nullptr;
  std::string path_;
  int64_t begin_ns_ = 0, last_ns_ = 0, rows_ = 0, late_rows_ = 0;
  std::vector<double> low_, high_;
  std::vector<std::string> files_;
  double seconds_ = 0, seconds_left_out_ = 0;
};

}  // namespace robostress::calibration
