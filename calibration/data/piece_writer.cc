#include "calibration/data/piece_writer.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"

namespace robostress::calibration {
PieceWriter::~PieceWriter() {
  if (file_ == nullptr) return;
  std::fclose(file_);
  unlink(path_.c_str());
}

absl::Status PieceWriter::Failed() const {
  return absl::UnavailableError(absl::StrCat("cannot write '", path_, "': ", std::strerror(errno),
                                             "; free some space and run again"));
}

absl::Status PieceWriter::Begin(const PlannedRow& row) {
  path_ =
      (std::filesystem::path(folder_) / absl::StrCat("log_", files_.size(), ".csv.part")).string();
  file_ = std::fopen(path_.c_str(), "we");
  if (file_ == nullptr) return Failed();
  std::string header = "t";
  for (const PlannedJoint& joint : plan_.joints) {
    absl::StrAppend(&header, ",q_", joint.name);
    if (joint.dq >= 0) absl::StrAppend(&header, ",dq_", joint.name);
    if (joint.tau >= 0) absl::StrAppend(&header, ",tau_", joint.name);
    if (joint.command >= 0) absl::StrAppend(&header, ",q_cmd_", joint.name);
  }
  header += "\n";
  if (std::fwrite(header.data(), 1, header.size(), file_) != header.size()) return Failed();
  begin_ns_ = row.at_ns;
  rows_ = 0;
  low_ = high_ = row.q;
  return absl::OkStatus();
}

absl::Status PieceWriter::Add(const PlannedRow& row) {
  const double since_last = static_cast<double>(row.at_ns - last_ns_) * 1e-9;
  const bool breaks =
      std::abs(since_last) > kGapRows * plan_.dt;  // forward, or a clock that was set
  if (file_ != nullptr && since_last <= 0 && !breaks) {
    ++late_rows_;
    return absl::OkStatus();
  }
  const double piece = static_cast<double>(row.at_ns - begin_ns_) * 1e-9;
  if (file_ != nullptr && (breaks || piece > plan_.longest_piece_s)) RS_RETURN_IF_ERROR(End());
  if (file_ == nullptr) RS_RETURN_IF_ERROR(Begin(row));
  std::string line;
  absl::StrAppendFormat(&line, "%.9f", static_cast<double>(row.at_ns - begin_ns_) * 1e-9);
  for (size_t j = 0; j < plan_.joints.size(); ++j) {
    const double to_rad = plan_.joints[j].to_rad;
    absl::StrAppendFormat(&line, ",%.17g", row.q[j] * to_rad);
    if (plan_.joints[j].dq >= 0) absl::StrAppendFormat(&line, ",%.17g", row.dq[j] * to_rad);
    if (plan_.joints[j].tau >= 0) absl::StrAppendFormat(&line, ",%.17g", row.tau[j]);
    if (plan_.joints[j].command >= 0)
      absl::StrAppendFormat(&line, ",%.17g", row.command[j] * to_rad);
    low_[j] = std::min(low_[j], row.q[j]);
    high_[j] = std::max(high_[j], row.q[j]);
  }
  line += "\n";
  if (std::fwrite(line.data(), 1, line.size(), file_) != line.size()) return Failed();
  last_ns_ = row.at_ns;
  ++rows_;
  return absl::OkStatus();
}

absl::Status PieceWriter::End() {
  if (file_ == nullptr) return absl::OkStatus();
  bool kept = rows_ >= kLeastRows;
  for (size_t j = 0; j < low_.size(); ++j)
    kept = kept && (high_[j] - low_[j]) * plan_.joints[j].to_rad >= kStill;
  const double seconds = static_cast<double>(last_ns_ - begin_ns_) * 1e-9;
  if (!kept) {  // before anything waits for the disk: there may be many
    std::fclose(std::exchange(file_, nullptr));
    unlink(path_.c_str());
    seconds_left_out_ += seconds;
    return absl::OkStatus();
  }
  const bool written = std::fflush(file_) == 0 && fsync(fileno(file_)) == 0;
  const bool closed = std::fclose(std::exchange(file_, nullptr)) == 0;
  if (!written || !closed) {
    const absl::Status failed = Failed();
    unlink(path_.c_str());
    return failed;
  }
  const std::string name = absl::StrCat("log_", files_.size(), ".csv");
  const std::string final_path = (std::filesystem::path(folder_) / name).string();
  if (std::rename(path_.c_str(), final_path.c_str()) != 0) return Failed();
  files_.push_back(name);
  seconds_ += seconds;
  return absl::OkStatus();
}

}  // namespace robostress::calibration
