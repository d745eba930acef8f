#include "common/image_resize.h"

#include <gmock/gmock.h>

#include "absl/strings/str_split.h"
#include "common/random.h"
#include "common/safetensors.h"
#include "tests/oracle_file.h"

namespace robostress {
namespace {

Image Noise(int width, int height) {
  Image image{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  RandomStream random(StreamKey("resize").With(width).With(height));
  for (uint8_t& value : image.data) value = static_cast<uint8_t>(random.UniformInt(256));
  return image;
}

TEST(ImageResize, HalvingAveragesWithTheTrianglesWeights) {
  // Output 1 of 4 -> 2 pixels: centre 3, support 2, weights 1 3 3 1 over the pixels within,
  // normalised.
  Image image{4, 1, {}};
  for (int v : {0, 80, 160, 240}) image.data.insert(image.data.end(), 3, static_cast<uint8_t>(v));
  const Image half = ResizeBilinear(image, 2, 1);
  EXPECT_EQ(half.data[0], (3 * 0 + 3 * 80 + 1 * 160 + 3) / 7);    // 57.1
  EXPECT_EQ(half.data[3], (1 * 80 + 3 * 160 + 3 * 240 + 3) / 7);  // 182.9
}

TEST(ImageResize, KeepsFlatImagesAndEqualSizes) {
  const Image flat{31, 20, std::vector<uint8_t>(3 * 31 * 20, 77)};
  const Image resized = ResizeBilinear(flat, 56, 11);
  EXPECT_THAT(resized.data, ::testing::Each(77));
  const Image noise = Noise(20, 20);
  EXPECT_EQ(ResizeWithPad(noise, 20, 20).data, noise.data);
}

// Against Pillow 9.4.0 as openpi's resize_with_pad calls it.
TEST(ImageResize, EqualsPillowBitForBit) {
  const std::string path = OracleFile("preprocess.io.safetensors");
  if (path.empty()) GTEST_SKIP() << kNoOracle;
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  int compared = 0;
  for (const auto& [name, tensor] : file->tensors()) {
    const std::vector<std::string> parts = absl::StrSplit(name, '.');
    if (parts[0] != "expected/pil") continue;
    SCOPED_TRACE(name);
    const absl::StatusOr<TensorView> input = file->Get("inputs/" + parts[1]);
    ASSERT_TRUE(input.ok()) << input.status();
    const Image image{static_cast<int>(input->shape[1]),
                      static_cast<int>(input->shape[0]),
                      {input->bytes.begin(), input->bytes.end()}};
    const Image resized =
        ResizeWithPad(image, static_cast<int>(tensor.shape[1]), static_cast<int>(tensor.shape[0]));
    EXPECT_EQ(resized.data, std::vector<uint8_t>(tensor.bytes.begin(), tensor.bytes.end()));
    ++compared;
  }
  EXPECT_EQ(compared, 7);
}

}  // namespace
}  // namespace robostress
