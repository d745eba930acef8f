#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

// The system calls of a V4L2 capture; -1 and errno as the originals. Tests put a camera behind it.
class V4l2System {
 public:
  virtual ~V4l2System() = default;
  virtual int Open(const char* path) = 0;  // read-write, non-blocking, close-on-exec
  virtual int Close(int fd) = 0;
  virtual int Ioctl(int fd, unsigned long request, void* argument) = 0;
  virtual void* Map(int fd, size_t length, off_t offset) = 0;  // MAP_FAILED on failure
  virtual int Unmap(void* memory, size_t length) = 0;
  virtual int Poll(int fd, int timeout_ms) = 0;  // 1 readable, 0 timeout, -1 error or hang-up
};
std::unique_ptr<V4l2System> MakeV4l2System();

// How a camera sends its pictures. kAny: YUYV where that comes at the rate that is asked for, else
// Motion-JPEG, which most cameras need above 640 x 480.
enum class V4l2Format { kAny, kYuyv, kMjpeg };

struct V4l2SourceOptions {
  std::string name;
  std::string device;  // "/dev/v4l/by-id/...": /dev/videoN changes with the order of plugging in
  int width = 640, height = 480;  // [px], asked for; the driver must grant exactly them
  double rate_hz = 30;            // asked for
  V4l2Format format = V4l2Format::kAny;
  int buffers = 4;
};

// A camera behind Video4Linux2: YUYV or Motion-JPEG, memory-mapped buffers, a thread that takes
// every picture and keeps the newest. After an error (unplugged, driver reset) it opens the device
// again every second; meanwhile status() says why nothing comes.
//
// A picture that is damaged (marked by the driver, short, a JPEG that does not decode) is passed
// over and counted. Stamps are the driver's where it stamps with CLOCK_MONOTONIC, else the time of
// taking.
class V4l2Source : public FrameSource {
 public:
  V4l2Source(V4l2SourceOptions options, std::unique_ptr<V4l2System> system, Clock* clock);
  ~V4l2Source() override;

  const std::string& name() const override { return options_.name; }
  absl::Status Start() override;  // opens the device once, so that a wrong one is refused at once
  std::shared_ptr<const Frame> Latest() override ABSL_LOCKS_EXCLUDED(mu_);
  int64_t newest_stamp_ns() const override { return stamp_ns_.load(std::memory_order_acquire); }
  absl::Status status() const override ABSL_LOCKS_EXCLUDED(mu_);
  uint64_t dropped() const override { return dropped_.load(std::memory_order_relaxed); }

 private:
  struct Mapping {
    void* memory = nullptr;
    size_t length = 0;
  };

  absl::Status Open();
  absl::Status SetFormat();
  // The rate that is granted [Hz], 0 where the camera does not say; an error where it does not give
  // this format in this size.
  absl::StatusOr<double> TryFormat(uint32_t pixel_format);
  absl::StatusOr<Image> Decode(std::string_view bytes) const;
  void TakeOver(std::string_view bytes, bool damaged, int64_t stamp_ns, int64_t now_ns)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status MapBuffers();
  void Close();
  absl::Status TakePicture();  // waits up to 200 ms; OK without a picture on timeout
  void Run();
  absl::Status SystemError(const std::string& what) const;

  const V4l2SourceOptions options_;
  const std::unique_ptr<V4l2System> system_;
  Clock* const clock_;
  std::thread thread_;
  std::atomic<bool> stop_{false};
  std::atomic<int64_t> stamp_ns_{0};
  std::atomic<uint64_t> dropped_{0};

  // The thread's, before it starts Start's.
  int fd_ = -1;
  int stride_ = 0;
  bool mjpeg_ = false;
  bool streaming_ = false;
  std::vector<Mapping> mappings_;
  uint64_t taken_ = 0;

  mutable absl::Mutex mu_;
  std::shared_ptr<const Frame> newest_ ABSL_GUARDED_BY(mu_);
  absl::Status status_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
