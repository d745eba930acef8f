#pragma once

#include <cstdint>
#include <deque>

#include "absl/status/status.h"
#include "common/types.h"

namespace robostress {

// The client's side of exactly-once feedback: executed chunks in the order of their sequence
// numbers 1, 2, 3 ..., each kept until the server has acknowledged it. What is kept is sent again
// after a lost stream; the server takes every number once. One thread.
class ChunkLedger {
 public:
  explicit ChunkLedger(size_t capacity = 4096) : capacity_(capacity) {}

  uint64_t sent() const { return sent_; }                          // last number given out; 0: none
  uint64_t acknowledged() const { return acknowledged_; }          // watermark
  const std::deque<ExecutedChunk>& kept() const { return kept_; }  // after the watermark

  // FAILED_PRECONDITION unless chunk.sequence is sent() + 1, or when `capacity` chunks are kept:
  // then the chunk is not.
  absl::Status Add(ExecutedChunk chunk);
  // Every chunk up to `watermark` is in. INTERNAL if that was never sent; DATA_LOSS if it is below
  // an earlier one: the server has lost what it acknowledged.
  absl::Status Acknowledge(uint64_t watermark);
  // The oldest kept chunk was refused for good: it is dropped and those after it take its number
  // on.
  void DropOldest();
  // Feedback goes on after `sequence` (an imported adapter); nothing is kept.
  void Restart(uint64_t sequence);

 private:
  size_t capacity_;
  uint64_t sent_ = 0, acknowledged_ = 0;
  std::deque<ExecutedChunk> kept_;
};

}  // namespace robostress
