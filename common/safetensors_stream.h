#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "common/safetensors.h"

namespace robostress {

// Writes a safetensors file that need not fit in memory: the header first, then the bytes of each
// entry in order. The file appears at `path` only when Finish succeeds (temporary file, fsync,
// rename); one that was not finished leaves nothing behind.
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
  SafetensorsStream(SafetensorsStream&& other) noexcept;
  SafetensorsStream& operator=(SafetensorsStream&&) = delete;
  ~SafetensorsStream();

  // The next bytes of the data; pieces need not end with an entry.
  absl::Status Append(absl::Span<const uint8_t> bytes);
  // Fails unless exactly the bytes of all entries were appended.
  absl::Status Finish();

 private:
  SafetensorsStream(std::string path, std::string temporary, int fd, uint64_t remaining)
      : path_(std::move(path)), temporary_(std::move(temporary)), fd_(fd), remaining_(remaining) {}
  absl::Status Write(absl::Span<const uint8_t> bytes);

  std::string path_, temporary_;
  int fd_ = -1;
  uint64_t remaining_ = 0;  // [bytes] of data to come
};

}  // namespace robostress
