#include "robot_client/cameras/v4l2_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <sys/mman.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <deque>
#include <mutex>
#include <thread>

#include "robot_client/cameras/jpeg.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr uint32_t kBufferBytes = 4096;

// A camera behind the system calls: 4 x 2 YUYV or MJPEG, a picture every 2 ms of real time.
struct Driver {
  std::mutex mutex;
  bool plugged = true, other_format = false, busy = false;
  bool yuyv = true, mjpeg = true;  // what it gives ...
  uint32_t yuyv_hz = 30;           // ... and how fast; MJPEG at what is asked for
  uint32_t format = 0;
  int corrupt_every = 0;  // n > 0: every n-th JPEG is cut off
  int opens = 0, closes = 0, maps = 0, unmaps = 0, streaming = 0;
  int ahead_s = 0;        // of the stamps: seconds that they are set to, where above 0
  int damaged_every = 0;  // n > 0: every n-th picture is marked as damaged
  int pictures = 0;
  std::vector<std::vector<uint8_t>> buffers{4, std::vector<uint8_t>(kBufferBytes)};
  std::deque<uint32_t> queued;
};

class FakeV4l2 : public V4l2System {
 public:
  explicit FakeV4l2(Driver* driver) : d_(driver) {}
  int Open(const char*) override {
    const std::lock_guard lock(d_->mutex);
    if (!d_->plugged) return Fail(ENOENT);
    if (d_->busy) return Fail(EBUSY);
    d_->queued.clear();
    ++d_->opens;
    return 7;
  }
  int Close(int) override {
    const std::lock_guard lock(d_->mutex);
    ++d_->closes;
    return 0;
  }
  void* Map(int, size_t, off_t offset) override {
    const std::lock_guard lock(d_->mutex);
    ++d_->maps;
    return d_->buffers[static_cast<size_t>(offset) / kBufferBytes].data();
  }
  int Unmap(void*, size_t) override {
    const std::lock_guard lock(d_->mutex);
    ++d_->unmaps;
    return 0;
  }
  int Poll(int, int) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    const std::lock_guard lock(d_->mutex);
    if (!d_->plugged) return Fail(ENODEV);
    return d_->queued.empty() ? 0 : 1;
  }
  int Ioctl(int, unsigned long request, void* argument) override {
    const std::lock_guard lock(d_->mutex);
    if (!d_->plugged) return Fail(ENODEV);
    auto* buffer = static_cast<v4l2_buffer*>(argument);
    switch (request) {
      case VIDIOC_QUERYCAP:
        static_cast<v4l2_capability*>(argument)->capabilities =
            V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        return 0;
      case VIDIOC_S_FMT: {
        auto& pix = static_cast<v4l2_format*>(argument)->fmt.pix;
        if (d_->other_format || (pix.pixelformat == V4L2_PIX_FMT_YUYV && !d_->yuyv) ||
            (pix.pixelformat == V4L2_PIX_FMT_MJPEG && !d_->mjpeg))
          pix.pixelformat = V4L2_PIX_FMT_H264;
        d_->format = pix.pixelformat;
        pix.bytesperline = 8;
        return 0;
      }
      case VIDIOC_S_PARM:
        if (d_->format == V4L2_PIX_FMT_YUYV)
          static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe = {1, d_->yuyv_hz};
        return 0;
      case VIDIOC_REQBUFS:
        static_cast<v4l2_requestbuffers*>(argument)->count = 4;
        return 0;
      case VIDIOC_QUERYBUF:
        buffer->length = kBufferBytes;
        buffer->m.offset = buffer->index * kBufferBytes;
        return 0;
      case VIDIOC_QBUF:
        d_->queued.push_back(buffer->index);
        return 0;
      case VIDIOC_DQBUF: {
        if (d_->queued.empty()) return Fail(EAGAIN);
        ++d_->pictures;
        buffer->index = d_->queued.front();
        d_->queued.pop_front();
        buffer->bytesused = 16;
        buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        if (d_->damaged_every > 0 && d_->pictures % d_->damaged_every == 0)
          buffer->flags |= V4L2_BUF_FLAG_ERROR;
        buffer->timestamp = {d_->ahead_s > 0 ? d_->ahead_s : 3, d_->pictures};
        std::fill(d_->buffers[buffer->index].begin(), d_->buffers[buffer->index].end(), 128);
        if (d_->format == V4L2_PIX_FMT_MJPEG) {
          const std::string jpeg = *JpegFromRgb({4, 2, std::vector<uint8_t>(24, 200)});
          std::memcpy(d_->buffers[buffer->index].data(), jpeg.data(), jpeg.size());
          const bool cut = d_->corrupt_every > 0 && d_->pictures % d_->corrupt_every == 0;
          buffer->bytesused = static_cast<uint32_t>(cut ? jpeg.size() / 2 : jpeg.size());
        }
        return 0;
      }
      case VIDIOC_STREAMON:
        ++d_->streaming;
        return 0;
      case VIDIOC_STREAMOFF:
        --d_->streaming;
        return 0;
      default:
        return 0;
    }
  }

 private:
  static int Fail(int error) {
    errno = error;
    return -1;
  }
  Driver* d_;
};

struct Camera {
  Driver driver;
  MonotonicClock clock;
  std::unique_ptr<V4l2Source> source;
  Camera() {
    V4l2SourceOptions options;
    options.name = "wrist";
    options.device = "/dev/v4l/by-id/fake";
    options.width = 4;
    options.height = 2;
    source = std::make_unique<V4l2Source>(options, std::make_unique<FakeV4l2>(&driver), &clock);
  }
  template <class Condition>
  bool Eventually(Condition condition) {
    const int64_t until = clock.now_ns() + 10'000'000'000;
    while (!condition()) {
      if (clock.now_ns() > until) return false;
      clock.SleepUntil(clock.now_ns() + 1'000'000);
    }
    return true;
  }
};

TEST(V4l2SourceTest, DeliversTheNewestPictureWithTheDriversStamp) {
  Camera camera;
  ASSERT_TRUE(camera.source->Start().ok());
  ASSERT_TRUE(camera.Eventually([&] {
    const auto frame = camera.source->Latest();
    return frame != nullptr && frame->sequence > 10;
  }));
  const auto frame = camera.source->Latest();
  EXPECT_EQ(frame->image.width, 4);
  EXPECT_EQ(frame->image.data.size(), 24u);
  EXPECT_EQ(frame->stamp_ns / 1'000'000'000, 3);
  EXPECT_GE(camera.source->newest_stamp_ns(), frame->stamp_ns);
  camera.source.reset();
  EXPECT_EQ(camera.driver.closes, 1);
  EXPECT_EQ(camera.driver.unmaps, camera.driver.maps);
  EXPECT_EQ(camera.driver.streaming, 0);
}

TEST(V4l2SourceTest, ComesBackAfterItWasUnplugged) {
  Camera camera;
  ASSERT_TRUE(camera.source->Start().ok());
  ASSERT_TRUE(camera.Eventually([&] { return camera.source->Latest() != nullptr; }));
  {
    const std::lock_guard lock(camera.driver.mutex);
    camera.driver.plugged = false;
  }
  ASSERT_TRUE(camera.Eventually([&] { return !camera.source->status().ok(); }));
  EXPECT_THAT(std::string(camera.source->status().message()), HasSubstr("plug it in"));
  const int64_t stamp = camera.source->newest_stamp_ns();
  {
    const std::lock_guard lock(camera.driver.mutex);
    camera.driver.plugged = true;
  }
  ASSERT_TRUE(camera.Eventually([&] { return camera.source->newest_stamp_ns() > stamp; }));
  EXPECT_TRUE(camera.source->status().ok());
  EXPECT_EQ(camera.driver.opens, 2);
}

TEST(V4l2SourceTest, PassesOverStampsFromTheFutureAndSaysSo) {
  Camera camera;
  ASSERT_TRUE(camera.source->Start().ok());
  ASSERT_TRUE(camera.Eventually([&] { return camera.source->Latest() != nullptr; }));
  {
    const std::lock_guard lock(camera.driver.mutex);
    camera.driver.ahead_s = static_cast<int>(camera.clock.now_ns() / 1'000'000'000) + 1000;
  }
  ASSERT_TRUE(camera.Eventually([&] { return !camera.source->status().ok(); }));
  EXPECT_THAT(std::string(camera.source->status().message()), HasSubstr("in the future"));
  EXPECT_EQ(camera.source->newest_stamp_ns() / 1'000'000'000, 3) << "it grows old";
  EXPECT_EQ(camera.source->Latest()->stamp_ns / 1'000'000'000, 3);
  {
    const std::lock_guard lock(camera.driver.mutex);
    camera.driver.ahead_s = 0;
  }
  ASSERT_TRUE(camera.Eventually([&] { return camera.source->status().ok(); }));
}

TEST(V4l2SourceTest, PassesOverDamagedPictures) {
  Camera camera;
  camera.driver.damaged_every = 2;
  ASSERT_TRUE(camera.source->Start().ok());
  ASSERT_TRUE(camera.Eventually([&] {
    const auto frame = camera.source->Latest();
    return frame != nullptr && frame->sequence > 5;
  }));
  EXPECT_EQ(camera.source->Latest()->stamp_ns / 1000 % 2, 1) << "every second one";
}

TEST(V4l2SourceTest, TakesMjpegWhereYuyvIsMissingOrSlow) {
  for (const bool slow : {true, false}) {
    Camera camera;
    camera.driver.yuyv = slow;
    camera.driver.yuyv_hz = 10;
    ASSERT_TRUE(camera.source->Start().ok());
    ASSERT_TRUE(camera.Eventually([&] { return camera.source->Latest() != nullptr; }));
    EXPECT_NEAR(camera.source->Latest()->image.data[0], 200, 3);
    EXPECT_EQ(camera.source->Latest()->image.data.size(), 24u);
  }
  Camera only_yuyv;
  only_yuyv.driver.mjpeg = false;
  only_yuyv.driver.yuyv_hz = 10;
  ASSERT_TRUE(only_yuyv.source->Start().ok()) << "slow is better than none";
  EXPECT_EQ(only_yuyv.driver.format, V4L2_PIX_FMT_YUYV);
  Camera both;
  ASSERT_TRUE(both.source->Start().ok());
  EXPECT_EQ(both.driver.format, V4L2_PIX_FMT_YUYV) << "needs no decoder";
}

TEST(V4l2SourceTest, CountsCorruptJpegsAndGoesOn) {
  Camera camera;
  camera.driver.yuyv = false;
  camera.driver.corrupt_every = 3;
  ASSERT_TRUE(camera.source->Start().ok());
  ASSERT_TRUE(camera.Eventually([&] {
    const auto frame = camera.source->Latest();
    return frame != nullptr && frame->sequence >= 10;
  }));
  EXPECT_GE(camera.source->dropped(), 4u);
  EXPECT_NE(camera.source->Latest()->stamp_ns / 1000 % 3, 0) << "every third one is passed over";
  {
    const std::lock_guard lock(camera.driver.mutex);
    camera.driver.corrupt_every = 1;
  }
  ASSERT_TRUE(camera.Eventually([&] { return !camera.source->status().ok(); }));
  EXPECT_THAT(std::string(camera.source->status().message()), HasSubstr("see its cable"));
}

TEST(V4l2SourceTest, RefusesWhatItCannotReadAndSaysWhatToDo) {
  Camera format;
  format.driver.other_format = true;
  EXPECT_THAT(std::string(format.source->Start().message()), HasSubstr("`robot_client cameras`"));
  Camera busy;
  busy.driver.busy = true;
  EXPECT_THAT(std::string(busy.source->Start().message()), HasSubstr("another program"));
  Camera gone;
  gone.driver.plugged = false;
  EXPECT_THAT(std::string(gone.source->Start().message()), HasSubstr("/dev/v4l/by-id"));
  EXPECT_EQ(format.driver.opens, format.driver.closes);
}

}  // namespace
}  // namespace robostress
