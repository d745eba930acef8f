#include "robot_client/cameras/mapped_frames.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr char kMagic[8] = {'R', 'S', 'F', 'R', 'A', 'M', 'E', '1'};
constexpr int kMaxSide = 4096;
constexpr int64_t kReopen_ns = 1'000'000'000;

struct Header {
  char magic[8];
  int32_t width, height;
};
struct Slot {  // the picture follows
  uint64_t version;
  int64_t stamp_ns;
  uint64_t sequence;
};

size_t SlotBytes(int width, int height) {
  return sizeof(Slot) + (size_t{3} * width * height + 7) / 8 * 8;
}
size_t FileBytes(int width, int height) { return sizeof(Header) + 2 * SlotBytes(width, height); }
off_t SlotAt(int width, int height, uint64_t index) {
  return static_cast<off_t>(sizeof(Header) + (index % 2) * SlotBytes(width, height));
}

bool Valid(const Header& header) {
  return std::memcmp(header.magic, kMagic, sizeof(kMagic)) == 0 && header.width >= 1 &&
         header.height >= 1 && header.width <= kMaxSide && header.height <= kMaxSide;
}

bool ReadAt(int fd, void* to, size_t bytes, off_t at) {
  auto* out = static_cast<char*>(to);
  while (bytes > 0) {
    const ssize_t read = pread(fd, out, bytes, at);
    if (read < 0 && errno == EINTR) continue;
    if (read <= 0) return false;  // the end: it was truncated meanwhile
    out += read;
    at += read;
    bytes -= static_cast<size_t>(read);
  }
  return true;
}

bool WriteAt(int fd, const void* from, size_t bytes, off_t at) {
  const auto* in = static_cast<const char*>(from);
  while (bytes > 0) {
    const ssize_t written = pwrite(fd, in, bytes, at);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    in += written;
    at += written;
    bytes -= static_cast<size_t>(written);
  }
  return true;
}

absl::Status FileError(const std::string& path, const char* what) {
  return absl::UnavailableError(absl::StrCat(path, ": ", what, ": ", std::strerror(errno)));
}

}  // namespace

absl::StatusOr<std::unique_ptr<MappedFrameWriter>> MappedFrameWriter::Create(
    const std::string& path, int width, int height) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": pictures of ", width, " x ", height,
                                                   ", must be 1..", kMaxSide, " a side"));
  }
  const std::string temporary = absl::StrCat(path, ".", getpid());
  auto writer = std::unique_ptr<MappedFrameWriter>(new MappedFrameWriter());
  writer->fd_ = open(temporary.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (writer->fd_ < 0) return FileError(temporary, "open");
  writer->path_ = path;
  writer->width_ = width;
  writer->height_ = height;
  writer->slot_.resize(SlotBytes(width, height));
  Header header{{}, width, height};
  std::memcpy(header.magic, kMagic, sizeof(kMagic));
  if (ftruncate(writer->fd_, static_cast<off_t>(FileBytes(width, height))) != 0 ||
      !WriteAt(writer->fd_, &header, sizeof(header), 0))
    return FileError(temporary, "write");
  if (rename(temporary.c_str(), path.c_str()) != 0) return FileError(path, "rename");
  return writer;
}

MappedFrameWriter::~MappedFrameWriter() {
  if (fd_ >= 0) close(fd_);
}

absl::Status MappedFrameWriter::Write(const Image& image, int64_t stamp_ns) {
  if (image.width != width_ || image.height != height_) {
    return absl::InvalidArgumentError(absl::StrCat("a picture of ", image.width, " x ",
                                                   image.height, " for a file of ", width_, " x ",
                                                   height_));
  }
  ++sequence_;
  const off_t at = SlotAt(width_, height_, sequence_);
  Header header{{}, width_, height_};
  std::memcpy(header.magic, kMagic, sizeof(kMagic));
  const Slot slot{2 * sequence_ - 1, stamp_ns, sequence_};
  std::memcpy(slot_.data(), &slot, sizeof(slot));
  std::memcpy(slot_.data() + sizeof(slot), image.data.data(), image.data.size());
  const uint64_t whole = 2 * sequence_;
  // The fences keep the kernel's copies in this order on machines that reorder stores.
  bool written = WriteAt(fd_, &header, sizeof(header), 0) &&
                 WriteAt(fd_, &slot.version, sizeof(slot.version), at);
  std::atomic_thread_fence(std::memory_order_seq_cst);
  written = written && WriteAt(fd_, slot_.data(), slot_.size(), at);
  std::atomic_thread_fence(std::memory_order_seq_cst);
  written = written && WriteAt(fd_, &whole, sizeof(whole), at);
  return written ? absl::OkStatus() : FileError(path_, "write");
}

// The newer whole picture of the file, or why there is none.
struct MappedSource::Found {
  enum class Fault { kNone, kNoFile, kForeign, kTruncated, kEmpty, kFuture };
  Fault fault = Fault::kNoFile;
  off_t bytes = 0;  // of the file
  Header header{};
  off_t at = 0;  // of the slot
  Slot slot{};
};

MappedSource::Found MappedSource::Find() const {
  using Fault = Found::Fault;
  Found found;
  const int fd = fd_.load(std::memory_order_acquire);
  struct stat info {};
  if (fd < 0 || fstat(fd, &info) != 0) return found;
  found.bytes = info.st_size;
  found.fault = Fault::kTruncated;
  if (!ReadAt(fd, &found.header, sizeof(Header), 0)) return found;
  found.fault = Fault::kForeign;
  const auto [magic, width, height] = found.header;
  if (!Valid(found.header)) return found;
  found.fault = Fault::kTruncated;
  if (info.st_size < static_cast<off_t>(FileBytes(width, height))) return found;
  found.fault = Fault::kEmpty;
  for (const uint64_t i : {0, 1}) {
    Slot slot{};
    const off_t at = SlotAt(width, height, i);
    if (!ReadAt(fd, &slot, sizeof(slot), at) || slot.version % 2 != 0) continue;
    if (slot.sequence <= found.slot.sequence || slot.stamp_ns <= 0) continue;
    found.fault = FromTheFuture(slot.stamp_ns, clock_->now_ns()) ? Fault::kFuture : Fault::kNone;
    found.slot = slot;
    found.at = at;
  }
  return found;
}

MappedSource::MappedSource(std::string name, std::string path, const Clock* clock)
    : name_(std::move(name)), path_(std::move(path)), clock_(clock) {}

MappedSource::~MappedSource() {
  if (const int fd = fd_.load(); fd >= 0) close(fd);
}

absl::Status MappedSource::Open() {
  opened_ns_ = clock_->now_ns();
  // A pipe without a writer would wait here for ever.
  const int fd = open(path_.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return FileError(path_, "open; is the emulator running with --views?");
  Header header{};
  struct stat info {};
  if (fstat(fd, &info) != 0 || !S_ISREG(info.st_mode) || !ReadAt(fd, &header, sizeof(header), 0) ||
      !Valid(header) ||
      info.st_size != static_cast<off_t>(FileBytes(header.width, header.height))) {
    close(fd);
    return absl::DataLossError(absl::StrCat(path_, " does not hold pictures of this version"));
  }
  const int held = fd_.load(std::memory_order_acquire);
  if (held < 0) {
    fd_.store(fd, std::memory_order_release);
    return absl::OkStatus();
  }
  const bool taken = dup3(fd, held, O_CLOEXEC) >= 0;
  close(fd);
  return taken ? absl::OkStatus() : FileError(path_, "dup3");
}

absl::Status MappedSource::Start() { return Open(); }

int64_t MappedSource::newest_stamp_ns() const {
  const Found found = Find();
  if (found.fault == Found::Fault::kNone) stamp_ns_.store(found.slot.stamp_ns);
  return stamp_ns_.load();
}

std::shared_ptr<const Frame> MappedSource::Latest() {
  const int64_t now = clock_->now_ns();
  if (now - newest_stamp_ns() > kReopen_ns && now - opened_ns_ > kReopen_ns) Open().IgnoreError();
  // A writer that laps the copy is rare: two pictures in the time of one memcpy.
  for (int attempt = 0; attempt < 4; ++attempt) {
    const Found found = Find();
    if (found.fault != Found::Fault::kNone) return newest_;
    if (newest_ != nullptr && newest_->sequence == found.slot.sequence &&
        newest_->stamp_ns == found.slot.stamp_ns)
      return newest_;
    auto frame = std::make_shared<Frame>();
    frame->stamp_ns = found.slot.stamp_ns;
    frame->sequence = found.slot.sequence;
    frame->image.width = found.header.width;
    frame->image.height = found.header.height;
    frame->image.data.resize(size_t{3} * found.header.width * found.header.height);
    const int fd = fd_.load(std::memory_order_acquire);
    uint64_t version = 0;
    std::atomic_thread_fence(std::memory_order_seq_cst);
    bool read = ReadAt(fd, frame->image.data.data(), frame->image.data.size(),
                       found.at + static_cast<off_t>(sizeof(Slot)));
    std::atomic_thread_fence(std::memory_order_seq_cst);
    read = read && ReadAt(fd, &version, sizeof(version), found.at);
    if (read && version == found.slot.version) return newest_ = std::move(frame);
  }
  return newest_;
}

absl::Status MappedSource::status() const {
  using Fault = Found::Fault;
  const Found found = Find();
  const int64_t now = clock_->now_ns();
  const std::string camera = absl::StrCat("camera '", name_, "': ", path_);
  switch (found.fault) {
    case Fault::kForeign:
      return absl::DataLossError(
          absl::StrCat(camera,
                       " no longer holds pictures of this version; something else wrote "
                       "over it: start what writes the pictures anew"));
    case Fault::kTruncated:
      return absl::DataLossError(absl::StrCat(
          camera, " is truncated: ", found.bytes, " bytes",
          Valid(found.header)
              ? absl::StrCat(" of ", FileBytes(found.header.width, found.header.height))
              : "",
          "; start what writes the pictures anew, or see that its disk is not full"));
    case Fault::kFuture:
      return FutureStampError(name_, found.slot.stamp_ns, now);
    case Fault::kNone:
      if (now - found.slot.stamp_ns < kReopen_ns) return absl::OkStatus();
      break;
    case Fault::kNoFile:
    case Fault::kEmpty:
      break;
  }
  return absl::UnavailableError(
      absl::StrCat("camera '", name_, "': nobody writes pictures to ", path_));
}

}  // namespace robostress
