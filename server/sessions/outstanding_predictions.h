#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"
#include "server/sessions/prediction.h"

namespace robostress {

// The predictions of a session whose feedback may still come, by their numbers: 1, 2, 3 ... Their
// owner locks.
class OutstandingPredictions {
 public:
  static constexpr size_t kMost = 64;  // kept; the oldest are dropped

  // The number of the next one. INVALID_ARGUMENT: there are no more numbers.
  absl::StatusOr<uint64_t> Next();
  // `id` was given before the journal was read: the next one is a later one.
  absl::Status Skip(uint64_t id);
  // One more that was made.
  void Keep(Prediction prediction);
  bool Holds(uint64_t id) const { return kept_.count(id) > 0; }

  // `id` 0: the newest. FAILED_PRECONDITION says which ones are kept.
  absl::StatusOr<const Prediction*> Find(uint64_t id) const;
  // The one that a chunk reports on: kept, and of the chunk's own key.
  absl::StatusOr<Prediction*> ReportedBy(const ExecutedChunk& executed);
  // Its feedback is in. A later one was made after this one: what is older will not be executed any
  // more.
  void Settle(uint64_t id);
  void Clear() { kept_.clear(); }

  // For a snapshot, oldest first, and back.
  std::vector<Prediction> Kept() const;
  void Restore(const std::vector<Prediction>& kept, uint64_t next, uint64_t made, uint64_t dropped);
  // Whether their records are in the journal.
  void MarkJournaled();
  void MarkAsIn(const std::vector<Prediction>& before);

  uint64_t last() const { return next_ - 1; }  // number of the last one; 0: none yet
  uint64_t next() const { return next_; }
  uint64_t made() const { return made_; }        // answered
  uint64_t dropped() const { return dropped_; }  // because kMost others were made

 private:
  absl::Status NotKept(const std::string& what, const std::string& which) const;

  std::map<uint64_t, Prediction> kept_;
  uint64_t next_ = 1, made_ = 0, dropped_ = 0;
};

}  // namespace robostress
