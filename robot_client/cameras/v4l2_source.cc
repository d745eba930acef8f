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
#include "robot_client/cameras/jpeg.h"
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
  const double enough = 0.9 * options_.rate_hz;
  absl::StatusOr<double> yuyv = absl::NotFoundError("not asked for"), mjpeg = yuyv;
  if (options_.format != V4l2Format::kMjpeg) yuyv = TryFormat(V4L2_PIX_FMT_YUYV);
  if (yuyv.ok() && (options_.format == V4l2Format::kYuyv || *yuyv == 0 || *yuyv >= enough))
    return absl::OkStatus();
  if (options_.format != V4l2Format::kYuyv) mjpeg = TryFormat(V4L2_PIX_FMT_MJPEG);
  if (mjpeg.ok() && (!yuyv.ok() || *mjpeg == 0 || *mjpeg > *yuyv)) return absl::OkStatus();
  // The faster one of two slow ones; the age of its pictures is watched anyway.
  if (yuyv.ok()) return TryFormat(V4L2_PIX_FMT_YUYV).status();
  return absl::InvalidArgumentError(absl::StrCat(
      "camera '", options_.name, "' (", options_.device, ") gives neither YUYV (",
      yuyv.status().message(), ") nor MJPEG (", mjpeg.status().message(), ") of ", options_.width,
      " x ", options_.height, "; `robot_client cameras` lists what it gives: choose NODE@WxH"));
}

absl::StatusOr<double> V4l2Source::TryFormat(uint32_t pixel_format) {
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = static_cast<uint32_t>(options_.width);
  format.fmt.pix.height = static_cast<uint32_t>(options_.height);
  format.fmt.pix.pixelformat = pixel_format;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  if (system_->Ioctl(fd_, VIDIOC_S_FMT, &format) < 0) return SystemError("VIDIOC_S_FMT");
  const v4l2_pix_format& pix = format.fmt.pix;
  if (pix.pixelformat != pixel_format) return absl::NotFoundError("another format");
  if (pix.width != static_cast<uint32_t>(options_.width) ||
      pix.height != static_cast<uint32_t>(options_.height))
    return absl::NotFoundError(absl::StrCat("only ", pix.width, " x ", pix.height));
  mjpeg_ = pixel_format == V4L2_PIX_FMT_MJPEG;
  stride_ = static_cast<int>(pix.bytesperline);
  if (stride_ == 0) stride_ = 2 * options_.width;
  v4l2_streamparm rate{};
  rate.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  rate.parm.capture.timeperframe = {1000,
                                    static_cast<uint32_t>(std::lround(options_.rate_hz * 1000))};
  // Not every camera can choose.
  if (system_->Ioctl(fd_, VIDIOC_S_PARM, &rate) < 0) return 0.0;
  const v4l2_fract& period = rate.parm.capture.timeperframe;
  return period.numerator == 0 ? 0.0 : static_cast<double>(period.denominator) / period.numerator;
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
  const bool monotonic =
      (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  const int64_t stamp = monotonic ? buffer.timestamp.tv_sec * int64_t{1'000'000'000} +
                                        buffer.timestamp.tv_usec * int64_t{1000}
                                  : now;
  TakeOver({static_cast<const char*>(mappings_[buffer.index].memory), buffer.bytesused},
           (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0, stamp, now);
  if (system_->Ioctl(fd_, VIDIOC_QBUF, &buffer) < 0) return SystemError("VIDIOC_QBUF");
  return absl::OkStatus();
}

absl::StatusOr<Image> V4l2Source::Decode(std::string_view bytes) const {
  if (!mjpeg_) return RgbFromYuyv(bytes, options_.width, options_.height, stride_);
  RS_ASSIGN_OR_RETURN(Image image, RgbFromJpeg(bytes));
  if (image.width != options_.width || image.height != options_.height) {
    return absl::DataLossError(absl::StrCat("a JPEG picture is ", image.width, " x ", image.height,
                                            ", asked for were ", options_.width, " x ",
                                            options_.height));
  }
  return image;
}

void V4l2Source::TakeOver(std::string_view bytes, bool damaged, int64_t stamp_ns, int64_t now_ns) {
  absl::StatusOr<Image> image =
      damaged ? absl::DataLossError("the driver marks pictures as damaged") : Decode(bytes);
  auto frame = std::make_shared<Frame>();
  frame->stamp_ns = stamp_ns;
  absl::Status fault;
  if (!image.ok()) {
    const uint64_t dropped = dropped_.fetch_add(1, std::memory_order_relaxed) + 1;
    fault = absl::DataLossError(
        absl::StrCat("camera '", options_.name, "': ", dropped,
                     " damaged pictures, the last: ", image.status().message(), "; see its cable"));
  } else if (FromTheFuture(stamp_ns, now_ns)) {
    fault = FutureStampError(options_.name, stamp_ns, now_ns);
  }
  absl::MutexLock lock(&mu_);
  status_ = fault;
  if (!fault.ok()) return;
  frame->image = *std::move(image);
  frame->sequence = ++taken_;
  newest_ = std::move(frame);
  stamp_ns_.store(stamp_ns, std::memory_order_release);
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
