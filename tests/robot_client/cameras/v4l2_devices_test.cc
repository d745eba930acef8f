#include "robot_client/cameras/v4l2_devices.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace fs = std::filesystem;

struct Node {
  std::string card;
  uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  std::vector<uint32_t> formats;
  int open_error = 0;
  bool endless = false;  // a driver whose lists never end
};

// Nodes by their number; each format in 640x480 at 30 and 15 Hz and 1280x720 at 10 Hz.
class FakeNodes : public V4l2System {
 public:
  explicit FakeNodes(std::map<int, Node> nodes) : nodes_(std::move(nodes)) {}
  int Open(const char* path) override {
    const std::string text = path;
    const int number = std::stoi(text.substr(text.rfind("video") + 5));
    if (nodes_[number].open_error != 0) return Fail(nodes_[number].open_error);
    ++open_;
    return number;
  }
  int Close(int) override { return --open_, 0; }
  void* Map(int, size_t, off_t) override { return nullptr; }
  int Unmap(void*, size_t) override { return 0; }
  int Poll(int, int) override { return 0; }
  int Ioctl(int fd, unsigned long request, void* argument) override {
    const Node& node = nodes_[fd];
    switch (request) {
      case VIDIOC_QUERYCAP: {
        auto* capability = static_cast<v4l2_capability*>(argument);
        // All 32 bytes, without a zero at the end, as the longest name is given.
        std::memset(capability->card, 'x', sizeof(capability->card));
        std::memcpy(capability->card, node.card.c_str(),
                    std::min(node.card.size() + 1, sizeof(capability->card)));
        std::snprintf(reinterpret_cast<char*>(capability->driver), sizeof capability->driver,
                      "uvcvideo");
        std::snprintf(reinterpret_cast<char*>(capability->bus_info), sizeof capability->bus_info,
                      "usb-0000:00:14.0-1");
        capability->capabilities = V4L2_CAP_DEVICE_CAPS;
        capability->device_caps = node.capabilities;
        return 0;
      }
      case VIDIOC_ENUM_FMT: {
        auto* format = static_cast<v4l2_fmtdesc*>(argument);
        if (!node.endless && format->index >= node.formats.size()) return Fail(EINVAL);
        format->pixelformat = node.formats[format->index % node.formats.size()];
        std::snprintf(reinterpret_cast<char*>(format->description), sizeof format->description,
                      "a format");
        return 0;
      }
      case VIDIOC_ENUM_FRAMESIZES: {
        auto* size = static_cast<v4l2_frmsizeenum*>(argument);
        if (!node.endless && size->index >= 2) return Fail(EINVAL);
        size->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        size->discrete = {size->index == 0 ? 640u : 1280u, size->index == 0 ? 480u : 720u};
        return 0;
      }
      case VIDIOC_ENUM_FRAMEINTERVALS: {
        auto* interval = static_cast<v4l2_frmivalenum*>(argument);
        if (!node.endless && interval->index >= (interval->width == 640 ? 2u : 1u))
          return Fail(EINVAL);
        interval->type = V4L2_FRMIVAL_TYPE_DISCRETE;
        interval->discrete = {1, interval->width == 640 ? (interval->index == 0 ? 15u : 30u) : 10u};
        return 0;
      }
      default:
        return Fail(ENOTTY);
    }
  }
  int open() const { return open_; }

 private:
  static int Fail(int error) {
    errno = error;
    return -1;
  }
  std::map<int, Node> nodes_;
  int open_ = 0;
};

std::string DevWith(const std::string& name, const std::vector<int>& numbers,
                    const std::map<std::string, int>& links) {
  const std::string dev = fs::weakly_canonical(::testing::TempDir()).string() + "/dev_" + name;
  fs::remove_all(dev);
  fs::create_directories(dev + "/v4l/by-id");
  for (const int number : numbers)
    const std::ofstream device(dev + "/video" + std::to_string(number));
  const std::ofstream other(dev + "/videos");
  for (const auto& [link, number] : links)
    fs::create_symlink("../../video" + std::to_string(number), dev + "/v4l/by-id/" + link);
  return dev;
}

// As Linux shows a D435: three nodes with pictures and their metadata, all of one name.
TEST(V4l2DevicesTest, SaysWhichNodeOfARealSenseIsTheColourOne) {
  const std::string name = "Intel(R) RealSense(TM) Depth Camera 435";
  const Node metadata{name, V4L2_CAP_META_CAPTURE};
  FakeNodes system({{0, {name, V4L2_CAP_VIDEO_CAPTURE, {V4L2_PIX_FMT_Z16}}},
                    {1, metadata},
                    {2, {name, V4L2_CAP_VIDEO_CAPTURE, {V4L2_PIX_FMT_GREY, V4L2_PIX_FMT_UYVY}}},
                    {10, {name, V4L2_CAP_VIDEO_CAPTURE, {V4L2_PIX_FMT_YUYV}}}});
  const std::string dev = DevWith("realsense", {10, 0, 1, 2},
                                  {{"usb-Intel-video-index0", 0}, {"usb-Intel-video-index4", 10}});
  const std::vector<V4l2Device> devices = ListV4l2Devices(system, dev);
  ASSERT_EQ(devices.size(), 4u);
  EXPECT_EQ(devices[0].kind, V4l2Device::Kind::kDepth);
  EXPECT_EQ(devices[1].kind, V4l2Device::Kind::kNoPictures);
  EXPECT_EQ(devices[2].kind, V4l2Device::Kind::kInfrared);
  EXPECT_TRUE(devices[3].usable()) << "number 10 comes after 2";
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(devices[i].usable()) << i;
  EXPECT_EQ(devices[3].name, name.substr(0, 32)) << "the driver's text has no zero at its end";
  const std::string text = DescribeV4l2Devices(devices);
  EXPECT_THAT(text,
              AllOf(HasSubstr(dev + "/video10  Intel(R) RealSense(TM)"),
                    HasSubstr("--camera NAME=v4l2:" + dev + "/v4l/by-id/usb-Intel-video-index4\n"),
                    HasSubstr("usb-0000:00:14.0-1"), HasSubstr("Z16 (a format)"),
                    HasSubstr("640x480 (30, 15 Hz)\n    1280x720 (10 Hz)")));
  EXPECT_THAT(text, Not(HasSubstr("NAME=v4l2:" + dev + "/v4l/by-id/usb-Intel-video-index0")));
  EXPECT_EQ(system.open(), 0);
}

TEST(V4l2DevicesTest, GoesOnAfterANodeThatCannotBeOpenedAndEndsEndlessLists) {
  FakeNodes system({{0, {"locked", 0, {}, EACCES}},
                    {1, {"endless", V4L2_CAP_VIDEO_CAPTURE, {V4L2_PIX_FMT_MJPEG}, 0, true}}});
  const std::vector<V4l2Device> devices = ListV4l2Devices(system, DevWith("locked", {0, 1}, {}));
  ASSERT_EQ(devices.size(), 2u);
  const std::string text = DescribeV4l2Devices(devices);
  EXPECT_THAT(text, AllOf(HasSubstr("group video"), HasSubstr("changes with the order")));
  EXPECT_LT(devices[1].formats.size(), 1000u);
  EXPECT_TRUE(devices[1].usable());
  EXPECT_TRUE(ListV4l2Devices(system, "/nowhere").empty());
}

}  // namespace
}  // namespace robostress
