#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/sessions/journal/record_file.h"

namespace robostress {

namespace v1 {
class StateHeader;
class StateRecord;
}  // namespace v1

// The files of one session, in a folder of its own:
//
//   journal-000007     what happened since snapshot 7, in order
//   snapshot-000007    the state at the beginning of journal 7; there is none for generation 0
//
// Each begins with the session's header. A snapshot is published whole (temporary file, fsync,
// rename) and ends with a record that counts the others. The one before it and its journal are kept
// until the next is published: where the newest cannot be read, the state is made from the one
// before and two journals. A journal may end in a record that a crash cut off: it was not
// acknowledged. README.md has the format.
class SessionJournal {
 public:
  using Take = absl::FunctionRef<absl::Status(const v1::StateRecord&)>;
  // Adds a record to the snapshot that is being written.
  using Write = absl::FunctionRef<absl::Status(const v1::StateRecord&)>;

  // A new folder with journal 0; durable when it returns.
  static absl::StatusOr<std::unique_ptr<SessionJournal>> Create(const std::string& folder,
                                                                const v1::StateHeader& header);
  // The header of a folder, for a list.
  static absl::StatusOr<v1::StateHeader> ReadHeader(const std::string& folder);
  // Hands the newest readable snapshot's records to `begin`, if there is one, then those of every
  // later journal to `replay`, and goes on where they end. DATA_LOSS where a journal is missing or
  // damaged. A snapshot that cannot be read is passed over with a warning; `restart` undoes what
  // `begin` did of it.
  static absl::StatusOr<std::unique_ptr<SessionJournal>> Recover(const std::string& folder,
                                                                 Take begin, Take replay,
                                                                 absl::FunctionRef<void()> restart);

  const v1::StateHeader& header() const { return *header_; }
  uint64_t generation() const { return generation_; }
  // Since the last snapshot.
  uint64_t bytes() const { return older_bytes_ + writer_->bytes(); }
  uint64_t records() const { return older_records_ + writer_->records(); }

  // One event (journal/session_events.h), in their order. As RecordWriter::Append.
  absl::Status Append(const std::string& event) { return writer_->Append(event); }
  // Survives the next generation: sync on another thread.
  std::shared_ptr<RecordWriter> writer() const { return writer_; }

  // A new generation in three steps; one thread at a time. The first and the last are slow and may
  // run beside Append on another thread; no feedback is acknowledged between them.
  // 1. Makes journal generation() + 1. On failure nothing has changed.
  absl::Status PrepareGeneration();
  // 2. Later records go there. Quick; not beside Append.
  void SwitchGeneration();
  // 3. Publishes the state as it was at the switch, which `fill` writes. DATA_LOSS: the journal
  // before the switch cannot be made durable, nobody knows what is; another error: no snapshot was
  // published, and the older one with both journals stands for the state.
  absl::Status PublishSnapshot(absl::FunctionRef<absl::Status(Write)> fill);

 private:
  SessionJournal(std::string folder, const v1::StateHeader& header);
  absl::StatusOr<std::shared_ptr<RecordWriter>> NewJournal(uint64_t generation) const;
  void RemoveOlderThan(uint64_t generation) const;

  const std::string folder_;
  std::shared_ptr<v1::StateHeader> header_;  // shared_ptr: a complete type is not needed here
  uint64_t generation_ = 0, snapshot_ = 0;   // of the journal; of the last snapshot, 0: none
  // Of the journals since the snapshot, but the last; read beside PublishSnapshot.
  std::atomic<uint64_t> older_bytes_ = 0, older_records_ = 0;
  std::shared_ptr<RecordWriter> writer_;
  std::shared_ptr<RecordWriter> next_;      // prepared
  std::shared_ptr<RecordWriter> previous_;  // switched from, not yet synced
};

}  // namespace robostress
