#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// What went wrong at `path`, by errno: RESOURCE_EXHAUSTED where the disk is full, NOT_FOUND,
// PERMISSION_DENIED, else UNAVAILABLE.
absl::Status ErrnoStatus(const std::string& action, const std::string& path, int error);
// All of `bytes` to an open file; `path` for errors.
absl::Status WriteAll(int fd, std::string_view bytes, const std::string& path);

// A file that need not fit in memory and appears at its path whole or not at all: a temporary file
// beside it, fsync, rename, fsync of the directory. One that was not published leaves nothing.
class AtomicStream {
 public:
  static absl::StatusOr<AtomicStream> Create(const std::string& path);
  AtomicStream(AtomicStream&& other) noexcept;
  AtomicStream& operator=(AtomicStream&&) = delete;
  ~AtomicStream();

  const std::string& path() const { return path_; }
  absl::Status Append(std::string_view bytes);
  // On failure nothing at the path has changed.
  absl::Status Publish();

 private:
  AtomicStream(std::string path, std::string temporary, int fd)
      : path_(std::move(path)), temporary_(std::move(temporary)), fd_(fd) {}

  std::string path_, temporary_;
  int fd_ = -1;  // -1: published, or moved from
};

}  // namespace robostress
