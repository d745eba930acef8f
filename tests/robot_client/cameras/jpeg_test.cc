#include "robot_client/cameras/jpeg.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

namespace robostress {
namespace {

using ::testing::HasSubstr;

Image Gradient(int width, int height) {
  Image image{width, height, {}};
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      image.data.push_back(static_cast<uint8_t>(4 * col));
      image.data.push_back(static_cast<uint8_t>(4 * row));
      image.data.push_back(128);
    }
  }
  return image;
}

TEST(JpegTest, APictureComesBackAsItWas) {
  const Image image = Gradient(64, 48);
  const auto bytes = JpegFromRgb(image, 95);
  ASSERT_TRUE(bytes.ok()) << bytes.status();
  const auto back = RgbFromJpeg(*bytes);
  ASSERT_TRUE(back.ok()) << back.status();
  ASSERT_EQ(back->data.size(), image.data.size());
  EXPECT_EQ(back->width, 64);
  double error = 0;
  for (size_t i = 0; i < image.data.size(); ++i) error += std::abs(back->data[i] - image.data[i]);
  EXPECT_LT(error / static_cast<double>(image.data.size()), 3) << "lossy, but red is first";
}

// A cable that loses bytes cuts pictures anywhere.
TEST(JpegTest, EveryCutPictureIsRefusedAndNoDamageCrashes) {
  const std::string bytes = *JpegFromRgb(Gradient(64, 48));
  for (size_t cut = 0; cut + 3 < bytes.size(); ++cut) {
    EXPECT_EQ(RgbFromJpeg(bytes.substr(0, cut)).status().code(), absl::StatusCode::kDataLoss)
        << cut << " of " << bytes.size();
  }
  for (size_t at = 0; at < bytes.size(); ++at) {
    std::string damaged = bytes;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x55);
    RgbFromJpeg(damaged).IgnoreError();
  }
}

TEST(JpegTest, APictureThatClaimsToBeHugeIsRefusedBeforeItTakesMemory) {
  std::string bytes = *JpegFromRgb(Gradient(64, 48));
  const size_t frame = bytes.find("\xff\xc0");
  ASSERT_NE(frame, std::string::npos);
  bytes[frame + 5] = bytes[frame + 7] = static_cast<char>(0xff);  // height and width
  EXPECT_THAT(std::string(RgbFromJpeg(bytes).status().message()), HasSubstr("4096"));
}

// What many webcams send: bytes between the picture and its end.
TEST(JpegTest, StrayBytesBeforeTheEndAreNoDamage) {
  std::string bytes = *JpegFromRgb(Gradient(64, 48));
  bytes.insert(bytes.size() - 2, "\x12\x34\x56");
  EXPECT_TRUE(RgbFromJpeg(bytes).ok()) << RgbFromJpeg(bytes).status();
}

}  // namespace
}  // namespace robostress
