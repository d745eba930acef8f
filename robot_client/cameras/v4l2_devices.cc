#include "robot_client/cameras/v4l2_devices.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// A driver that never ends its lists must not hold the program.
constexpr uint32_t kMostFormats = 64, kMostSizes = 128, kMostRates = 32;

// A text of a driver, which need not end with a zero.
template <size_t N>
std::string Text(const uint8_t (&bytes)[N]) {
  const auto* text = reinterpret_cast<const char*>(bytes);
  return std::string(text, strnlen(text, N));
}

std::string CodeOf(uint32_t format) {
  std::string code;
  for (int i = 0; i < 4; ++i) code.push_back(static_cast<char>((format >> (8 * i)) & 0x7f));
  absl::StripTrailingAsciiWhitespace(&code);
  return code;
}

double Rate(const v4l2_fract& period) {
  return period.numerator == 0 ? 0 : static_cast<double>(period.denominator) / period.numerator;
}

std::vector<double> RatesOf(V4l2System& system, int fd, uint32_t format, int width, int height) {
  std::vector<double> rates;
  for (uint32_t i = 0; i < kMostRates; ++i) {
    v4l2_frmivalenum interval{};
    interval.index = i;
    interval.pixel_format = format;
    interval.width = static_cast<uint32_t>(width);
    interval.height = static_cast<uint32_t>(height);
    if (system.Ioctl(fd, VIDIOC_ENUM_FRAMEINTERVALS, &interval) < 0) break;
    if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
      rates = {Rate(interval.stepwise.min), Rate(interval.stepwise.max)};
      break;
    }
    rates.push_back(Rate(interval.discrete));
  }
  std::sort(rates.rbegin(), rates.rend());
  return rates;
}

std::vector<V4l2Size> SizesOf(V4l2System& system, int fd, uint32_t format) {
  std::vector<V4l2Size> sizes;
  for (uint32_t i = 0; i < kMostSizes; ++i) {
    v4l2_frmsizeenum found{};
    found.index = i;
    found.pixel_format = format;
    if (system.Ioctl(fd, VIDIOC_ENUM_FRAMESIZES, &found) < 0) break;
    V4l2Size size;
    const bool discrete = found.type == V4L2_FRMSIZE_TYPE_DISCRETE;
    size.width = static_cast<int>(discrete ? found.discrete.width : found.stepwise.min_width);
    size.height = static_cast<int>(discrete ? found.discrete.height : found.stepwise.min_height);
    size.most_width = discrete ? size.width : static_cast<int>(found.stepwise.max_width);
    size.most_height = discrete ? size.height : static_cast<int>(found.stepwise.max_height);
    size.rates_hz = RatesOf(system, fd, format, size.width, size.height);
    sizes.push_back(std::move(size));
    if (!discrete) break;
  }
  return sizes;
}

// What the pictures show, by their formats: a RealSense gives depth as Z16, its infrared pair as
// grey or UYVY, and only its colour as YUYV; all nodes bear the same name.
V4l2Device::Kind KindOf(const std::vector<V4l2PixelFormat>& formats) {
  const auto has = [&](std::initializer_list<const char*> codes) {
    return std::any_of(formats.begin(), formats.end(), [&](const V4l2PixelFormat& format) {
      return std::find(codes.begin(), codes.end(), format.code) != codes.end();
    });
  };
  if (formats.empty()) return V4l2Device::Kind::kNoPictures;
  if (has({"Z16"})) return V4l2Device::Kind::kDepth;
  if (has({"YUYV", "MJPG"})) return V4l2Device::Kind::kColour;
  if (has({"GREY", "Y8I", "Y12I", "Y16"})) return V4l2Device::Kind::kInfrared;
  return V4l2Device::Kind::kOther;
}

void Ask(V4l2System& system, V4l2Device& device) {
  const auto fail = [&](const char* what) {
    const int error = errno;
    device.status = absl::UnavailableError(absl::StrCat(
        device.node, ": ", what, ": ", std::strerror(error),
        error == EACCES ? "; add the user to group video: sudo usermod -aG video $USER" : ""));
  };
  const int fd = system.Open(device.node.c_str());
  if (fd < 0) return fail("open");
  v4l2_capability capability{};
  if (system.Ioctl(fd, VIDIOC_QUERYCAP, &capability) < 0) {
    fail("no V4L2 device");
    system.Close(fd);
    return;
  }
  device.name = Text(capability.card);
  device.driver = Text(capability.driver);
  device.bus = Text(capability.bus_info);
  const uint32_t can = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) ? capability.device_caps
                                                                        : capability.capabilities;
  for (uint32_t i = 0; (can & V4L2_CAP_VIDEO_CAPTURE) && i < kMostFormats; ++i) {
    v4l2_fmtdesc format{};
    format.index = i;
    format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (system.Ioctl(fd, VIDIOC_ENUM_FMT, &format) < 0) break;
    device.formats.push_back({CodeOf(format.pixelformat), Text(format.description),
                              SizesOf(system, fd, format.pixelformat)});
  }
  device.kind = KindOf(device.formats);
  system.Close(fd);
}

std::string KindName(const V4l2Device& device) {
  switch (device.kind) {
    case V4l2Device::Kind::kColour:
      return "colour: usable";
    case V4l2Device::Kind::kInfrared:
      return "infrared: not usable as a colour camera";
    case V4l2Device::Kind::kDepth:
      return "depth: not usable as a colour camera";
    case V4l2Device::Kind::kOther:
      return "no YUYV or MJPEG: not usable";
    case V4l2Device::Kind::kNoPictures:
      return "no pictures (metadata)";
  }
  return "";
}

std::string SizeText(const V4l2Size& size) {
  std::string text = absl::StrCat(size.width, "x", size.height);
  if (size.most_width != size.width || size.most_height != size.height)
    absl::StrAppend(&text, "..", size.most_width, "x", size.most_height);
  if (size.rates_hz.empty()) return text;
  const auto format = [](std::string* out, double rate) { absl::StrAppendFormat(out, "%g", rate); };
  return absl::StrCat(text, " (", absl::StrJoin(size.rates_hz, ", ", format), " Hz)");
}

}  // namespace

std::vector<V4l2Device> ListV4l2Devices(V4l2System& system, const std::string& dev) {
  std::map<int, V4l2Device> devices;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(dev, error)) {
    const std::string name = entry.path().filename().string();
    absl::string_view number = name;
    int index = 0;
    if (!absl::ConsumePrefix(&number, "video") || !absl::SimpleAtoi(number, &index)) continue;
    devices[index].node = entry.path().string();
  }
  for (const auto& link : fs::directory_iterator(dev + "/v4l/by-id", error)) {
    const fs::path target = fs::weakly_canonical(link.path(), error);
    for (auto& [index, device] : devices) {
      if (fs::weakly_canonical(device.node, error) == target)
        device.by_id.push_back(link.path().string());
    }
  }
  std::vector<V4l2Device> listed;
  for (auto& [index, device] : devices) {
    std::sort(device.by_id.begin(), device.by_id.end());
    Ask(system, device);
    listed.push_back(std::move(device));
  }
  return listed;
}

std::string DescribeV4l2Devices(const std::vector<V4l2Device>& devices) {
  std::string text;
  for (const V4l2Device& device : devices) {
    if (!device.status.ok()) {
      absl::StrAppend(&text, device.status.message(), "\n");
      continue;
    }
    absl::StrAppend(&text, device.node, "  ", device.name, "  [", KindName(device), "]\n  bus ",
                    device.bus, ", driver ", device.driver, "\n");
    for (const std::string& link : device.by_id)
      absl::StrAppend(&text, device.usable() ? "  --camera NAME=v4l2:" : "  ", link, "\n");
    if (device.by_id.empty() && device.usable()) {
      absl::StrAppend(&text, "  --camera NAME=v4l2:", device.node,
                      "   (no name in /dev/v4l/by-id: the number changes with the order of "
                      "plugging in)\n");
    }
    for (const V4l2PixelFormat& format : device.formats) {
      absl::StrAppend(&text, "  ", format.code, " (", format.description, ")\n");
      for (const V4l2Size& size : format.sizes)
        absl::StrAppend(&text, "    ", SizeText(size), "\n");
    }
  }
  return text;
}

}  // namespace robostress
