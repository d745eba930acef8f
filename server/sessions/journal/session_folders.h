#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/session_request.h"

namespace robostress {

// The folders of a server's sessions in one --state-dir, which this process alone uses.
class SessionFolders {
 public:
  static constexpr char kPrefix[] = "session-";  // of every session's id
  // A session as its folder describes it.
  struct Stored {
    std::string id;
    SessionRequest request;
    std::string token_sha256;
    std::string owner;      // Caller::owner
    absl::Status readable;  // otherwise only the id is known
  };

  // UNAVAILABLE: another server uses the folder.
  static absl::StatusOr<std::unique_ptr<SessionFolders>> Open(const std::string& state_dir);
  ~SessionFolders();
  SessionFolders(const SessionFolders&) = delete;
  SessionFolders& operator=(const SessionFolders&) = delete;

  const std::string& state_dir() const { return state_dir_; }
  // Every session that is there; finishes removals that an end of the server interrupted.
  std::vector<Stored> Find() const;
  std::string PathOf(const std::string& id) const;
  // A folder for a new session, with its journal; durable when it returns. Nothing stays after an
  // error.
  absl::StatusOr<std::unique_ptr<SessionJournal>> Create(const std::string& id,
                                                         const std::string& token_sha256,
                                                         const std::string& owner,
                                                         const SessionRequest& request,
                                                         const std::string& model_hash) const;
  // Around the reading of a session. A session at which the process died kMaxDeaths times in a row
  // is set aside by the Find of the next start; one death may be a kill or a loss of power that had
  // nothing to do with it.
  static constexpr int kMaxDeaths = 2;
  void BeginReading(const std::string& id) const;
  void EndReading(const std::string& id) const;
  // Its files stay, and Find says that it cannot be read and why, until an operator closes it, or
  // repairs it and removes the file FAILED from its folder.
  void SetAside(const std::string& id, const absl::Status& why) const;
  // Errors are logged. Once it has begun the session is closed, whatever happens to this process.
  void Remove(const std::string& id) const;

 private:
  // OK: it is not set aside.
  absl::Status WhyAside(const std::string& id) const;
  SessionFolders(std::string state_dir, int lock) : state_dir_(std::move(state_dir)), lock_(lock) {}

  const std::string state_dir_;
  const int lock_;  // file descriptor of state_dir/LOCK
};

}  // namespace robostress
