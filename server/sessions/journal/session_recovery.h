#pragma once

#include <memory>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/journal/snapshot_records.h"
#include "server/sessions/session_event.h"

namespace robostress {

// `status` as one of the disk: DATA_LOSS. What has nothing to do with what it holds stays as it is.
absl::Status AsDamage(const absl::Status& status);

// Reads a folder, one record in memory at a time: hands the newest whole snapshot to `restore`, if
// there is one, then every event after it to `replay`, and goes on with the journal where it ends.
// FAILED_PRECONDITION: it was adapted on other weights, or is of another format. As
// SessionJournal::Recover; errors of what is handed over are AsDamage.
absl::StatusOr<std::unique_ptr<SessionJournal>> RecoverJournal(
    const std::string& folder, const SnapshotSources& sources,
    absl::FunctionRef<absl::Status(const SessionSnapshot&)> restore,
    absl::FunctionRef<absl::Status(SessionEvent)> replay);

}  // namespace robostress
