#include "server/sessions/journal/session_recovery.h"

#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/session_events.h"

namespace robostress {

absl::Status AsDamage(const absl::Status& status) {
  if (status.ok() || absl::IsDataLoss(status) || absl::IsCancelled(status) ||
      absl::IsDeadlineExceeded(status) || absl::IsResourceExhausted(status))
    return status;
  return absl::DataLossError(absl::StrCat("state on disk: ", status.message()));
}

absl::StatusOr<std::unique_ptr<SessionJournal>> RecoverJournal(
    const std::string& folder, const SnapshotSources& sources,
    absl::FunctionRef<absl::Status(const SessionSnapshot&)> restore,
    absl::FunctionRef<absl::Status(SessionEvent)> replay) {
  RS_ASSIGN_OR_RETURN(const v1::StateHeader header, SessionJournal::ReadHeader(folder));
  const PolicySpec& policy = sources.policy->spec();
  if (header.model_hash() != policy.model_hash) {
    return absl::FailedPreconditionError(absl::StrCat(
        folder, ": was adapted on weights '", header.model_hash(), "'; policy ", policy.name,
        " has '", policy.model_hash, "': serve those weights, or close the session"));
  }
  std::optional<SessionSnapshot> snapshot;
  const auto begin = [&](const v1::StateRecord& record) -> absl::Status {
    if (!snapshot) snapshot.emplace();
    return AsDamage(ReadSnapshotRecord(record, sources, *snapshot));
  };
  // Once, before the first event.
  const auto restore_once = [&]() -> absl::Status {
    if (!snapshot) return absl::OkStatus();
    const SessionSnapshot whole = *std::exchange(snapshot, std::nullopt);
    return AsDamage(restore(whole));
  };
  const auto event = [&](const v1::StateRecord& record) -> absl::Status {
    RS_RETURN_IF_ERROR(restore_once());
    absl::StatusOr<SessionEvent> decoded = DecodeEvent(record);
    if (!decoded.ok()) return AsDamage(decoded.status());
    return AsDamage(replay(*std::move(decoded)));
  };
  RS_ASSIGN_OR_RETURN(auto journal,
                      SessionJournal::Recover(folder, begin, event, [&] { snapshot.reset(); }));
  RS_RETURN_IF_ERROR(restore_once());
  return journal;
}

}  // namespace robostress
