#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// Publishes `contents` at `path`: temporary file beside it, fsync, rename, fsync of the directory.
// On failure (full disk included) nothing at `path` has changed and the temporary file is gone.
absl::Status WriteFileAtomically(const std::string& path, std::string_view contents);
absl::StatusOr<std::string> ReadFile(const std::string& path);
// The same for a file from elsewhere: refuses, before it reads, what is no regular file or exceeds
// `max_bytes`.
absl::StatusOr<std::string> ReadFileUpTo(const std::string& path, uint64_t max_bytes);
// Appends one line and flushes it to the disk.
absl::Status AppendLine(const std::string& path, std::string_view line);
absl::Status MakeDirectories(const std::string& path);
std::string Sha256Hex(std::string_view bytes);
absl::StatusOr<std::string> Sha256OfFile(const std::string& path);

}  // namespace robostress
