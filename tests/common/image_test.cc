#include "common/image.h"

#include "gtest/gtest.h"

namespace robostress {
namespace {

Image Gradient(int width, int height) {
  Image image{width, height, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (const int c : {x, y, x + y}) image.data.push_back(static_cast<uint8_t>(c));
    }
  }
  return image;
}

TEST(Image, IntegerShrinkIsTheBoxAverage) {
  const Image image{4, 2, {0,  0,  0,  10, 10, 10, 100, 0, 0, 200, 0, 0,  //
                           20, 20, 20, 30, 30, 30, 100, 0, 0, 200, 0, 0}};
  const Image small = ResizeArea(image, 2, 1);
  EXPECT_EQ(small.data, (std::vector<uint8_t>{15, 15, 15, 150, 0, 0}));
}

TEST(Image, FractionalShrinkKeepsTheMean) {
  const Image small = ResizeArea(Gradient(91, 91), 64, 64);
  double before = 0, after = 0;
  for (const uint8_t v : Gradient(91, 91).data) before += v;
  for (const uint8_t v : small.data) after += v;
  EXPECT_NEAR(before / (91 * 91 * 3), after / (64 * 64 * 3), 0.5);
}

TEST(Image, PngStartsWithItsSignature) {
  const auto png = EncodePng(Gradient(8, 6));
  ASSERT_TRUE(png.ok());
  EXPECT_EQ(png->substr(0, 4), "\x89PNG");
  EXPECT_FALSE(EncodePng(Image{2, 2, {1, 2, 3}}).ok());
  const auto back = DecodePng(*png);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->width, 8);
  EXPECT_EQ(back->height, 6);
  EXPECT_EQ(back->data, Gradient(8, 6).data);
  for (size_t size = 0; size + 12 < png->size(); ++size)
    EXPECT_FALSE(DecodePng(png->substr(0, size)).ok()) << size;
}

TEST(Image, AnimatedWebpHoldsItsFramesAndRefusesMixedSizes) {
  const auto webp = EncodeAnimatedWebp({Gradient(16, 16), Gradient(16, 16)}, 0.1, 50);
  ASSERT_TRUE(webp.ok()) << webp.status();
  EXPECT_EQ(webp->substr(0, 4), "RIFF");
  EXPECT_EQ(webp->substr(8, 4), "WEBP");
  EXPECT_FALSE(EncodeAnimatedWebp({Gradient(16, 16), Gradient(8, 8)}, 0.1, 50).ok());
  EXPECT_FALSE(EncodeAnimatedWebp({}, 0.1, 50).ok());
}

TEST(Image, HStackPutsImagesSideBySide) {
  const Image stacked = HStack({Gradient(4, 3), Gradient(2, 2)}, 1);
  EXPECT_EQ(stacked.width, 7);
  EXPECT_EQ(stacked.height, 3);
}

}  // namespace
}  // namespace robostress
