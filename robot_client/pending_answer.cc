#include "robot_client/pending_answer.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress {
namespace {

const char* TextOf(Refusal refusal) {
  switch (refusal) {
    case Refusal::kNone:
      return "";
    case Refusal::kStale:
      return "the newest sample of the arm is old: where it stands is not known; look at the bus, "
             "then try again";
    case Refusal::kMoving:
      return "the arm moves; wait until it stands, then try again";
    case Refusal::kApart:
      return "the arm is more than 0.1 rad from where it is sent; clear its way, then type end "
             "or hold";
    case Refusal::kFaults:
      return "the arm goes on reporting a fault";
    case Refusal::kLost:
      return "the connection to the arm is gone";
    case Refusal::kHeld:
      return "a watchdog would hold the arm at once: arm, camera, leader or recording is not well; "
             "see "
             "events.jsonl";
    case Refusal::kOutside:
      return "a policy runs only inside the workspace; lead the arm back by home or jog, from HOLD "
             "after end, or correct control.workspace";
  }
  return "";
}

}  // namespace

absl::Status Refused(const ControlLoop& loop, const std::string& what) {
  std::string why = TextOf(loop.refusal());
  if (loop.refusal() == Refusal::kLost)
    absl::StrAppend(&why, ": ", loop.reconnect_status().message());
  if (loop.refusal() == Refusal::kOutside)
    why = absl::StrFormat("the arm is %.1f mm into %s: %s", 1000 * loop.outside_m(),
                          BoundName(loop.crossed()), why);
  return absl::FailedPreconditionError(absl::StrCat(
      what, ": the client is ", StateName(loop.state()), why.empty() ? "" : "; ", why));
}

PendingAnswer AwaitDecision(const ControlLoop* loop, const Clock& clock, std::string what,
                            double seconds, std::function<bool()> done, std::string answer) {
  const uint64_t before = loop->decided();
  PendingAnswer pending;
  pending.what = what;
  pending.until_ns = clock.now_ns() + static_cast<int64_t>(seconds * 1e9);
  pending.late = absl::DeadlineExceededError(
      absl::StrCat(what, " took longer than ", seconds, " s; the control thread is stuck"));
  pending.answer = [loop, before, what = std::move(what), done = std::move(done),
                    answer = std::move(answer)]() -> std::optional<absl::StatusOr<std::string>> {
    if (loop->decided() == before) return std::nullopt;
    if (done()) return answer;
    return Refused(*loop, what);
  };
  return pending;
}

}  // namespace robostress
