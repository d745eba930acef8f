#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "common/atomic_stream.h"
#include "common/safetensors.h"

namespace robostress {

// Writes a safetensors file that need not fit in memory: the header first, then the bytes of each
// entry in order. The file appears at `path` only when Finish succeeds.
class SafetensorsStream {
 public:
  struct Entry {
    std::string name;
    DType dtype = DType::kF32;
    std::vector<int64_t> shape;
    uint64_t bytes() const;
  };

  // Entries lie in the given order; larger element types first keep all of them aligned.
  static absl::StatusOr<SafetensorsStream> Create(
      const std::string& path, const std::map<std::string, std::string>& metadata,
      const std::vector<Entry>& entries);

  // The next bytes of the data; pieces need not end with an entry.
  absl::Status Append(absl::Span<const uint8_t> bytes);
  // Fails unless exactly the bytes of all entries were appended.
  absl::Status Finish();

 private:
  SafetensorsStream(AtomicStream file, uint64_t remaining)
      : file_(std::move(file)), remaining_(remaining) {}

  AtomicStream file_;
  uint64_t remaining_ = 0;  // [bytes] of data to come
};

}  // namespace robostress
