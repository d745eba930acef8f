#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/monotonic_wait.h"
#include "common/rollout/refusal.h"
#include "common/status_macros.h"
#include "server/sessions/place_choice.h"
#include "server/sessions/session_registry.h"

// Who is in memory, who is on disk, and who makes room for whom.
namespace robostress {

void SessionRegistry::CountPlace(const std::string& client, int change) {
  places_ += change;
  if ((clients_[client] += change) == 0) clients_.erase(client);
}

void SessionRegistry::LosePlace(Entry& entry) {
  if (entry.session == nullptr) return;
  entry.session = nullptr;
  CountPlace(entry.client, -1);
}

absl::StatusOr<std::optional<SessionRegistry::Leaving>> SessionRegistry::TryTakePlace(
    const std::string& client, int most) {
  absl::MutexLock lock(&mu_);
  if (draining_) return absl::UnavailableError("the server is shutting down");
  const auto own = clients_.find(client);
  const bool too_many = most > 0 && own != clients_.end() && own->second >= most;
  if (!too_many && places_ < options_.max_sessions) {
    CountPlace(client, 1);
    return std::nullopt;
  }
  PlaceRules rules;
  rules.places = too_many ? 0 : options_.max_sessions;  // 0: all of its own are beyond its share
  rules.durable = durable();
  rules.abandoned_after = options_.abandoned_after;
  std::vector<HeldPlace> held;
  for (const auto& [id, entry] : entries_) {
    if (entry.session == nullptr || entry.in_flight > 0 || entry.busy) continue;
    if (too_many && entry.client != client) continue;
    held.push_back({id, entry.client, absl::Nanoseconds(clock_->now_ns() - entry.last_used_ns),
                    entry.attached > 0, entry.was_attached, entry.session->Position().learned()});
  }
  const PlaceChoice choice = ChoosePlace(rules, held, client);
  if (choice.victim.empty()) {
    const std::string who = too_many ? absl::StrCat("this client has ", own->second, " sessions")
                                     : absl::StrCat(places_, " sessions are open");
    return Refusal(absl::ResourceExhaustedError(
                       absl::StrCat(who, ", which is the limit, and all are in use; close one, or ",
                                    too_many ? "ask for a larger limits: {sessions} of the token"
                                             : "start the server with more --max-sessions")),
                   std::max(choice.wait, absl::Milliseconds(100)));
  }
  Entry& victim = entries_.at(choice.victim);
  victim.busy = true;
  return Leaving{choice.victim, victim.session};
}

void SessionRegistry::MakeLeave(const Leaving& leaving) {
  const SessionPosition position = leaving.session->Position();
  // Nothing was done with it: there is nothing to keep.
  const bool unused = !position.learned() && position.last_prediction_id == 0 && !position.episode;
  const bool keep = durable() && !unused;
  spdlog::warn("{}: {} to make room", leaving.id, keep ? "written to disk" : "closed");
  if (keep) {
    if (const absl::Status flushed = leaving.session->Flush(); !flushed.ok()) {
      spdlog::error("{}: no snapshot: {}; its journal stays", leaving.id, flushed.ToString());
    }
  }
  leaving.session->Cancel();
  {
    absl::MutexLock lock(&mu_);
    const auto found = entries_.find(leaving.id);
    found->second.busy = false;
    found->second.made_room = true;
    found->second.learned = position.learned();
    LosePlace(found->second);
    if (!keep) entries_.erase(found);
  }
  if (durable() && !keep) folders_->Remove(leaving.id);
}

absl::Status SessionRegistry::TakePlace(const std::string& client, int most) {
  while (true) {
    RS_ASSIGN_OR_RETURN(const std::optional<Leaving> leaving, TryTakePlace(client, most));
    if (!leaving) return absl::OkStatus();
    MakeLeave(*leaving);
  }
}

absl::Status SessionRegistry::MakeStoredRoom(const std::string& client) {
  std::string forgotten;
  {
    absl::MutexLock lock(&mu_);
    int own = 0;
    for (const auto& [id, entry] : entries_) own += entry.client == client ? 1 : 0;
    const int most = std::max(1, options_.max_stored_sessions * 3 / 4);
    const bool full = static_cast<int>(entries_.size()) >= options_.max_stored_sessions;
    if (!full && own < most) return absl::OkStatus();
    auto oldest = entries_.end();
    for (auto at = entries_.begin(); at != entries_.end(); ++at) {
      const Entry& entry = at->second;
      const absl::Duration idle = absl::Nanoseconds(clock_->now_ns() - entry.last_used_ns);
      if (entry.session != nullptr || entry.busy || entry.learned ||
          idle < options_.abandoned_after || (!full && entry.client != client)) {
        continue;
      }
      if (oldest == entries_.end() || entry.last_used_ns < oldest->second.last_used_ns) oldest = at;
    }
    if (oldest == entries_.end()) {
      return absl::ResourceExhaustedError(
          absl::StrCat(full ? entries_.size() : static_cast<size_t>(own), " sessions ",
                       full ? "" : "of this client ",
                       "are open or on disk, which is the limit; close some, let ",
                       "them expire with --session-expiry, or start the server with more "
                       "--max-stored-sessions"));
    }
    forgotten = oldest->first;
    entries_.erase(oldest);
  }
  spdlog::warn("{}: forgotten to make room on disk: it has learned nothing", forgotten);
  if (durable()) folders_->Remove(forgotten);
  return absl::OkStatus();
}

void SessionRegistry::ExpireUnused() {
  std::vector<std::string> expired;
  {
    absl::MutexLock lock(&mu_);
    const int64_t now = clock_->now_ns();
    for (auto at = entries_.begin(); at != entries_.end();) {
      Entry& entry = at->second;
      if (entry.in_flight > 0 || entry.busy ||
          absl::Nanoseconds(now - entry.last_used_ns) < options_.expire_after) {
        ++at;
        continue;
      }
      expired.push_back(at->first);
      if (entry.session != nullptr) entry.session->Cancel();
      LosePlace(entry);
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
