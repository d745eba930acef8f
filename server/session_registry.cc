#include "server/session_registry.h"

#include <openssl/crypto.h>
#include <openssl/rand.h>
#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/monotonic_wait.h"
#include "common/rpc/refusal.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::StatusOr<std::string> RandomHex(int bytes) {
  std::string random(static_cast<size_t>(bytes), '\0');
  if (RAND_bytes(reinterpret_cast<unsigned char*>(random.data()), bytes) != 1)
    return absl::UnavailableError("the system has no random numbers for a token");
  return absl::BytesToHexString(random);
}

bool SameSecret(const std::string& a, const std::string& b) {
  return a.size() == b.size() && CRYPTO_memcmp(a.data(), b.data(), a.size()) == 0;
}

}  // namespace

SessionRegistry::SessionRegistry(const SessionRegistryOptions& options, ResourcesOf resources_of,
                                 Clock* clock)
    : options_(options), resources_of_(std::move(resources_of)), clock_(clock) {}

absl::StatusOr<std::unique_ptr<SessionRegistry>> SessionRegistry::Create(
    const SessionRegistryOptions& options, ResourcesOf resources_of, Clock* clock) {
  auto registry = std::unique_ptr<SessionRegistry>(
      new SessionRegistry(options, std::move(resources_of), clock));
  if (!options.state_dir.empty()) {
    RS_ASSIGN_OR_RETURN(registry->folders_, SessionFolders::Open(options.state_dir));
    registry->FindStored();
  }
  if (options.expire_after != absl::InfiniteDuration())
    registry->sweeper_ = std::thread([raw = registry.get()] { raw->Sweep(); });
  return registry;
}

SessionRegistry::~SessionRegistry() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  if (sweeper_.joinable()) sweeper_.join();
  CancelAll();
}

// ------------------------------------------------------------------------------------------- disk

void SessionRegistry::FindStored() {
  absl::MutexLock lock(&mu_);
  for (SessionFolders::Stored& stored : folders_->Find()) {
    Entry& entry = entries_[stored.id];
    entry.request = std::move(stored.request);
    entry.token_sha256 = std::move(stored.token_sha256);
    entry.unreadable = std::move(stored.readable);
    entry.last_used_ns = clock_->now_ns();
  }
  if (!entries_.empty())
    spdlog::info("{} sessions are on disk in {}", entries_.size(), folders_->state_dir());
}

absl::StatusOr<std::shared_ptr<Session>> SessionRegistry::ReadFromDisk(
    const std::string& id, const SessionRequest& request) {
  RS_ASSIGN_OR_RETURN(const SessionResources resources, resources_of_(request.spec.policy));
  uint64_t owner = 0;
  {
    absl::MutexLock lock(&mu_);
    owner = ++last_owner_;
  }
  absl::StatusOr<std::shared_ptr<Session>> session =
      Session::Create(request.spec, resources, owner, request.guard);
  absl::Status status = session.status();
  if (status.ok()) {
    folders_->BeginReading(id);
    status = (*session)->Recover(folders_->PathOf(id));
    folders_->EndReading(id);
    if (status.ok()) return session;
    (*session)->Cancel();
  }
  // What its files hold will be no other at the next attempt.
  if (absl::IsDataLoss(status) || absl::IsInvalidArgument(status)) folders_->SetAside(id, status);
  return status;
}

// ----------------------------------------------------------------------------------------- places

absl::Status SessionRegistry::TakePlace() {
  while (true) {
    std::string victim;
    std::shared_ptr<Session> session;
    {
      absl::MutexLock lock(&mu_);
      if (draining_) return absl::UnavailableError("the server is shutting down");
      if (places_ < options_.max_sessions) {
        ++places_;
        return absl::OkStatus();
      }
      auto oldest = entries_.end();
      for (auto at = entries_.begin(); at != entries_.end(); ++at) {
        if (at->second.session == nullptr || at->second.in_flight > 0 || at->second.busy) continue;
        if (oldest == entries_.end() || at->second.last_used_ns < oldest->second.last_used_ns)
          oldest = at;
      }
      const absl::Duration unused =
          oldest == entries_.end()
              ? -absl::InfiniteDuration()
              : absl::Nanoseconds(clock_->now_ns() - oldest->second.last_used_ns);
      if (unused < options_.abandoned_after) {
        // The one unused for longest makes room when it counts as abandoned.
        const absl::Duration left =
            oldest == entries_.end() ? options_.abandoned_after : options_.abandoned_after - unused;
        return Refusal(
            absl::ResourceExhaustedError(absl::StrCat(
                places_, " sessions are open, which is the limit, and all were used within ",
                absl::FormatDuration(options_.abandoned_after),
                "; close one or start the server with more --max-sessions")),
            left);
      }
      victim = oldest->first;
      session = oldest->second.session;
      oldest->second.busy = true;
      spdlog::warn("{} was not used for {}: {} to make room", victim, absl::FormatDuration(unused),
                   durable() ? "written to disk" : "closed");
    }
    const absl::Status flushed = session->Flush();
    if (!flushed.ok())
      spdlog::error("{}: no snapshot: {}; its journal stays", victim, flushed.ToString());
    session->Cancel();
    absl::MutexLock lock(&mu_);
    const auto found = entries_.find(victim);
    found->second.busy = false;
    found->second.session = nullptr;
    --places_;
    if (!durable()) entries_.erase(found);
  }
}

void SessionRegistry::GivePlaceBack() {
  absl::MutexLock lock(&mu_);
  --places_;
}

// --------------------------------------------------------------------------------------- sessions

absl::Status SessionRegistry::UnknownSession(const std::string& id) const {
  return absl::NotFoundError(
      absl::StrCat("session '", id.substr(0, 64), "' is not open here; ",
                   durable() ? "it was closed, has expired, or must be resumed with its token"
                             : "it was closed or the server was restarted: open a new one"));
}

absl::StatusOr<OpenedSession> SessionRegistry::Open(const SessionRequest& request) {
  RS_RETURN_IF_ERROR(CheckMethodCaps(request.spec.method, options_.caps));
  RS_ASSIGN_OR_RETURN(const SessionResources resources, resources_of_(request.spec.policy));
  OpenedSession opened;
  RS_ASSIGN_OR_RETURN(const std::string name, RandomHex(8));
  RS_ASSIGN_OR_RETURN(opened.token, RandomHex(16));
  opened.id = SessionFolders::kPrefix + name;
  RS_RETURN_IF_ERROR(TakePlace());
  uint64_t owner = 0;
  {
    absl::MutexLock lock(&mu_);
    owner = ++last_owner_;
    if (static_cast<int>(entries_.size()) >= options_.max_stored_sessions) {
      --places_;
      return absl::ResourceExhaustedError(
          absl::StrCat(entries_.size(),
                       " sessions are open or on disk, which is the limit; close "
                       "some, or let them expire with --session-expiry"));
    }
  }
  const std::string token_sha256 = Sha256Hex(opened.token);
  const auto make = [&]() -> absl::Status {
    RS_ASSIGN_OR_RETURN(opened.session,
                        Session::Create(request.spec, resources, owner, request.guard));
    if (!durable()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(auto journal, folders_->Create(opened.id, token_sha256, request,
                                                       resources.policy->spec().model_hash));
    opened.session->SetJournal(std::move(journal));
    return absl::OkStatus();
  };
  if (absl::Status status = make(); !status.ok()) {
    GivePlaceBack();
    return status;
  }
  absl::MutexLock lock(&mu_);
  Entry& entry = entries_[opened.id];
  entry.session = opened.session;
  entry.request = request;
  entry.token_sha256 = token_sha256;
  entry.last_used_ns = clock_->now_ns();
  return opened;
}

absl::StatusOr<std::shared_ptr<Session>> SessionRegistry::Acquire(const std::string& id,
                                                                  const std::string* token) {
  SessionRequest request;
  {
    absl::MutexLock lock(&mu_);
    const auto free = [&] {
      mu_.AssertHeld();
      const auto at = entries_.find(id);
      return at == entries_.end() || !at->second.busy;
    };
    mu_.Await(absl::Condition(&free));
    if (draining_) return absl::UnavailableError("the server is shutting down");
    const auto found = entries_.find(id);
    if (found == entries_.end()) return UnknownSession(id);
    Entry& entry = found->second;
    if (token != nullptr && !SameSecret(Sha256Hex(*token), entry.token_sha256))
      return absl::PermissionDeniedError(absl::StrCat("this is not the token of ", id));
    if (entry.session != nullptr && durable() && !entry.session->failure().ok() &&
        entry.in_flight == 0) {
      entry.session->Cancel();  // what is on the disk is right
      entry.session = nullptr;
      --places_;
    }
    if (entry.session != nullptr) {
      ++entry.in_flight;
      ++in_flight_;
      return entry.session;
    }
    RS_RETURN_IF_ERROR(entry.unreadable);
    entry.busy = true;
    request = entry.request;
  }
  absl::StatusOr<std::shared_ptr<Session>> session = absl::UnknownError("not read");
  absl::Status place = TakePlace();
  if (place.ok()) {
    session = ReadFromDisk(id, request);
    if (!session.ok()) GivePlaceBack();
  } else {
    session = place;
  }
  absl::MutexLock lock(&mu_);
  Entry& entry = entries_.at(id);
  entry.busy = false;
  if (!session.ok()) {
    const absl::Status& status = session.status();
    if (absl::IsDataLoss(status) || absl::IsInvalidArgument(status)) entry.unreadable = status;
    return status;
  }
  entry.session = *session;
  ++entry.in_flight;
  ++in_flight_;
  return session;
}

absl::StatusOr<OpenedSession> SessionRegistry::Resume(const std::string& id,
                                                      const std::string& token) {
  RS_ASSIGN_OR_RETURN(std::shared_ptr<Session> session, Acquire(id, &token));
  const Lease lease(this, id, session);
  session->CountResume();
  return OpenedSession{id, "", std::move(session)};
}

absl::StatusOr<SessionRegistry::Lease> SessionRegistry::Load(const std::string& id) {
  RS_ASSIGN_OR_RETURN(std::shared_ptr<Session> session, Acquire(id, nullptr));
  return Lease(this, id, std::move(session));
}

absl::StatusOr<SessionRegistry::Lease> SessionRegistry::Use(const std::string& id) {
  absl::MutexLock lock(&mu_);
  if (draining_) return absl::UnavailableError("the server is shutting down");
  const auto found = entries_.find(id);
  if (found == entries_.end() || found->second.session == nullptr || found->second.busy)
    return UnknownSession(id);
  ++found->second.in_flight;
  ++in_flight_;
  return Lease(this, id, found->second.session);
}

void SessionRegistry::Return(const std::string& id) {
  absl::MutexLock lock(&mu_);
  --in_flight_;
  const auto found = entries_.find(id);
  if (found == entries_.end()) return;
  --found->second.in_flight;
  found->second.last_used_ns = clock_->now_ns();
}

absl::Status SessionRegistry::Close(const std::string& id) {
  {
    absl::MutexLock lock(&mu_);
    const auto free = [&] {
      mu_.AssertHeld();
      const auto at = entries_.find(id);
      return at == entries_.end() || !at->second.busy;
    };
    mu_.Await(absl::Condition(&free));
    const auto found = entries_.find(id);
    if (found == entries_.end()) return UnknownSession(id);
    if (found->second.session != nullptr) {
      found->second.session->Cancel();
      --places_;
    }
    entries_.erase(found);
  }
  if (durable()) folders_->Remove(id);
  return absl::OkStatus();
}

absl::StatusOr<SessionScheduling> SessionRegistry::SchedulingOf(const std::string& id) {
  absl::MutexLock lock(&mu_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return UnknownSession(id);
  return found->second.request.scheduling;
}

std::vector<SessionRow> SessionRegistry::List() {
  std::vector<std::pair<SessionRow, std::shared_ptr<Session>>> found;
  {
    absl::MutexLock lock(&mu_);
    for (const auto& [id, entry] : entries_) {
      SessionRow row;
      row.id = id;
      row.request = entry.request;
      row.open = entry.session != nullptr;
      row.error = entry.unreadable;
      row.idle = entry.in_flight > 0 ? absl::ZeroDuration()
                                     : absl::Nanoseconds(clock_->now_ns() - entry.last_used_ns);
      found.emplace_back(std::move(row), entry.session);
    }
  }
  std::vector<SessionRow> rows;
  for (auto& [row, session] : found) {
    if (session != nullptr) {
      row.counters = session->CountersNow();
      row.feedback_sequence = session->Position().feedback_sequence;
      row.error = session->failure();
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

int SessionRegistry::open_sessions() const {
  absl::MutexLock lock(&mu_);
  return places_;
}

bool SessionRegistry::draining() const {
  absl::MutexLock lock(&mu_);
  return draining_;
}

// -------------------------------------------------------------------------------------------- end

void SessionRegistry::Drain() {
  absl::MutexLock lock(&mu_);
  draining_ = true;
}

bool SessionRegistry::AwaitIdle(absl::Duration timeout) {
  absl::MutexLock lock(&mu_);
  const auto idle = [this] {
    mu_.AssertHeld();
    return in_flight_ == 0;
  };
  return AwaitFor(mu_, idle, timeout);
}

void SessionRegistry::FlushAll() {
  std::vector<std::pair<std::string, std::shared_ptr<Session>>> open;
  {
    absl::MutexLock lock(&mu_);
    for (const auto& [id, entry] : entries_)
      if (entry.session != nullptr) open.emplace_back(id, entry.session);
  }
  for (const auto& [id, session] : open) {
    if (absl::Status status = session->Flush(); !status.ok())
      spdlog::error("{}: no snapshot: {}; its journal stays", id, status.ToString());
  }
}

void SessionRegistry::CancelAll() {
  absl::MutexLock lock(&mu_);
  for (auto& [id, entry] : entries_)
    if (entry.session != nullptr) entry.session->Cancel();
}

void SessionRegistry::ExpireUnused() {
  std::vector<std::string> expired;
  {
    absl::MutexLock lock(&mu_);
    const int64_t now = clock_->now_ns();
    for (auto at = entries_.begin(); at != entries_.end();) {
      const Entry& entry = at->second;
      if (entry.in_flight > 0 || entry.busy ||
          absl::Nanoseconds(now - entry.last_used_ns) < options_.expire_after) {
        ++at;
        continue;
      }
      expired.push_back(at->first);
      if (entry.session != nullptr) {
        entry.session->Cancel();
        --places_;
      }
      at = entries_.erase(at);
    }
  }
  for (const std::string& id : expired) {
    spdlog::warn("{} was not used for {}: closed", id, absl::FormatDuration(options_.expire_after));
    if (durable()) folders_->Remove(id);
  }
}

void SessionRegistry::Sweep() {
  pthread_setname_np(pthread_self(), "expiry");
  const absl::Duration period =
      std::clamp(options_.expire_after / 8, absl::Milliseconds(10), absl::Minutes(1));
  while (true) {
    {
      absl::MutexLock lock(&mu_);
      const auto stopped = [this] {
        mu_.AssertHeld();
        return stopped_;
      };
      if (AwaitFor(mu_, stopped, period)) return;
    }
    ExpireUnused();
  }
}

}  // namespace robostress
