#include "robot_client/cameras/mapped_frames.h"

#include <fcntl.h>
#include <sys/mman.h>
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
  std::atomic<uint64_t> version;
  std::atomic<int64_t> stamp_ns;
  std::atomic<uint64_t> sequence;
};
static_assert(std::atomic<uint64_t>::is_always_lock_free);

size_t PictureBytes(int width, int height) {
  const size_t bytes = size_t{3} * width * height;
  return (bytes + 7) / 8 * 8;
}
size_t SlotBytes(int width, int height) { return sizeof(Slot) + PictureBytes(width, height); }
size_t FileBytes(int width, int height) { return sizeof(Header) + 2 * SlotBytes(width, height); }

char* SlotAt(void* memory, int width, int height, uint64_t sequence) {
  return static_cast<char*>(memory) + sizeof(Header) + (sequence % 2) * SlotBytes(width, height);
}

// Pictures travel in words that both processes may touch at once. A word that was stored after the
// version became odd is seen with that version; on x86 and ARM these are plain moves.
void StoreWords(const uint8_t* from, size_t bytes, char* to) {
  auto* words = reinterpret_cast<uint64_t*>(to);
  for (size_t at = 0; at < bytes; at += sizeof(uint64_t)) {
    uint64_t word = 0;
    std::memcpy(&word, from + at, std::min(bytes - at, sizeof(word)));
    std::atomic_ref<uint64_t>(words[at / sizeof(word)]).store(word, std::memory_order_release);
  }
}

void LoadWords(const char* from, size_t bytes, uint8_t* to) {
  // Only read, from memory that may be mapped read-only.
  auto* words = reinterpret_cast<uint64_t*>(const_cast<char*>(from));
  for (size_t at = 0; at < bytes; at += sizeof(uint64_t)) {
    const uint64_t word =
        std::atomic_ref<uint64_t>(words[at / sizeof(word)]).load(std::memory_order_acquire);
    std::memcpy(to + at, &word, std::min(bytes - at, sizeof(word)));
  }
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
  const int fd = open(temporary.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0) return FileError(temporary, "open");
  auto writer = std::unique_ptr<MappedFrameWriter>(new MappedFrameWriter());
  writer->length_ = FileBytes(width, height);
  writer->width_ = width;
  writer->height_ = height;
  const bool sized = ftruncate(fd, static_cast<off_t>(writer->length_)) == 0;
  void* memory = sized ? mmap(nullptr, writer->length_, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0)
                       : MAP_FAILED;
  close(fd);
  if (memory == MAP_FAILED) return FileError(temporary, "mmap");
  writer->memory_ = memory;
  auto* header = static_cast<Header*>(memory);
  header->width = width;
  header->height = height;
  std::memcpy(header->magic, kMagic, sizeof(kMagic));
  if (rename(temporary.c_str(), path.c_str()) != 0) return FileError(path, "rename");
  return writer;
}

MappedFrameWriter::~MappedFrameWriter() {
  if (memory_ != nullptr) munmap(memory_, length_);
}

absl::Status MappedFrameWriter::Write(const Image& image, int64_t stamp_ns) {
  if (image.width != width_ || image.height != height_) {
    return absl::InvalidArgumentError(absl::StrCat("a picture of ", image.width, " x ",
                                                   image.height, " for a file of ", width_, " x ",
                                                   height_));
  }
  char* at = SlotAt(memory_, width_, height_, ++sequence_);
  auto* slot = reinterpret_cast<Slot*>(at);
  slot->version.fetch_add(1, std::memory_order_relaxed);
  slot->stamp_ns.store(stamp_ns, std::memory_order_release);
  slot->sequence.store(sequence_, std::memory_order_release);
  StoreWords(image.data.data(), image.data.size(), at + sizeof(Slot));
  slot->version.fetch_add(1, std::memory_order_release);
  return absl::OkStatus();
}

struct MappedSource::Mapping {
  void* memory = nullptr;
  size_t length = 0;
  int width = 0, height = 0;
  ino_t inode = 0;
  ~Mapping() { munmap(memory, length); }
  // The slot with the newer whole picture; null before the first.
  const char* Newest() const {
    const char* best = nullptr;
    uint64_t best_sequence = 0;
    for (const uint64_t i : {0, 1}) {
      const char* at = SlotAt(memory, width, height, i);
      const auto* slot = reinterpret_cast<const Slot*>(at);
      if (slot->version.load(std::memory_order_acquire) % 2 != 0) continue;
      const uint64_t sequence = slot->sequence.load(std::memory_order_acquire);
      if (sequence > best_sequence) {
        best = at;
        best_sequence = sequence;
      }
    }
    return best;
  }
};

MappedSource::MappedSource(std::string name, std::string path, const Clock* clock)
    : name_(std::move(name)), path_(std::move(path)), clock_(clock) {}

MappedSource::~MappedSource() = default;

absl::Status MappedSource::Open() {
  opened_ns_ = clock_->now_ns();
  const int fd = open(path_.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return FileError(path_, "open; is the emulator running with --views?");
  struct stat info {};
  Header header{};
  const bool read =
      fstat(fd, &info) == 0 && pread(fd, &header, sizeof(header), 0) == sizeof(header);
  const bool whole = read && std::memcmp(header.magic, kMagic, sizeof(kMagic)) == 0 &&
                     header.width >= 1 && header.height >= 1 && header.width <= kMaxSide &&
                     header.height <= kMaxSide &&
                     info.st_size == static_cast<off_t>(FileBytes(header.width, header.height));
  const Mapping* current = current_.load(std::memory_order_acquire);
  if (whole && current != nullptr && current->inode == info.st_ino) {
    close(fd);
    return absl::OkStatus();  // the same file, silent
  }
  void* memory =
      whole ? mmap(nullptr, static_cast<size_t>(info.st_size), PROT_READ, MAP_SHARED, fd, 0)
            : MAP_FAILED;
  close(fd);
  if (!whole)
    return absl::DataLossError(absl::StrCat(path_, " does not hold pictures of this version"));
  if (memory == MAP_FAILED) return FileError(path_, "mmap");
  auto mapping = std::make_unique<Mapping>();
  mapping->memory = memory;
  mapping->length = static_cast<size_t>(info.st_size);
  mapping->width = header.width;
  mapping->height = header.height;
  mapping->inode = info.st_ino;
  current_.store(mapping.get(), std::memory_order_release);
  mappings_.push_back(std::move(mapping));
  return absl::OkStatus();
}

absl::Status MappedSource::Start() { return Open(); }

int64_t MappedSource::newest_stamp_ns() const {
  const Mapping* mapping = current_.load(std::memory_order_acquire);
  const char* at = mapping == nullptr ? nullptr : mapping->Newest();
  return at == nullptr
             ? 0
             : reinterpret_cast<const Slot*>(at)->stamp_ns.load(std::memory_order_acquire);
}

std::shared_ptr<const Frame> MappedSource::Latest() {
  const int64_t now = clock_->now_ns();
  if (now - newest_stamp_ns() > kReopen_ns && now - opened_ns_ > kReopen_ns) Open().IgnoreError();
  const Mapping* mapping = current_.load(std::memory_order_acquire);
  if (mapping == nullptr) return newest_;
  // A writer that laps the copy is rare: two pictures in the time of one memcpy.
  for (int attempt = 0; attempt < 4; ++attempt) {
    const char* at = mapping->Newest();
    if (at == nullptr) return newest_;
    const auto* slot = reinterpret_cast<const Slot*>(at);
    const uint64_t version = slot->version.load(std::memory_order_acquire);
    auto frame = std::make_shared<Frame>();
    frame->stamp_ns = slot->stamp_ns.load(std::memory_order_acquire);
    frame->sequence = slot->sequence.load(std::memory_order_acquire);
    frame->image.width = mapping->width;
    frame->image.height = mapping->height;
    frame->image.data.resize(size_t{3} * mapping->width * mapping->height);
    LoadWords(at + sizeof(Slot), frame->image.data.size(), frame->image.data.data());
    if (version % 2 == 0 && slot->version.load(std::memory_order_relaxed) == version)
      return newest_ = std::move(frame);
  }
  return newest_;
}

absl::Status MappedSource::status() const {
  const int64_t stamp = newest_stamp_ns();
  if (stamp != 0 && clock_->now_ns() - stamp < kReopen_ns) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("camera '", name_, "': nobody writes pictures to ", path_));
}

}  // namespace robostress
