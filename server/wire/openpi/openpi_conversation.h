#pragma once

#include <memory>
#include <optional>
#include <string>

#include "common/wire/openpi_observation.h"
#include "server/operations/access_tokens.h"
#include "server/sessions/session_host.h"
#include "server/wire/openpi/openpi_extensions.h"
#include "server/wire/web/web_server.h"

namespace robostress {

struct OpenpiOptions {
  OpenpiInputOptions input;
  // Of a client that says nothing of its session: method, policy (empty: the first served), seed.
  SessionSpec session;
};

// openpi's protocol over one WebSocket: metadata first, then one reply per observation. An existing
// client is served by an unadapted session of its own. A client of ours may add to an observation
//   session   {..., or resume: {id, token}}   in its first message (openpi_extensions.h); `resize`:
//             true there: views of other sizes than the policy's are resized
//   episode   {task, episode}                 a new episode; `reset`: true: the next one
//   executed  {...}                           what it did with an earlier reply: feedback
//   running   {actions, held}                 the prediction goes on from these rows
// and every reply says the adapter's version. A message with `executed` and no `prompt` only
// reports. One thread.
class OpenpiConversation : public WebConversation {
 public:
  // `host` and `metrics` must outlive it.
  OpenpiConversation(const OpenpiOptions& options, SessionHost* host, Metrics* metrics,
                     Caller caller);
  // Closes the session, unless the client asked for one that can be resumed.
  ~OpenpiConversation() override;

  std::string Greeting() override;
  // Before a session is open of the greatest policy that is served, then of the session's own.
  uint64_t LargestMessage() const override;
  std::string client() const override { return caller_.client(); }
  absl::StatusOr<std::string> Answer(std::string_view message) override;

 private:
  // Opens or resumes the session that the first message asks for.
  absl::Status Begin(const OpenpiValue* session);
  absl::StatusOr<SessionHost::Opened> Open(const OpenpiValue* session);
  absl::Status EnterEpisode(SessionUse& session, const OpenpiValue& message);
  absl::StatusOr<FeedbackResult> Report(SessionUse& session, const OpenpiValue& executed);

  const OpenpiOptions options_;
  SessionHost* const host_;
  const Caller caller_;
  const std::shared_ptr<Histogram> infer_seconds_;
  const std::shared_ptr<Counter> messages_, bytes_in_, bytes_out_;

  std::string session_id_, resume_token_;
  bool durable_ = false, keep_ = false, announced_ = false, resize_ = false;
  PolicySpec policy_;
  double control_period_s_ = 0.05;
  std::optional<EpisodeKey> episode_;
  int chunk_ = 0;
  uint64_t feedback_sequence_ = 0;
  double previous_total_ms_ = -1;
};

}  // namespace robostress
