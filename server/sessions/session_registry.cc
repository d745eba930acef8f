#include "server/sessions/session_registry.h"

#include <openssl/crypto.h>
#include <openssl/rand.h>
#include <spdlog/spdlog.h>

#include <limits>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/monotonic_wait.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::StatusOr<std::string> RandomHex(int bytes) {
  std::string random(static_cast<size_t>(bytes), '\0');
  if (RAND_bytes(reinterpret_cast<unsigned char*>(random.data()), bytes) != 1)
    return absl::UnavailableError("the system has no random numbers for a token");
  return absl::BytesToHexString(random);
}

// What the caller's token may ask for; 0: as much as anybody.
MethodCaps CapsOf(const Caller& caller) {
  constexpr int kAny = std::numeric_limits<int>::max();
  const auto most = [](int limit) { return limit == 0 ? kAny : limit; };
  const CallerLimits& limits = caller.limits;
  return {most(limits.rank), most(limits.batch), limits.update_interval,
          most(limits.buffer_chunks)};
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
    entry.owner = std::move(stored.owner);
    entry.client = entry.owner;
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
  // The session was made once: it is this server's policy that does not fit.
  if (absl::IsInvalidArgument(session.status())) {
    return absl::FailedPreconditionError(absl::StrCat(
        id, " does not fit this server's policy '", request.spec.policy, "': ",
        session.status().message(), "; start the server with the weights that it was opened with"));
  }
  RS_RETURN_IF_ERROR(session.status());
  folders_->BeginReading(id);
  const absl::Status status = (*session)->Recover(folders_->PathOf(id));
  folders_->EndReading(id);
  if (status.ok()) return session;
  (*session)->Cancel();
  // What its files hold will be no other at the next attempt.
  if (absl::IsDataLoss(status) || absl::IsInvalidArgument(status)) folders_->SetAside(id, status);
  return status;
}

// --------------------------------------------------------------------------------------- sessions

absl::Status SessionRegistry::UnknownSession(const std::string& id) const {
  return absl::NotFoundError(
      absl::StrCat("session '", id.substr(0, 64), "' is not open here; ",
                   durable() ? "it was closed, has expired, or must be resumed with its token"
                             : "it was closed or the server was restarted: open a new one"));
}

absl::Status SessionRegistry::CheckOwner(const Entry& entry, const std::string& id,
                                         const Caller& caller) {
  if (caller.owner.empty() || caller.owner == entry.owner) return absl::OkStatus();
  return absl::PermissionDeniedError(absl::StrCat(
      id.substr(0, 64), " belongs to another caller than '", caller.name,
      "'; use the token or certificate that opened it, or open a session of your own"));
}

absl::StatusOr<OpenedSession> SessionRegistry::Open(const SessionRequest& request,
                                                    const Caller& caller) {
  RS_RETURN_IF_ERROR(
      CheckMethodCaps(*request.spec.method, Tightest(options_.caps, CapsOf(caller))));
  RS_ASSIGN_OR_RETURN(const SessionResources resources, resources_of_(request.spec.policy));
  OpenedSession opened;
  RS_ASSIGN_OR_RETURN(const std::string name, RandomHex(8));
  RS_ASSIGN_OR_RETURN(opened.token, RandomHex(16));
  opened.id = SessionFolders::kPrefix + name;
  RS_RETURN_IF_ERROR(MakeStoredRoom(caller.client()));
  RS_RETURN_IF_ERROR(TakePlace(caller.client(), caller.limits.sessions));
  uint64_t owner = 0;
  {
    absl::MutexLock lock(&mu_);
    owner = ++last_owner_;
  }
  const std::string token_sha256 = Sha256Hex(opened.token);
  const auto make = [&]() -> absl::Status {
    RS_ASSIGN_OR_RETURN(opened.session,
                        Session::Create(request.spec, resources, owner, request.guard));
    if (!durable()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(auto journal,
                        folders_->Create(opened.id, token_sha256, caller.owner, request,
                                         resources.policy->spec().model_hash));
    opened.session->SetJournal(std::move(journal));
    return absl::OkStatus();
  };
  const absl::Status status = make();
  absl::MutexLock lock(&mu_);
  if (!status.ok()) {
    CountPlace(caller.client(), -1);
    return status;
  }
  Entry& entry = entries_[opened.id];
  entry.session = opened.session;
  entry.request = request;
  entry.token_sha256 = token_sha256;
  entry.last_used_ns = clock_->now_ns();
  entry.owner = caller.owner;
  entry.client = caller.client();
  return opened;
}

SessionRegistry::Lease SessionRegistry::Lend(const std::string& id, Entry& entry) {
  ++entry.in_flight;
  ++in_flight_;
  return Lease(this, id, entry.session, entry.request.scheduling);
}

absl::StatusOr<SessionRegistry::Lease> SessionRegistry::Acquire(const std::string& id,
                                                                const std::string* token,
                                                                const Caller& caller) {
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
    if (token != nullptr && entry.owner.empty()) entry.owner = caller.owner;
    RS_RETURN_IF_ERROR(CheckOwner(entry, id, caller));
    if (entry.session != nullptr && durable() && !entry.session->failure().ok() &&
        entry.in_flight == 0) {
      entry.session->Cancel();  // what is on the disk is right
      LosePlace(entry);
    }
    if (entry.session != nullptr) {
      if (token != nullptr) {  // the place is held by who came back
        CountPlace(entry.client, -1);
        CountPlace(caller.client(), 1);
        entry.client = caller.client();
      }
      return Lend(id, entry);
    }
    RS_RETURN_IF_ERROR(entry.unreadable);
    entry.busy = true;
    request = entry.request;
  }
  absl::StatusOr<std::shared_ptr<Session>> session = absl::UnknownError("not read");
  absl::Status place = TakePlace(caller.client(), caller.limits.sessions);
  if (place.ok()) {
    session = ReadFromDisk(id, request);
  } else {
    session = place;
  }
  absl::MutexLock lock(&mu_);
  Entry& entry = entries_.at(id);
  entry.busy = false;
  if (!session.ok()) {
    if (place.ok()) CountPlace(caller.client(), -1);
    const absl::Status& status = session.status();
    if (absl::IsDataLoss(status) || absl::IsInvalidArgument(status)) entry.unreadable = status;
    return status;
  }
  entry.client = caller.client();
  entry.session = *session;
  return Lend(id, entry);
}

absl::StatusOr<OpenedSession> SessionRegistry::Resume(const std::string& id,
                                                      const std::string& token,
                                                      const Caller& caller) {
  RS_ASSIGN_OR_RETURN(const Lease lease, Acquire(id, &token, caller));
  lease->CountResume();
  return OpenedSession{id, "", lease.session()};
}

absl::StatusOr<SessionRegistry::Lease> SessionRegistry::Load(const std::string& id) {
  Caller server = Anybody();
  server.host = "operator";
  return Acquire(id, nullptr, server);
}

absl::StatusOr<SessionRegistry::Lease> SessionRegistry::Use(const std::string& id,
                                                            const Caller& caller) {
  {
    absl::MutexLock lock(&mu_);
    if (draining_) return absl::UnavailableError("the server is shutting down");
    const auto found = entries_.find(id);
    if (found == entries_.end()) return UnknownSession(id);
    Entry& entry = found->second;
    RS_RETURN_IF_ERROR(CheckOwner(entry, id, caller));
    const bool in_memory = entry.session != nullptr && !entry.busy;
    if (in_memory) return Lend(id, entry);
    const bool comes_back = entry.made_room || (entry.busy && entry.session != nullptr);
    if (!comes_back || !durable()) return UnknownSession(id);
  }
  return Acquire(id, nullptr, caller);
}

void SessionRegistry::Attach(const std::string& id) {
  absl::MutexLock lock(&mu_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return;
  ++found->second.attached;
  found->second.was_attached = true;
}

void SessionRegistry::Detach(const std::string& id) {
  absl::MutexLock lock(&mu_);
  const auto found = entries_.find(id);
  if (found != entries_.end() && found->second.attached > 0) --found->second.attached;
}

void SessionRegistry::Return(const std::string& id) {
  absl::MutexLock lock(&mu_);
  --in_flight_;
  const auto found = entries_.find(id);
  if (found == entries_.end()) return;
  --found->second.in_flight;
  found->second.last_used_ns = clock_->now_ns();
}

absl::Status SessionRegistry::Close(const std::string& id, const Caller& caller) {
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
    RS_RETURN_IF_ERROR(CheckOwner(found->second, id, caller));
    if (found->second.session != nullptr) found->second.session->Cancel();
    LosePlace(found->second);
    entries_.erase(found);
  }
  if (durable()) folders_->Remove(id);
  return absl::OkStatus();
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

bool SessionRegistry::IsAsync(const std::string& id) const {
  absl::MutexLock lock(&mu_);
  const auto found = entries_.find(id);
  return found != entries_.end() && found->second.request.spec.mode == ExecutionMode::kAsync;
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

}  // namespace robostress
