#include "server/sessions/journal/session_folders.h"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/record_file.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/read_spec.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr uint32_t kMaxDeadlineMs = std::numeric_limits<int32_t>::max();
constexpr char kClosed[] = "closed-";  // folders on their way out
// In a session's folder. What is being read, with how often that was begun; why it is set aside.
constexpr char kReading[] = "/READING", kFailed[] = "/FAILED";

// Readings that were begun and not ended.
int DeathsOf(const std::string& path) {
  int deaths = 0;
  std::ifstream(path) >> deaths;
  return std::clamp(deaths, 0, 1000);
}

v1::StateHeader HeaderOf(const std::string& id, const std::string& token_sha256,
                         const std::string& owner, const SessionRequest& request,
                         const std::string& model_hash) {
  v1::StateHeader header;
  header.set_session_id(id);
  header.set_token_sha256(token_sha256);
  header.set_owner(owner);
  *header.mutable_spec() = ToProto(RequestOf(request.spec));
  *header.mutable_guard() = ToRecord(request.guard);
  header.set_priority(ToProto(request.scheduling.priority));
  header.set_deadline_ms(static_cast<uint32_t>(request.scheduling.deadline_ms));
  header.set_model_hash(model_hash);
  return header;
}

absl::StatusOr<SessionRequest> RequestOf(const v1::StateHeader& header) {
  SessionRequest request;
  RS_ASSIGN_OR_RETURN(const RequestedSession stored, FromProto(header.spec()));
  RS_ASSIGN_OR_RETURN(request.spec, ReadStoredSpec(stored));
  RS_ASSIGN_OR_RETURN(request.guard, FromRecord(header.guard()));
  RS_ASSIGN_OR_RETURN(request.scheduling.priority, FromProto(header.priority()));
  if (header.deadline_ms() > kMaxDeadlineMs) {
    return absl::DataLossError(absl::StrCat("header: deadline_ms is ", header.deadline_ms(),
                                            ", at most ", kMaxDeadlineMs, " is possible"));
  }
  request.scheduling.deadline_ms = static_cast<int>(header.deadline_ms());
  return request;
}

}  // namespace

absl::StatusOr<std::unique_ptr<SessionFolders>> SessionFolders::Open(const std::string& state_dir) {
  RS_RETURN_IF_ERROR(MakeDirectories(state_dir));
  const std::string path = state_dir + "/LOCK";
  const int lock = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (lock < 0) {
    return absl::PermissionDeniedError(
        absl::StrCat("cannot open '", path, "': ", std::strerror(errno), "; correct --state-dir"));
  }
  auto folders = std::unique_ptr<SessionFolders>(new SessionFolders(state_dir, lock));
  if (::flock(lock, LOCK_EX | LOCK_NB) == 0) return folders;
  return absl::UnavailableError(absl::StrCat("another server keeps its sessions in '", state_dir,
                                             "'; give each one its own --state-dir"));
}

SessionFolders::~SessionFolders() { ::close(lock_); }

std::string SessionFolders::PathOf(const std::string& id) const {
  return absl::StrCat(state_dir_, "/", id);
}

absl::StatusOr<std::unique_ptr<SessionJournal>> SessionFolders::Create(
    const std::string& id, const std::string& token_sha256, const std::string& owner,
    const SessionRequest& request, const std::string& model_hash) const {
  auto journal =
      SessionJournal::Create(PathOf(id), HeaderOf(id, token_sha256, owner, request, model_hash));
  std::error_code ignored;
  if (!journal.ok()) fs::remove_all(PathOf(id), ignored);
  return journal;
}

void SessionFolders::Remove(const std::string& id) const {
  // The rename is the moment of closing: what is left of the removal is removed at the next start.
  std::error_code error;
  const std::string closed = PathOf(kClosed + id);
  fs::rename(PathOf(id), closed, error);
  if (!error) SyncDirectory(state_dir_).IgnoreError();
  if (!error) fs::remove_all(closed, error);
  if (error) spdlog::error("{}: cannot remove its folder: {}", id, error.message());
}

void SessionFolders::BeginReading(const std::string& id) const {
  const std::string path = PathOf(id) + kReading;
  const int deaths = DeathsOf(path);
  std::ofstream(path, std::ios::trunc) << deaths + 1 << "\n";  // no loss if the disk is full
}

void SessionFolders::EndReading(const std::string& id) const {
  ::unlink((PathOf(id) + kReading).c_str());
}

void SessionFolders::SetAside(const std::string& id, const absl::Status& why) const {
  spdlog::error("{}: set aside, its files stay: {}", id, why.ToString());
  const absl::Status written =
      WriteFileAtomically(PathOf(id) + kFailed, absl::StrCat(why.message(), "\n"));
  if (!written.ok()) spdlog::error("{}: {}", id, written.ToString());
}

absl::Status SessionFolders::WhyAside(const std::string& id) const {
  if (const absl::StatusOr<std::string> reason = ReadFile(PathOf(id) + kFailed); reason.ok()) {
    return absl::DataLossError(
        absl::StrCat("set aside: ", absl::StripAsciiWhitespace(*reason).substr(0, 4096)));
  }
  const int deaths = DeathsOf(PathOf(id) + kReading);
  if (deaths < kMaxDeaths) return absl::OkStatus();
  const absl::Status why = absl::DataLossError(
      absl::StrCat("the server ended ", deaths, " times in a row while it read this session"));
  SetAside(id, why);
  EndReading(id);
  return why;
}

std::vector<SessionFolders::Stored> SessionFolders::Find() const {
  std::error_code error;
  std::vector<Stored> found;
  for (const auto& entry : fs::directory_iterator(state_dir_, error)) {
    const std::string name = entry.path().filename().string();
    if (absl::StartsWith(name, kClosed)) fs::remove_all(entry.path(), error);
    if (!absl::StartsWith(name, kPrefix)) continue;
    Stored& stored = found.emplace_back();
    stored.id = name;
    const absl::StatusOr<v1::StateHeader> header = SessionJournal::ReadHeader(PathOf(name));
    stored.readable = header.status();
    if (header.ok()) {
      const absl::StatusOr<SessionRequest> request = RequestOf(*header);
      stored.readable = request.status();
      if (request.ok()) stored.request = *request;
      stored.token_sha256 = header->token_sha256();
      stored.owner = header->owner();
    }
    if (const absl::Status aside = WhyAside(name); !aside.ok()) stored.readable = aside;
    if (!stored.readable.ok()) spdlog::error("{}: {}", name, stored.readable.ToString());
  }
  return found;
}

}  // namespace robostress
