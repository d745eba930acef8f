#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "robot_client/cameras/v4l2_source.h"

namespace robostress {

struct V4l2Size {
  int width = 0, height = 0;            // [px]
  int most_width = 0, most_height = 0;  // larger where the camera gives a range
  std::vector<double> rates_hz;         // highest first; empty where it does not say
};

struct V4l2PixelFormat {
  std::string code;  // "YUYV"
  std::string description;
  std::vector<V4l2Size> sizes;
};

// A node of a camera. One camera has several: a RealSense one each for depth, infrared and colour,
// and most webcams one for the metadata of their pictures.
struct V4l2Device {
  enum class Kind { kColour, kInfrared, kDepth, kOther, kNoPictures };
  std::string node;                // "/dev/video4"
  std::vector<std::string> by_id;  // "/dev/v4l/by-id/...", which stay when cameras are replugged
  std::string name, driver, bus;   // as the driver says
  Kind kind = Kind::kNoPictures;
  std::vector<V4l2PixelFormat> formats;
  absl::Status status;                                   // why nothing more is known of it
  bool usable() const { return kind == Kind::kColour; }  // gives YUYV or MJPEG
};

// The nodes of /dev in the order of their numbers; `dev` is another folder in a test.
std::vector<V4l2Device> ListV4l2Devices(V4l2System& system, const std::string& dev = "/dev");

// A table for people.
std::string DescribeV4l2Devices(const std::vector<V4l2Device>& devices);

}  // namespace robostress
