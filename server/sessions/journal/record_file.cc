#include "server/sessions/journal/record_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint32_t kMagic = 0x31525352;        // "RSR1"
constexpr size_t kFrame = 20;                  // bytes before the payload
constexpr size_t kWindow = size_t{256} << 10;  // [bytes] of a file looked through at once

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

// CRC-32 that goes on from `crc`: 0, then a frame's length and number, then the payload.
uint32_t Crc(uint32_t crc, std::string_view bytes) {
  return static_cast<uint32_t>(
      crc32(crc, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uInt>(bytes.size())));
}

// Of a frame's length and number, which lie together.
uint32_t CrcOfFrame(const char* frame) { return Crc(0, {frame + 4, 12}); }

std::array<char, kFrame> Frame(uint64_t number, std::string_view payload) {
  std::array<char, kFrame> frame;
  const auto length = static_cast<uint32_t>(payload.size());
  std::memcpy(&frame[0], &kMagic, 4);
  std::memcpy(&frame[4], &length, 4);
  std::memcpy(&frame[8], &number, 8);
  const uint32_t crc = Crc(CrcOfFrame(frame.data()), payload);
  std::memcpy(&frame[16], &crc, 4);
  return frame;
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

namespace {

// Bytes that are read where they are asked for.
struct Source {
  const std::string& name;
  uint64_t size = 0;
  absl::FunctionRef<absl::Status(uint64_t offset, char* into, size_t size)> read;
};

struct Framed {
  uint64_t offset = 0, number = 0;
  uint32_t length = 0;
  uint32_t crc_of_frame = 0, crc = 0;
};

// What says that it is a record at `offset` and ends within the source.
absl::StatusOr<std::optional<Framed>> FrameAt(const Source& source, uint64_t offset) {
  if (source.size - offset < kFrame) return std::nullopt;
  char frame[kFrame];
  RS_RETURN_IF_ERROR(source.read(offset, frame, kFrame));
  const uint32_t length = Load32(&frame[4]);
  if (Load32(frame) != kMagic || length > kMaxRecordBytes || length > source.size - offset - kFrame)
    return std::nullopt;
  return Framed{offset, Load64(&frame[8]), length, CrcOfFrame(frame), Load32(&frame[16])};
}

// Whether its payload is what was written; a window of it in memory at a time.
absl::StatusOr<bool> IsWhole(const Source& source, const Framed& framed) {
  uint32_t crc = framed.crc_of_frame;
  std::string window;
  for (uint64_t done = 0; done < framed.length; done += window.size()) {
    window.resize(std::min<uint64_t>(kWindow, framed.length - done));
    RS_RETURN_IF_ERROR(source.read(framed.offset + kFrame + done, window.data(), window.size()));
    crc = Crc(crc, window);
  }
  return crc == framed.crc;
}

// Whether a whole record with a number above `after` starts anywhere from `offset` on.
absl::StatusOr<bool> WholeRecordFollows(const Source& source, uint64_t offset, uint64_t after) {
  const std::string_view magic(reinterpret_cast<const char*>(&kMagic), 4);
  std::string window;
  while (source.size - offset >= kFrame) {
    window.resize(std::min<uint64_t>(kWindow, source.size - offset));
    RS_RETURN_IF_ERROR(source.read(offset, window.data(), window.size()));
    for (size_t at = window.find(magic); at != std::string::npos; at = window.find(magic, at + 1)) {
      RS_ASSIGN_OR_RETURN(const std::optional<Framed> framed, FrameAt(source, offset + at));
      if (!framed || framed->number <= after) continue;
      RS_ASSIGN_OR_RETURN(const bool whole, IsWhole(source, *framed));
      if (whole) return true;
    }
    offset += window.size() - (magic.size() - 1);  // one may lie across the window's end
  }
  return false;
}

absl::StatusOr<RecordExtent> ReadFrom(const Source& source, bool may_be_torn,
                                      absl::FunctionRef<absl::Status(std::string_view)> take) {
  RecordExtent extent;
  std::string payload;  // one record at a time
  while (extent.bytes < source.size) {
    RS_ASSIGN_OR_RETURN(const std::optional<Framed> framed, FrameAt(source, extent.bytes));
    bool whole = false;
    if (framed) {
      payload.resize(framed->length);
      RS_RETURN_IF_ERROR(source.read(extent.bytes + kFrame, payload.data(), payload.size()));
      whole = Crc(framed->crc_of_frame, payload) == framed->crc;
    }
    if (!whole || framed->number != extent.records + 1) {
      if (may_be_torn && !whole) {
        RS_ASSIGN_OR_RETURN(const bool follows,
                            WholeRecordFollows(source, extent.bytes + 1, extent.records));
        extent.torn = !follows;
        if (extent.torn) return extent;
      }
      return absl::DataLossError(
          absl::StrCat(source.name, ": record ", extent.records + 1, " at byte ", extent.bytes,
                       " is damaged; restore the file, or remove the session's folder to start it "
                       "anew"));
    }
    RS_RETURN_IF_ERROR(take(payload));
    ++extent.records;
    extent.bytes += kFrame + payload.size();
  }
  return extent;
}

}  // namespace

absl::StatusOr<RecordExtent> ReadRecordBytes(
    const std::string& name, std::string_view bytes, bool may_be_torn,
    absl::FunctionRef<absl::Status(std::string_view)> take) {
  const auto copy = [bytes](uint64_t offset, char* into, size_t size) {
    if (size > 0) std::memcpy(into, bytes.data() + offset, size);
    return absl::OkStatus();
  };
  return ReadFrom({name, bytes.size(), copy}, may_be_torn, take);
}

absl::StatusOr<RecordExtent> ReadRecords(const std::string& path, bool may_be_torn,
                                         absl::FunctionRef<absl::Status(std::string_view)> take) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return Errno("cannot open", path, errno);
  const absl::Cleanup close = [fd] { ::close(fd); };
  struct stat file;
  if (::fstat(fd, &file) != 0) return Errno("cannot read", path, errno);
  const auto read = [&path, fd](uint64_t offset, char* into, size_t size) -> absl::Status {
    while (size > 0) {
      const ssize_t count = ::pread(fd, into, size, static_cast<off_t>(offset));
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) return Errno("cannot read", path, count == 0 ? EIO : errno);
      into += count;
      offset += static_cast<uint64_t>(count);
      size -= static_cast<size_t>(count);
    }
    return absl::OkStatus();
  };
  return ReadFrom({path, static_cast<uint64_t>(file.st_size), read}, may_be_torn, take);
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
