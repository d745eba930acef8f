#pragma once

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "adapter/lora.h"
#include "server/inference/prefix_store.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/session_snapshot.h"
#include "server/sessions/state_rules.h"

// A snapshot as the records of its file, and back.
namespace robostress {

// SessionJournal::PublishSnapshot of it. `targets` are the policy's; `prefixes` gives those of an
// imported buffer.
absl::Status PublishSnapshot(SessionJournal& journal, const SessionSnapshot& snapshot,
                             const std::vector<LoraTarget>& targets, PrefixStore& prefixes);

// The new session that a snapshot is read for. All outlive the reading.
struct SnapshotSources {
  const SessionSpec* spec = nullptr;
  std::shared_ptr<const FlowPolicy> policy;
  const Learner* learner = nullptr;
  const StateRules* rules = nullptr;
  PrefixStore* prefixes = nullptr;
};

// Takes one record. What it holds is checked by itself; the whole by StateRules::CheckSnapshot.
absl::Status ReadSnapshotRecord(const v1::StateRecord& record, const SnapshotSources& sources,
                                SessionSnapshot& snapshot);

}  // namespace robostress
