#include "server/proxy/proxy_record.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
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
  const std::string file = folder + "/residuals.csv";
  record->residuals_ = std::fopen(file.c_str(), "wx");
  if (record->residuals_ == nullptr) {
    const int why = errno;
    if (why == EEXIST) {
      return absl::AlreadyExistsError(
          absl::StrCat(file, " is there: another run's record; give another --out"));
    }
    return absl::UnavailableError(absl::StrCat(file, ": ", std::strerror(why)));
  }
  std::string header = "t_s,client,episode,chunk,outcome,doubt";
  AppendNames("residual_", record->axes_, header);
  AppendNames("correction_", record->axes_, header);
  record->Line(record->residuals_, header);
  record->thread_ = std::thread([record = record.get()] { record->Work(); });
  return record;
}

ProxyRecord::~ProxyRecord() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  if (thread_.joinable()) thread_.join();
  if (residuals_ != nullptr) std::fclose(residuals_);
  for (const auto& [client, stretch] : stretches_) {
    if (stretch.file != nullptr) std::fclose(stretch.file);
  }
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
    std::fflush(residuals_);
    for (auto& [client, stretch] : stretches_) {
      if (stretch.file != nullptr) std::fflush(stretch.file);
    }
    if (last) return;
  }
}

void ProxyRecord::Line(std::FILE* file, const std::string& line) {
  if (std::fprintf(file, "%s\n", line.c_str()) >= 0) return;
  const std::string why = std::strerror(errno);
  absl::MutexLock lock(&mu_);
  if (!failure_.empty()) return;
  failure_ = absl::StrCat(folder_, ": ", why);
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
    return Line(residuals_, line);
  }
  const auto* rows = std::get_if<std::vector<JointRow>>(&entry.what);
  if (rows == nullptr) {
    const auto found = stretches_.find(entry.client);
    if (found == stretches_.end()) return;
    if (found->second.file != nullptr) std::fclose(found->second.file);
    stretches_.erase(found);
    return;
  }
  Stretch& stretch = stretches_[entry.client];
  for (const JointRow& row : *rows) {
    if (row.stretch != stretch.number) {
      if (stretch.file != nullptr) std::fclose(stretch.file);
      stretch = {row.stretch, 0, nullptr};
      if (files_ >= kFiles) continue;
      const std::string file =
          absl::StrCat(folder_, "/joints-", entry.client, "-", row.stretch, ".csv");
      stretch.file = std::fopen(file.c_str(), "wx");
      if (stretch.file == nullptr) continue;
      ++files_;
      std::string header = "t";
      AppendNames("q_", axes_, header);
      AppendNames("q_cmd_", axes_, header);
      Line(stretch.file, header);
    }
    if (stretch.file == nullptr) continue;
    std::string line = absl::StrFormat("%.9g", static_cast<double>(stretch.rows++) / rate_hz_);
    AppendCells(row.q, axes_.size(), line);
    AppendCells(row.q_cmd, axes_.size(), line);
    Line(stretch.file, line);
  }
}

}  // namespace robostress
