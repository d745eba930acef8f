#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "common/clock.h"
#include "server/operations/access_tokens.h"
#include "server/sessions/journal/session_folders.h"
#include "server/sessions/session.h"
#include "server/sessions/session_checks.h"
#include "server/sessions/session_request.h"

namespace robostress {

struct SessionRegistryOptions {
  int max_sessions = 64;  // in memory
  // Where sessions live on disk (server/sessions/journal/README.md); empty: in memory only.
  std::string state_dir;
  int max_stored_sessions = 4096;  // in memory and on disk together
  // When max_sessions are open, who makes room is chosen by server/sessions/place_choice.h: a
  // durable session is written to disk, from where its next message brings it back; another one is
  // closed.
  absl::Duration abandoned_after = absl::Minutes(15);
  // Unused for this long a session is closed, on disk too. Counted by the monotonic clock while the
  // server runs, so a wall clock that jumps closes nothing.
  absl::Duration expire_after = absl::InfiniteDuration();
  MethodCaps caps;  // of sessions that are opened; those on disk go on
};

struct OpenedSession {
  std::string id;
  std::string token;  // of Open; empty of Resume
  std::shared_ptr<Session> session;
};

// One row of a list of sessions.
struct SessionRow {
  std::string id;
  SessionRequest request;
  bool open = false;         // in memory; false: on disk
  absl::Duration idle;       // since its last message
  SessionCounters counters;  // of an open one
  uint64_t feedback_sequence = 0;
  absl::Status error;  // why it computes no further, or cannot be read
};

// The sessions of a server by id: limits, expiry, resumption by token, and the folders on disk.
// Thread-safe. Nothing slow (a disk, a replay) is done under its lock.
class SessionRegistry {
 public:
  // The resources for a policy's sessions; NOT_FOUND: it is not served.
  using ResourcesOf = std::function<absl::StatusOr<SessionResources>(const std::string& policy)>;

  // `clock` outlives it. UNAVAILABLE: another server uses the folder.
  static absl::StatusOr<std::unique_ptr<SessionRegistry>> Create(
      const SessionRegistryOptions& options, ResourcesOf resources_of, Clock* clock);
  ~SessionRegistry();

  // A use of a session; while one is held the session is not idle.
  class Lease {
   public:
    Lease(SessionRegistry* registry, std::string id, std::shared_ptr<Session> session,
          const SessionScheduling& scheduling)
        : registry_(registry),
          id_(std::move(id)),
          session_(std::move(session)),
          scheduling_(scheduling) {}
    Lease(Lease&& other) noexcept = default;
    Lease& operator=(Lease&&) = delete;
    ~Lease() {
      if (session_ != nullptr) registry_->Return(id_);
    }
    Session& operator*() const { return *session_; }
    Session* operator->() const { return session_.get(); }
    const std::shared_ptr<Session>& session() const { return session_; }
    // Priority and deadline that it was opened with.
    const SessionScheduling& scheduling() const { return scheduling_; }

   private:
    SessionRegistry* registry_;
    std::string id_;
    std::shared_ptr<Session> session_;
    SessionScheduling scheduling_;
  };

  // The session belongs to `caller`; one without an owner may do everything with every session.
  // RESOURCE_EXHAUSTED with a time to come back: the server, or the caller, holds all it may.
  absl::StatusOr<OpenedSession> Open(const SessionRequest& request,
                                     const Caller& caller = Anybody()) ABSL_LOCKS_EXCLUDED(mu_);
  // The session again, read from disk where it is not in memory or has failed. NOT_FOUND: closed,
  // expired or never durable; PERMISSION_DENIED: not its token, or another caller's session. One
  // that was opened when nobody was asked who he is becomes the caller's.
  absl::StatusOr<OpenedSession> Resume(const std::string& id, const std::string& token,
                                       const Caller& caller = Anybody()) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the session, on disk too. PERMISSION_DENIED: another caller's.
  absl::Status Close(const std::string& id, const Caller& caller = Anybody())
      ABSL_LOCKS_EXCLUDED(mu_);
  // For one message. NOT_FOUND says what a client can do; PERMISSION_DENIED: another caller's. What
  // went to disk to make room is read from there.
  absl::StatusOr<Lease> Use(const std::string& id, const Caller& caller = Anybody())
      ABSL_LOCKS_EXCLUDED(mu_);
  // A connection serves the session, or does no longer. Nothing happens where it is gone.
  void Attach(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);
  void Detach(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);
  // For an operator: the session without its token, read from disk where it is not in memory.
  absl::StatusOr<Lease> Load(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);

  std::vector<SessionRow> List() ABSL_LOCKS_EXCLUDED(mu_);
  // In async mode; false of one that is unknown.
  bool IsAsync(const std::string& id) const ABSL_LOCKS_EXCLUDED(mu_);
  int open_sessions() const ABSL_LOCKS_EXCLUDED(mu_);
  bool durable() const { return folders_ != nullptr; }
  bool draining() const ABSL_LOCKS_EXCLUDED(mu_);
  const SessionRegistryOptions& options() const { return options_; }

  // Sessions and messages are refused from now on.
  void Drain() ABSL_LOCKS_EXCLUDED(mu_);
  // True when no message is under way.
  bool AwaitIdle(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Writes every durable session to disk; after Drain. Errors are logged: the journals are there.
  void FlushAll() ABSL_LOCKS_EXCLUDED(mu_);
  void CancelAll() ABSL_LOCKS_EXCLUDED(mu_);
  // Closes what is expired. Called by a thread of its own; tests with a clock of theirs call it.
  void ExpireUnused() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    std::shared_ptr<Session> session;  // null: on disk
    SessionRequest request;
    std::string token_sha256;
    absl::Status unreadable;  // why the folder cannot be used
    int64_t last_used_ns = 0;
    int in_flight = 0;   // messages under way
    bool busy = false;   // one thread reads it from disk or writes it there
    std::string owner;   // Caller::owner of who opened it
    std::string client;  // Caller::client of who used it last; holds the place
    int attached = 0;    // connections that serve it
    bool was_attached = false;
    bool learned = true;     // feedback is in it, as far as is known of one on disk
    bool made_room = false;  // this server wrote it to disk to make room
  };
  // A session that has to leave memory.
  struct Leaving {
    std::string id;
    std::shared_ptr<Session> session;
  };

  SessionRegistry(const SessionRegistryOptions& options, ResourcesOf resources_of, Clock* clock);
  void FindStored() ABSL_LOCKS_EXCLUDED(mu_);
  void Return(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);
  // Counts one more session in memory for a client that may hold `most` (0: any number), where one
  // may have to leave it.
  absl::Status TakePlace(const std::string& client, int most) ABSL_LOCKS_EXCLUDED(mu_);
  // The place, or who leaves for it, or why there is none.
  absl::StatusOr<std::optional<Leaving>> TryTakePlace(const std::string& client, int most)
      ABSL_LOCKS_EXCLUDED(mu_);
  void MakeLeave(const Leaving& leaving) ABSL_LOCKS_EXCLUDED(mu_);
  void CountPlace(const std::string& client, int change) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The session is no longer in memory, or is another client's.
  void LosePlace(Entry& entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Forgets one on disk that has learned nothing, where all that may be are stored.
  absl::Status MakeStoredRoom(const std::string& client) ABSL_LOCKS_EXCLUDED(mu_);
  static absl::Status CheckOwner(const Entry& entry, const std::string& id, const Caller& caller);
  // Counts one use of a session in memory.
  Lease Lend(const std::string& id, Entry& entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // A use, of what was on disk too. `token`: null where it was shown before.
  absl::StatusOr<Lease> Acquire(const std::string& id, const std::string* token,
                                const Caller& caller) ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<std::shared_ptr<Session>> ReadFromDisk(const std::string& id,
                                                        const SessionRequest& request)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status UnknownSession(const std::string& id) const;
  void Sweep() ABSL_LOCKS_EXCLUDED(mu_);

  const SessionRegistryOptions options_;
  const ResourcesOf resources_of_;
  Clock* const clock_;
  std::unique_ptr<SessionFolders> folders_;  // null: in memory only

  mutable absl::Mutex mu_;
  std::map<std::string, Entry> entries_ ABSL_GUARDED_BY(mu_);
  int places_ ABSL_GUARDED_BY(mu_) = 0;  // sessions in memory, and those on their way there
  std::map<std::string, int> clients_ ABSL_GUARDED_BY(mu_);  // places by client
  int in_flight_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t last_owner_ ABSL_GUARDED_BY(mu_) = 0;
  bool draining_ ABSL_GUARDED_BY(mu_) = false, stopped_ ABSL_GUARDED_BY(mu_) = false;
  std::thread sweeper_;
};

}  // namespace robostress
