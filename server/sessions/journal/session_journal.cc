#include "server/sessions/journal/session_journal.h"

#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"

namespace robostress {
namespace {

constexpr uint32_t kFormat = 1;
constexpr uint64_t kMaxGeneration = uint64_t{1} << 48;  // a file of a higher one is not ours

std::string FileName(const std::string& folder, const char* kind, uint64_t generation) {
  return absl::StrFormat("%s/%s-%06d", folder, kind, generation);
}

struct Files {
  std::set<uint64_t> journals, snapshots;
};

absl::StatusOr<Files> ListFiles(const std::string& folder) {
  Files files;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    absl::string_view digits = name;
    uint64_t generation = 0;
    const bool journal = absl::ConsumePrefix(&digits, "journal-");
    if (!journal && !absl::ConsumePrefix(&digits, "snapshot-")) continue;
    if (!absl::SimpleAtoi(digits, &generation) || generation > kMaxGeneration) continue;
    (journal ? files.journals : files.snapshots).insert(generation);
  }
  if (error)
    return absl::NotFoundError(absl::StrCat("cannot list '", folder, "': ", error.message()));
  return files;
}

absl::Status ParseRecord(const std::string& path, std::string_view payload,
                         v1::StateRecord& record) {
  if (record.ParseFromArray(payload.data(), static_cast<int>(payload.size())) &&
      record.record_case() != v1::StateRecord::RECORD_NOT_SET)
    return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat(path, ": a record of ", payload.size(),
                   " bytes is of no kind that this server knows; use the version that wrote it"));
}

absl::Status CheckHeader(const std::string& path, const v1::StateRecord& record,
                         uint64_t generation) {
  if (!record.has_header())
    return absl::DataLossError(absl::StrCat(path, ": does not begin with a session's header"));
  if (record.header().format() != kFormat) {
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": has format ", record.header().format(), ", this server reads format ",
                     kFormat, "; use the version that wrote it"));
  }
  if (record.header().generation() != generation) {
    return absl::DataLossError(absl::StrCat(path, ": says it is generation ",
                                            record.header().generation(),
                                            "; it was renamed or copied"));
  }
  return absl::OkStatus();
}

// The records after the header, which is checked and handed to `header`.
absl::StatusOr<RecordExtent> ReadStateFile(const std::string& path, uint64_t generation,
                                           bool may_be_torn, v1::StateHeader& header,
                                           SessionJournal::Take take) {
  bool first = true;
  const auto parse = [&](std::string_view payload) -> absl::Status {
    v1::StateRecord record;
    RS_RETURN_IF_ERROR(ParseRecord(path, payload, record));
    if (!std::exchange(first, false)) return take(record);
    RS_RETURN_IF_ERROR(CheckHeader(path, record, generation));
    header = record.header();
    return absl::OkStatus();
  };
  RS_ASSIGN_OR_RETURN(const RecordExtent extent, ReadRecords(path, may_be_torn, parse));
  return extent;
}

absl::Status ReadSnapshot(const std::string& path, uint64_t generation, v1::StateHeader& header,
                          SessionJournal::Take take) {
  uint64_t records = 1;
  bool ended = false;
  const auto count = [&](const v1::StateRecord& record) -> absl::Status {
    if (record.has_end()) {
      ended = record.end().records() == records;
      return absl::OkStatus();
    }
    ++records;
    return take(record);
  };
  RS_RETURN_IF_ERROR(ReadStateFile(path, generation, false, header, count).status());
  if (!ended)
    return absl::DataLossError(absl::StrCat(path, ": has ", records, " records and no whole end"));
  return absl::OkStatus();
}

}  // namespace

SessionJournal::SessionJournal(std::string folder, const v1::StateHeader& header)
    : folder_(std::move(folder)), header_(std::make_shared<v1::StateHeader>(header)) {
  header_->set_format(kFormat);
}

absl::StatusOr<std::shared_ptr<RecordWriter>> SessionJournal::NewJournal(
    uint64_t generation) const {
  const std::string path = FileName(folder_, "journal", generation);
  RS_ASSIGN_OR_RETURN(std::shared_ptr<RecordWriter> writer, RecordWriter::Create(path));
  v1::StateRecord record;
  *record.mutable_header() = *header_;
  record.mutable_header()->set_generation(generation);
  absl::Status status = writer->Append(record.SerializeAsString());
  if (status.ok()) status = writer->Sync();
  if (status.ok()) status = SyncDirectory(folder_);
  if (!status.ok()) {
    ::unlink(path.c_str());
    return status;
  }
  return writer;
}

absl::StatusOr<std::unique_ptr<SessionJournal>> SessionJournal::Create(
    const std::string& folder, const v1::StateHeader& header) {
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  auto journal = std::unique_ptr<SessionJournal>(new SessionJournal(folder, header));
  RS_ASSIGN_OR_RETURN(journal->writer_, journal->NewJournal(0));
  RS_RETURN_IF_ERROR(SyncDirectory(std::filesystem::path(folder).parent_path().string()));
  return journal;
}

absl::StatusOr<v1::StateHeader> SessionJournal::ReadHeader(const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const Files files, ListFiles(folder));
  absl::Status status = absl::NotFoundError(absl::StrCat(folder, ": holds no journal"));
  for (auto generation = files.journals.rbegin(); generation != files.journals.rend();
       ++generation) {
    v1::StateHeader header;
    const auto stop = [](const v1::StateRecord&) { return absl::CancelledError("enough"); };
    status =
        ReadStateFile(FileName(folder, "journal", *generation), *generation, true, header, stop)
            .status();
    if (!header.session_id().empty()) return header;
  }
  return status.ok() ? absl::DataLossError(absl::StrCat(folder, ": its journals have no header"))
                     : status;
}

absl::StatusOr<std::unique_ptr<SessionJournal>> SessionJournal::Recover(
    const std::string& folder, Take begin, Take replay, absl::FunctionRef<void()> restart) {
  RS_ASSIGN_OR_RETURN(Files files, ListFiles(folder));
  v1::StateHeader header;
  uint64_t from = 0;
  while (!files.snapshots.empty()) {
    const uint64_t newest = *files.snapshots.rbegin();
    const absl::Status status =
        ReadSnapshot(FileName(folder, "snapshot", newest), newest, header, begin);
    if (status.ok()) {
      from = newest;
      break;
    }
    if (!absl::IsDataLoss(status)) return status;
    spdlog::warn("{}; the snapshot before it and both journals are used", status.ToString());
    restart();
    files.snapshots.erase(newest);
  }
  if (files.journals.empty())
    return absl::DataLossError(absl::StrCat(folder, ": holds no journal"));
  uint64_t last = *files.journals.rbegin();
  uint64_t older_bytes = 0, older_records = 0;
  RecordExtent extent;
  for (uint64_t generation = from; generation <= last; ++generation) {
    const std::string path = FileName(folder, "journal", generation);
    if (files.journals.count(generation) == 0)
      return absl::DataLossError(absl::StrCat(path, ": is missing; restore it"));
    older_bytes += extent.bytes;
    older_records += extent.records;
    RS_ASSIGN_OR_RETURN(extent, ReadStateFile(path, generation, true, header, replay));
    if (extent.records > 0) continue;
    // Cut off while it was begun: the one before is the last.
    if (generation == from || generation != last)
      return absl::DataLossError(absl::StrCat(path, ": is empty; restore it"));
    ::unlink(path.c_str());
    --last;
    const auto ignore = [](std::string_view) { return absl::OkStatus(); };
    RS_ASSIGN_OR_RETURN(extent, ReadRecords(FileName(folder, "journal", last), true, ignore));
    older_bytes -= extent.bytes;
    older_records -= extent.records;
  }
  auto journal = std::unique_ptr<SessionJournal>(new SessionJournal(folder, header));
  journal->generation_ = last;
  journal->snapshot_ = from;
  journal->older_bytes_ = older_bytes;
  journal->older_records_ = older_records;
  RS_ASSIGN_OR_RETURN(journal->writer_, RecordWriter::Continue(FileName(folder, "journal", last),
                                                               extent.records, extent.bytes));
  return journal;
}

absl::Status SessionJournal::PrepareGeneration() {
  RS_ASSIGN_OR_RETURN(next_, NewJournal(generation_ + 1));
  return absl::OkStatus();
}

void SessionJournal::SwitchGeneration() {
  older_bytes_ += writer_->bytes();
  older_records_ += writer_->records();
  previous_ = std::exchange(writer_, std::exchange(next_, nullptr));
  ++generation_;
}

absl::Status SessionJournal::PublishSnapshot(absl::FunctionRef<absl::Status(Write)> fill) {
  const absl::Status synced = std::exchange(previous_, nullptr)->Sync();
  if (!synced.ok()) return absl::DataLossError(synced.message());
  const uint64_t generation = generation_;
  const std::string path = FileName(folder_, "snapshot", generation);
  const std::string temporary = path + ".tmp";
  ::unlink(temporary.c_str());
  const auto write = [&]() -> absl::Status {
    RS_ASSIGN_OR_RETURN(const std::shared_ptr<RecordWriter> writer,
                        RecordWriter::Create(temporary));
    v1::StateRecord record;
    *record.mutable_header() = *header_;
    record.mutable_header()->set_generation(generation);
    RS_RETURN_IF_ERROR(writer->Append(record.SerializeAsString()));
    RS_RETURN_IF_ERROR(fill([&writer](const v1::StateRecord& next) {
      return writer->Append(next.SerializeAsString());
    }));
    record.mutable_end()->set_records(writer->records());
    RS_RETURN_IF_ERROR(writer->Append(record.SerializeAsString()));
    RS_RETURN_IF_ERROR(writer->Sync());
    if (std::rename(temporary.c_str(), path.c_str()) != 0)
      return absl::UnavailableError(absl::StrCat("cannot publish '", path, "'"));
    return SyncDirectory(folder_);
  };
  if (absl::Status status = write(); !status.ok()) {
    ::unlink(temporary.c_str());
    return status;
  }
  older_bytes_ = 0;
  older_records_ = 0;
  RemoveOlderThan(snapshot_);
  snapshot_ = generation;
  return absl::OkStatus();
}

void SessionJournal::RemoveOlderThan(uint64_t generation) const {
  const absl::StatusOr<Files> files = ListFiles(folder_);
  if (!files.ok()) return;
  // Journals go first: a snapshot without its journal is never asked for while a newer one is
  // there.
  for (const uint64_t old : files->journals)
    if (old < generation) ::unlink(FileName(folder_, "journal", old).c_str());
  for (const uint64_t old : files->snapshots)
    if (old < generation) ::unlink(FileName(folder_, "snapshot", old).c_str());
}

}  // namespace robostress
