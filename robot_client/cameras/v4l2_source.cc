#include "robot_client/cameras/v4l2_source.h"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <pthread.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "robot_client/cameras/pixel_formats.h"

namespace robostress {
namespace {

constexpr int kPoll_ms = 200;
constexpr int kReopenPolls = 5;  // one second between attempts to open a lost device

class LinuxV4l2 : public V4l2System {
 public:
  int Open(const char* path) override { return open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC); }
  int Close(int fd) override { return close(fd); }
  int Ioctl(int fd, unsigned long request, void* argument) override {
    int result;
    do {
      result = ioctl(fd, request, argument);
    } while (result < 0 && errno == EINTR);
    return result;
  }
  void* Map(int fd, size_t length, off_t offset) override {
    return mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, fd, offset);
  }
  int Unmap(void* memory, size_t length) override { return munmap(memory, length); }
  int Poll(int fd, int timeout_ms) override {
    pollfd wait{fd, POLLIN, 0};
    const int ready = poll(&wait, 1, timeout_ms);
    if (ready < 0) return errno == EINTR ? 0 : -1;
    if (wait.revents & (POLLERR | POLLHUP | POLLNVAL)) {
      errno = ENODEV;
      return -1;
    }
    return ready;
  }
};

}  // namespace

std::unique_ptr<V4l2System> MakeV4l2System() { return std::make_unique<LinuxV4l2>(); }

V4l2Source::V4l2Source(V4l2SourceOptions options, std::unique_ptr<V4l2System> system, Clock* clock)
    : options_(std::move(options)), system_(std::move(system)), clock_(clock) {}

V4l2Source::~V4l2Source() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  Close();
}

absl::Status V4l2Source::SystemError(const std::string& what) const {
  const int error = errno;
  const std::string message = absl::StrCat("camera '", options_.name, "' (", options_.device,
                                           "): ", what, ": ", std::strerror(error));
  if (error == EBUSY)
    return absl::UnavailableError(absl::StrCat(message, "; another program uses it"));
  if (error == ENOENT || error == ENODEV || error == ENXIO)
    return absl::UnavailableError(absl::StrCat(message, "; plug it in or see /dev/v4l/by-id"));
  if (error == EACCES)
    return absl::PermissionDeniedError(absl::StrCat(message, "; add the user to group video"));
  return absl::UnavailableError(message);
}

absl::Status V4l2Source::SetFormat() {
  v4l2_capability capability{};
  if (system_->Ioctl(fd_, VIDIOC_QUERYCAP, &capability) < 0) return SystemError("no V4L2 device");
  const uint32_t can = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) ? capability.device_caps
                                                                        : capability.capabilities;
  if (!(can & V4L2_CAP_VIDEO_CAPTURE) || !(can & V4L2_CAP_STREAMING)) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera '", options_.name, "' (", options_.device,
                     ") does not stream pictures; a camera often has several nodes, take the one "
                     "with index 0"));
  }
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = static_cast<uint32_t>(options_.width);
  format.fmt.pix.height = static_cast<uint32_t>(options_.height);
  format.fmt.pix.pixelformat = V4L2_PIX_FMT_YUYV;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  if (system_->Ioctl(fd_, VIDIOC_S_FMT, &format) < 0) return SystemError("VIDIOC_S_FMT");
  if (format.fmt.pix.pixelformat != V4L2_PIX_FMT_YUYV ||
      format.fmt.pix.width != static_cast<uint32_t>(options_.width) ||
      format.fmt.pix.height != static_cast<uint32_t>(options_.height)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "camera '", options_.name, "' gives ", format.fmt.pix.width, " x ", format.fmt.pix.height,
        format.fmt.pix.pixelformat == V4L2_PIX_FMT_YUYV ? " YUYV" : " in another format", ", not ",
        options_.width, " x ", options_.height,
        " YUYV; choose one of `v4l2-ctl --list-formats-ext`"));
  }
  stride_ = static_cast<int>(format.fmt.pix.bytesperline);
  if (stride_ == 0) stride_ = 2 * options_.width;
  v4l2_streamparm rate{};
  rate.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  rate.parm.capture.timeperframe = {1000,
                                    static_cast<uint32_t>(std::lround(options_.rate_hz * 1000))};
  // Not every camera can choose; the age of its pictures is watched anyway.
  static_cast<void>(system_->Ioctl(fd_, VIDIOC_S_PARM, &rate));
  return absl::OkStatus();
}

absl::Status V4l2Source::MapBuffers() {
  v4l2_requestbuffers request{};
  request.count = static_cast<uint32_t>(options_.buffers);
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  if (system_->Ioctl(fd_, VIDIOC_REQBUFS, &request) < 0) return SystemError("VIDIOC_REQBUFS");
  if (request.count < 2) {
    return absl::ResourceExhaustedError(absl::StrCat("camera '", options_.name, "' grants ",
                                                     request.count, " buffers, 2 are needed"));
  }
  for (uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.index = i;
    if (system_->Ioctl(fd_, VIDIOC_QUERYBUF, &buffer) < 0) return SystemError("VIDIOC_QUERYBUF");
    void* memory = system_->Map(fd_, buffer.length, buffer.m.offset);
    if (memory == MAP_FAILED) return SystemError("mmap of a picture buffer");
    mappings_.push_back({memory, buffer.length});
    if (system_->Ioctl(fd_, VIDIOC_QBUF, &buffer) < 0) return SystemError("VIDIOC_QBUF");
  }
  return absl::OkStatus();
}

absl::Status V4l2Source::Open() {
  fd_ = system_->Open(options_.device.c_str());
  if (fd_ < 0) return SystemError("open");
  RS_RETURN_IF_ERROR(SetFormat());
  RS_RETURN_IF_ERROR(MapBuffers());
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (system_->Ioctl(fd_, VIDIOC_STREAMON, &type) < 0) return SystemError("VIDIOC_STREAMON");
  streaming_ = true;
  return absl::OkStatus();
}

void V4l2Source::Close() {
  if (fd_ < 0) return;
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (streaming_) static_cast<void>(system_->Ioctl(fd_, VIDIOC_STREAMOFF, &type));
  for (const Mapping& mapping : mappings_) system_->Unmap(mapping.memory, mapping.length);
  mappings_.clear();
  system_->Close(fd_);
  fd_ = -1;
  streaming_ = false;
}

absl::Status V4l2Source::Start() {
  const absl::Status opened = Open();
  if (!opened.ok()) {
    Close();
    return opened;
  }
  thread_ = std::thread([this] { Run(); });
  return absl::OkStatus();
}

absl::Status V4l2Source::TakePicture() {
  const int ready = system_->Poll(fd_, kPoll_ms);
  if (ready < 0) return SystemError("poll");
  if (ready == 0) return absl::OkStatus();
  v4l2_buffer buffer{};
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  if (system_->Ioctl(fd_, VIDIOC_DQBUF, &buffer) < 0)
    return errno == EAGAIN ? absl::OkStatus() : SystemError("VIDIOC_DQBUF");
  const int64_t now = clock_->now_ns();
  if (buffer.index >= mappings_.size() || buffer.bytesused > mappings_[buffer.index].length)
    return absl::DataLossError(absl::StrCat("camera '", options_.name, "' gave buffer ",
                                            buffer.index, " with ", buffer.bytesused, " bytes"));
  // A picture that the driver marks as damaged, or that is short, is passed over.
  if (!(buffer.flags & V4L2_BUF_FLAG_ERROR)) {
    const Mapping& mapping = mappings_[buffer.index];
    absl::StatusOr<Image> image =
        RgbFromYuyv({static_cast<const char*>(mapping.memory), buffer.bytesused}, options_.width,
                    options_.height, stride_);
    if (image.ok()) {
      auto frame = std::make_shared<Frame>();
      frame->image = *std::move(image);
      const bool monotonic =
          (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
      frame->stamp_ns = monotonic ? buffer.timestamp.tv_sec * int64_t{1'000'000'000} +
                                        buffer.timestamp.tv_usec * int64_t{1000}
                                  : now;
      const int64_t stamp = frame->stamp_ns;
      absl::MutexLock lock(&mu_);
      if (FromTheFuture(stamp, now)) {
        status_ = FutureStampError(options_.name, stamp, now);
      } else {
        frame->sequence = ++taken_;
        newest_ = std::move(frame);
        status_ = absl::OkStatus();
        stamp_ns_.store(stamp, std::memory_order_release);
      }
    }
  }
  if (system_->Ioctl(fd_, VIDIOC_QBUF, &buffer) < 0) return SystemError("VIDIOC_QBUF");
  return absl::OkStatus();
}

void V4l2Source::Run() {
  pthread_setname_np(pthread_self(), absl::StrCat("cam-", options_.name).substr(0, 15).c_str());
  int polls_until_open = 0;
  while (!stop_) {
    if (fd_ < 0) {
      if (polls_until_open-- > 0) {
        std::this_thread::sleep_for(std::chrono::milliseconds(kPoll_ms));
        continue;
      }
      const absl::Status opened = Open();
      if (opened.ok()) continue;
      Close();
      polls_until_open = kReopenPolls;
      absl::MutexLock lock(&mu_);
      status_ = opened;
      continue;
    }
    const absl::Status taken = TakePicture();
    if (taken.ok()) continue;
    Close();
    polls_until_open = kReopenPolls;
    absl::MutexLock lock(&mu_);
    status_ = taken;
  }
}

std::shared_ptr<const Frame> V4l2Source::Latest() {
  absl::MutexLock lock(&mu_);
  return newest_;
}

absl::Status V4l2Source::status() const {
  absl::MutexLock lock(&mu_);
  return status_;
}

}  // namespace robostress
