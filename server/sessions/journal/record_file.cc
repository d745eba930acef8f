#include "server/sessions/journal/record_file.h"

#include <fcntl.h>
#include <sys/uio.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint32_t kMagic = 0x31525352;  // "RSR1"
constexpr size_t kFrame = 20;            // bytes before the payload
constexpr uint64_t kMaxFileBytes = uint64_t{16} << 30;

uint32_t Load32(const char* bytes) {
  uint32_t value = 0;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

uint64_t Load64(const char* bytes) {
  uint64_t value = 0;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

// Over the frame's length and number, which lie together, and the payload.
uint32_t Crc(const char* length_and_number, std::string_view payload) {
  uLong crc = crc32(0, reinterpret_cast<const Bytef*>(length_and_number), 12);
  crc =
      crc32(crc, reinterpret_cast<const Bytef*>(payload.data()), static_cast<uInt>(payload.size()));
  return static_cast<uint32_t>(crc);
}

std::array<char, kFrame> Frame(uint64_t number, std::string_view payload) {
  std::array<char, kFrame> frame;
  const auto length = static_cast<uint32_t>(payload.size());
  std::memcpy(&frame[0], &kMagic, 4);
  std::memcpy(&frame[4], &length, 4);
  std::memcpy(&frame[8], &number, 8);
  const uint32_t crc = Crc(&frame[4], payload);
  std::memcpy(&frame[16], &crc, 4);
  return frame;
}

// The payload of a whole record at `offset`; null data: there is none.
std::string_view RecordAt(std::string_view bytes, size_t offset, uint64_t& number) {
  if (bytes.size() - offset < kFrame || Load32(&bytes[offset]) != kMagic) return {};
  const uint32_t length = Load32(&bytes[offset + 4]);
  if (length > kMaxRecordBytes || length > bytes.size() - offset - kFrame) return {};
  const std::string_view payload(bytes.data() + offset + kFrame, length);
  if (Crc(&bytes[offset + 4], payload) != Load32(&bytes[offset + 16])) return {};
  number = Load64(&bytes[offset + 8]);
  return payload;
}

// Whether a whole record with a number above `after` starts anywhere from `offset` on.
bool WholeRecordFollows(std::string_view bytes, size_t offset, uint64_t after) {
  const std::string_view magic(reinterpret_cast<const char*>(&kMagic), 4);
  while ((offset = bytes.find(magic, offset)) != std::string_view::npos) {
    uint64_t number = 0;
    if (RecordAt(bytes, offset, number).data() != nullptr && number > after) return true;
    ++offset;
  }
  return false;
}

absl::Status Errno(const char* action, const std::string& path, int error) {
  const std::string message = absl::StrCat(action, " '", path, "': ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT || error == EFBIG) {
    return absl::ResourceExhaustedError(
        absl::StrCat(message, "; nothing was taken: free some space and send it again"));
  }
  if (error == EEXIST) return absl::AlreadyExistsError(message);
  if (error == ENOENT) return absl::NotFoundError(message);
  return absl::UnavailableError(message);
}

}  // namespace

absl::StatusOr<std::shared_ptr<RecordWriter>> RecordWriter::Create(const std::string& path) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0600);
  if (fd < 0) return Errno("cannot create", path, errno);
  return std::shared_ptr<RecordWriter>(new RecordWriter(path, fd, 0, 0));
}

absl::StatusOr<std::shared_ptr<RecordWriter>> RecordWriter::Continue(const std::string& path,
                                                                     uint64_t records,
                                                                     uint64_t bytes) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC);
  if (fd < 0) return Errno("cannot open", path, errno);
  auto writer = std::shared_ptr<RecordWriter>(new RecordWriter(path, fd, records, bytes));
  if (::ftruncate(fd, static_cast<off_t>(bytes)) != 0) return Errno("cannot cut", path, errno);
  RS_RETURN_IF_ERROR(writer->Sync());
  return writer;
}

RecordWriter::~RecordWriter() { ::close(fd_); }

absl::Status RecordWriter::Append(std::string_view payload) {
  RS_RETURN_IF_ERROR(broken_);
  if (payload.size() > kMaxRecordBytes) {
    return absl::InvalidArgumentError(absl::StrCat("a record of ", payload.size(), " bytes for '",
                                                   path_, "' exceeds ", kMaxRecordBytes));
  }
  std::array<char, kFrame> frame = Frame(records_ + 1, payload);
  iovec parts[2] = {{frame.data(), kFrame}, {const_cast<char*>(payload.data()), payload.size()}};
  size_t written = 0;
  const size_t whole = kFrame + payload.size();
  while (written < whole) {
    const ssize_t count = ::writev(fd_, parts, 2);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      const absl::Status status = Errno("cannot write", path_, count == 0 ? ENOSPC : errno);
      if (written > 0 && ::ftruncate(fd_, static_cast<off_t>(bytes_)) != 0) {
        broken_ = absl::DataLossError(
            absl::StrCat(status.message(),
                         "; a part of the record could not be taken back: restart the server"));
        return broken_;
      }
      return status;
    }
    written += static_cast<size_t>(count);
    size_t done = static_cast<size_t>(count);
    for (iovec& part : parts) {
      const size_t step = std::min(done, part.iov_len);
      part.iov_base = static_cast<char*>(part.iov_base) + step;
      part.iov_len -= step;
      done -= step;
    }
  }
  ++records_;
  bytes_ += whole;
  return absl::OkStatus();
}

absl::Status RecordWriter::Sync() {
  if (::fdatasync(fd_) == 0) return absl::OkStatus();
  return Errno("cannot sync", path_, errno);
}

absl::StatusOr<RecordExtent> ReadRecordBytes(
    const std::string& name, std::string_view bytes, bool may_be_torn,
    absl::FunctionRef<absl::Status(std::string_view)> take) {
  RecordExtent extent;
  while (extent.bytes < bytes.size()) {
    uint64_t number = 0;
    const std::string_view payload = RecordAt(bytes, extent.bytes, number);
    if (payload.data() == nullptr || number != extent.records + 1) {
      if (may_be_torn && payload.data() == nullptr &&
          !WholeRecordFollows(bytes, extent.bytes + 1, extent.records)) {
        extent.torn = true;
        return extent;
      }
      return absl::DataLossError(
          absl::StrCat(name, ": record ", extent.records + 1, " at byte ", extent.bytes,
                       " is damaged; restore the file, or remove the session's folder to start it "
                       "anew"));
    }
    RS_RETURN_IF_ERROR(take(payload));
    ++extent.records;
    extent.bytes += kFrame + payload.size();
  }
  return extent;
}

absl::StatusOr<RecordExtent> ReadRecords(const std::string& path, bool may_be_torn,
                                         absl::FunctionRef<absl::Status(std::string_view)> take) {
  RS_ASSIGN_OR_RETURN(const std::string bytes, ReadFileUpTo(path, kMaxFileBytes));
  return ReadRecordBytes(path, bytes, may_be_torn, take);
}

absl::Status SyncDirectory(const std::string& directory) {
  const int fd = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return Errno("cannot open", directory, errno);
  const int result = ::fsync(fd);
  const int error = errno;
  ::close(fd);
  return result == 0 ? absl::OkStatus() : Errno("cannot sync", directory, error);
}

}  // namespace robostress
