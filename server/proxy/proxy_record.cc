#include "server/proxy/proxy_record.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

double NowSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// ",x,y" or as many empty cells.
void AppendCells(const Eigen::VectorXd& values, size_t count, std::string& line) {
  for (size_t i = 0; i < count; ++i) {
    absl::StrAppend(&line, ",");
    if (i < static_cast<size_t>(values.size()))
      absl::StrAppendFormat(&line, "%.9g", values[static_cast<Eigen::Index>(i)]);
  }
}

void AppendNames(const char* what, const std::vector<std::string>& axes, std::string& line) {
  for (const std::string& axis : axes) absl::StrAppend(&line, ",", what, axis);
}

}  // namespace

ProxyRecord::ProxyRecord(std::string folder, const ArmProfile& profile)
    : folder_(std::move(folder)),
      axes_(profile.axes()),
      rate_hz_(profile.rate_hz),
      start_s_(NowSeconds()) {}

absl::StatusOr<std::unique_ptr<ProxyRecord>> ProxyRecord::Create(const std::string& folder,
                                                                 const ArmProfile& profile) {
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  std::unique_ptr<ProxyRecord> record(new ProxyRecord(folder, profile));
  RS_ASSIGN_OR_RETURN(record->residuals_, RowFile::Create(folder + "/residuals.csv"));
  std::string header = "t_s,client,episode,chunk,outcome,doubt";
  AppendNames("residual_", record->axes_, header);
  AppendNames("correction_", record->axes_, header);
  record->residuals_->Add(header);
  RS_RETURN_IF_ERROR(record->residuals_->Flush());
  record->thread_ = std::thread([record = record.get()] { record->Work(); });
  return record;
}

ProxyRecord::~ProxyRecord() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  if (thread_.joinable()) thread_.join();
}

std::string ProxyRecord::failure() const {
  absl::MutexLock lock(&mu_);
  return failure_;
}

void ProxyRecord::Push(Entry entry) {
  absl::MutexLock lock(&mu_);
  if (queue_.size() >= kQueue || !failure_.empty()) {
    ++dropped_;
    return;
  }
  queue_.push_back(std::move(entry));
}

void ProxyRecord::Answer(uint64_t client, const AnswerReport& report) {
  Push({client, Answered{NowSeconds() - start_s_, report}});
}

void ProxyRecord::Joints(uint64_t client, std::vector<JointRow> rows) {
  if (!rows.empty()) Push({client, std::move(rows)});
}

void ProxyRecord::Ended(uint64_t client) { Push({client, std::monostate()}); }

void ProxyRecord::Work() {
  pthread_setname_np(pthread_self(), "proxy-record");
  while (true) {
    std::deque<Entry> entries;
    bool last = false;
    {
      absl::MutexLock lock(&mu_);
      const auto due = [this] {
        mu_.AssertHeld();
        return stopped_ || !queue_.empty();
      };
      mu_.Await(absl::Condition(&due));
      entries.swap(queue_);
      last = stopped_;
    }
    for (const Entry& entry : entries) Write(entry);
    Flush(residuals_.get());
    for (const auto& [client, stretch] : stretches_) Flush(stretch.file.get());
    if (last) return;
  }
}

void ProxyRecord::Flush(RowFile* file) {
  if (file == nullptr) return;
  if (const absl::Status flushed = file->Flush(); !flushed.ok()) Fail(flushed);
}

void ProxyRecord::Fail(const absl::Status& why) {
  absl::MutexLock lock(&mu_);
  if (!failure_.empty()) return;
  failure_ = std::string(why.message());
  spdlog::error("proxy: the record ends: {}; clients are served on", failure_);
}

void ProxyRecord::Write(const Entry& entry) {
  if (const auto* answered = std::get_if<Answered>(&entry.what)) {
    const AnswerReport& report = answered->report;
    std::string line = absl::StrFormat(
        "%.6f,%d,%d,%d,%s,%s", answered->t_s, entry.client, report.episode, report.chunk,
        AnswerOutcomeName(report.outcome), report.doubt ? DoubtName(*report.doubt) : "");
    AppendCells(report.residual, axes_.size(), line);
    AppendCells(report.correction, axes_.size(), line);
    return residuals_->Add(line);
  }
  if (const auto* rows = std::get_if<std::vector<JointRow>>(&entry.what))
    return WriteJoints(entry.client, *rows);
  const auto found = stretches_.find(entry.client);
  if (found == stretches_.end()) return;
  Flush(found->second.file.get());
  stretches_.erase(found);
}

std::unique_ptr<RowFile> ProxyRecord::OpenStretch(uint64_t client, int number) {
  if (files_ >= kFiles) {
    if (files_++ == kFiles) {
      spdlog::warn(
          "proxy: {}: {} files of joints are there, and no more are begun; begin another "
          "--out",
          folder_, kFiles);
    }
    return nullptr;
  }
  auto file = RowFile::Create(absl::StrCat(folder_, "/joints-", client, "-", number, ".csv"));
  if (!file.ok()) {
    Fail(file.status());
    return nullptr;
  }
  ++files_;
  std::string header = "t";
  AppendNames("q_", axes_, header);
  AppendNames("q_cmd_", axes_, header);
  (*file)->Add(header);
  return *std::move(file);
}

void ProxyRecord::WriteJoints(uint64_t client, const std::vector<JointRow>& rows) {
  Stretch& stretch = stretches_[client];
  for (const JointRow& row : rows) {
    if (row.stretch != stretch.number) {
      Flush(stretch.file.get());
      stretch = {row.stretch, 0, OpenStretch(client, row.stretch)};
    }
    if (stretch.file == nullptr) continue;
    std::string line = absl::StrFormat("%.9g", static_cast<double>(stretch.rows++) / rate_hz_);
    AppendCells(row.q, axes_.size(), line);
    AppendCells(row.q_cmd, axes_.size(), line);
    stretch.file->Add(line);
  }
}

}  // namespace robostress
