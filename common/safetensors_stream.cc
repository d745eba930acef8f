#include "common/safetensors_stream.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

absl::Status Failed(const char* action, const std::string& path, int error) {
  const std::string message =
      absl::StrCat("cannot ", action, " '", path, "': ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT) {
    return absl::ResourceExhaustedError(absl::StrCat(message, "; free some space and run again"));
  }
  return absl::UnavailableError(message);
}

// Length and text of the header, padded so that the data begins at a multiple of 8.
absl::StatusOr<std::string> Header(const std::map<std::string, std::string>& metadata,
                                   const std::vector<SafetensorsStream::Entry>& entries) {
  nlohmann::json header = nlohmann::json::object();
  if (!metadata.empty()) header["__metadata__"] = metadata;
  uint64_t offset = 0;
  for (const SafetensorsStream::Entry& entry : entries) {
    if (header.contains(entry.name)) {
      return absl::InvalidArgumentError(absl::StrCat("tensor '", entry.name, "' is listed twice"));
    }
    const uint64_t end = offset + entry.bytes();
    header[entry.name] = {
        {"dtype", DTypeName(entry.dtype)}, {"shape", entry.shape}, {"data_offsets", {offset, end}}};
    offset = end;
  }
  std::string text = header.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  text.append((8 - text.size() % 8) % 8, ' ');
  const uint64_t size = text.size();
  return std::string(reinterpret_cast<const char*>(&size), sizeof(size)) + text;
}

}  // namespace

uint64_t SafetensorsStream::Entry::bytes() const {
  uint64_t bytes = DTypeSize(dtype);
  for (const int64_t extent : shape) bytes *= static_cast<uint64_t>(extent);
  return bytes;
}

absl::StatusOr<SafetensorsStream> SafetensorsStream::Create(
    const std::string& path, const std::map<std::string, std::string>& metadata,
    const std::vector<Entry>& entries) {
  RS_ASSIGN_OR_RETURN(const std::string header, Header(metadata, entries));
  const std::string temporary = absl::StrCat(path, ".tmp.", ::getpid());
  const int fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) return Failed("create", temporary, errno);
  uint64_t data = 0;
  for (const Entry& entry : entries) data += entry.bytes();
  SafetensorsStream stream(path, temporary, fd, data);
  RS_RETURN_IF_ERROR(
      stream.Write({reinterpret_cast<const uint8_t*>(header.data()), header.size()}));
  return stream;
}

SafetensorsStream::SafetensorsStream(SafetensorsStream&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::move(other.temporary_)),
      fd_(std::exchange(other.fd_, -1)),
      remaining_(other.remaining_) {}

SafetensorsStream::~SafetensorsStream() {
  if (fd_ < 0) return;
  ::close(fd_);
  ::unlink(temporary_.c_str());
}

absl::Status SafetensorsStream::Write(absl::Span<const uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd_, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return Failed("write", temporary_, errno);
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  return absl::OkStatus();
}

absl::Status SafetensorsStream::Append(absl::Span<const uint8_t> bytes) {
  if (bytes.size() > remaining_) {
    return absl::FailedPreconditionError(absl::StrCat(
        path_, ": ", bytes.size(), " bytes to write, its header has room for ", remaining_));
  }
  remaining_ -= bytes.size();
  return Write(bytes);
}

absl::Status SafetensorsStream::Finish() {
  if (remaining_ != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(path_, ": ", remaining_, " bytes of its header's are missing"));
  }
  if (::fsync(fd_) != 0) return Failed("sync", temporary_, errno);
  if (::rename(temporary_.c_str(), path_.c_str()) != 0) return Failed("publish", path_, errno);
  ::close(std::exchange(fd_, -1));
  return absl::OkStatus();
}

}  // namespace robostress
