#pragma once

#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

struct ZSTD_DCtx_s;

namespace robostress {

// The bytes of a file, front to back, through a buffer of fixed size; of a file that ends in .zst
// or .zstd what it inflates to. One thread at a time.
class ByteSource {
 public:
  // NOT_FOUND, or INVALID_ARGUMENT where it is no regular file.
  static absl::StatusOr<std::unique_ptr<ByteSource>> Open(const std::string& path);
  ByteSource(const ByteSource&) = delete;
  ByteSource& operator=(const ByteSource&) = delete;
  ~ByteSource();

  const std::string& path() const { return path_; }
  // Bytes that were read or skipped.
  uint64_t at() const { return at_; }
  // Up to `count` bytes into `bytes`, fewer only at the end. Memory grows with what is there, not
  // with `count`. DATA_LOSS where the disk or the compression fails.
  absl::Status Read(uint64_t count, std::string* bytes);
  // How many of `count` bytes there were.
  absl::StatusOr<uint64_t> Skip(uint64_t count);

 private:
  ByteSource() = default;
  absl::Status Refill();
  absl::Status Inflate();

  std::string path_;
  std::FILE* file_ = nullptr;
  ZSTD_DCtx_s* inflater_ = nullptr;  // null: the file is not compressed
  std::string packed_, buffer_;
  size_t packed_at_ = 0, packed_end_ = 0, buffer_at_ = 0, buffer_end_ = 0;
  uint64_t at_ = 0;
};

// Whether a file is compressed as a whole, by its name.
bool IsZstdName(absl::string_view name);

// What a block of `compression` ("", "lz4": a frame, "zstd") inflates to. INVALID_ARGUMENT names
// what is wrong: damaged, or more than `most` bytes.
absl::StatusOr<std::string> InflateBlock(absl::string_view compression, absl::string_view packed,
                                         uint64_t most);

}  // namespace robostress
