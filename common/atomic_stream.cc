#include "common/atomic_stream.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

void SyncDirectoryOf(const std::string& path) {
  const std::string parent = std::filesystem::path(path).parent_path().string();
  const int fd = ::open(parent.empty() ? "." : parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

}  // namespace

absl::Status ErrnoStatus(const std::string& action, const std::string& path, int error) {
  const std::string message = absl::StrCat(action, " '", path, "': ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT) {
    return absl::ResourceExhaustedError(absl::StrCat(message, "; free some space and run again"));
  }
  if (error == ENOENT) return absl::NotFoundError(message);
  if (error == EACCES || error == EPERM || error == EROFS)
    return absl::PermissionDeniedError(message);
  return absl::UnavailableError(message);
}

absl::Status WriteAll(int fd, std::string_view bytes, const std::string& path) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return ErrnoStatus("cannot write", path, errno);
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  return absl::OkStatus();
}

absl::StatusOr<AtomicStream> AtomicStream::Create(const std::string& path) {
  static std::atomic<uint64_t> counter{0};
  std::string temporary = absl::StrCat(path, ".tmp.", ::getpid(), ".", counter++);
  const int fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) return ErrnoStatus("cannot create", temporary, errno);
  return AtomicStream(path, std::move(temporary), fd);
}

AtomicStream::AtomicStream(AtomicStream&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::move(other.temporary_)),
      fd_(std::exchange(other.fd_, -1)) {}

AtomicStream::~AtomicStream() {
  if (fd_ < 0) return;
  ::close(fd_);
  ::unlink(temporary_.c_str());
}

absl::Status AtomicStream::Append(std::string_view bytes) {
  return WriteAll(fd_, bytes, temporary_);
}

absl::Status AtomicStream::Publish() {
  absl::Status status;
  if (::fsync(fd_) != 0) status = ErrnoStatus("cannot sync", temporary_, errno);
  if (::close(std::exchange(fd_, -1)) != 0 && status.ok())
    status = ErrnoStatus("cannot close", temporary_, errno);
  if (status.ok() && ::rename(temporary_.c_str(), path_.c_str()) != 0)
    status = ErrnoStatus("cannot publish", path_, errno);
  if (status.ok())
    SyncDirectoryOf(path_);
  else
    ::unlink(temporary_.c_str());
  return status;
}

}  // namespace robostress
