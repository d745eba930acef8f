#include "sim_worker/libero/preprocess.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "common/image.h"
#include "common/random.h"
#include "sim_worker/robosuite_rotation.h"

namespace robostress::libero {
namespace {

Image Noise(int width, int height) {
  Image image{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  RandomStream random(StreamKey("preprocess").With(width).With(height));
  for (uint8_t& value : image.data) value = static_cast<uint8_t>(random.UniformInt(256));
  return image;
}

TEST(PreprocessTest, MirrorsLeftAndRightAsARotatedBottomUpImage) {
  const Image upright = Noise(5, 3);
  // The originals: bottom-up pixels, then [::-1, ::-1].
  Image expected = upright;
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 5; ++x) {
      for (int c = 0; c < 3; ++c) {
        const int raw_y = 3 - 1 - y,
                  raw_x = 5 - 1 - x;          // position in the rotated view of the raw image
        const int upright_y = 3 - 1 - raw_y;  // raw rows run bottom-up
        expected.data[3 * (y * 5 + x) + c] = upright.data[3 * (upright_y * 5 + raw_x) + c];
      }
    }
  }
  EXPECT_EQ(MirrorColumns(upright).data, expected.data);
}

// The originals set none of this.
TEST(PreprocessTest, DrawsAsMujocoDoesWhenNobodyChooses) {
  const SharedModel model = CompileModel("empty", "<mujoco/>").value();
  mjvScene scene;
  mjv_defaultScene(&scene);
  mjv_makeScene(model.get(), &scene, 1);
  const RenderOptions options = RenderAsLibero(256, 128);
  EXPECT_EQ(options.shadows, scene.flags[mjRND_SHADOW] != 0);
  EXPECT_EQ(options.reflections, scene.flags[mjRND_REFLECTION] != 0);
  EXPECT_EQ(options.samples, model->vis.quality.offsamples);
  EXPECT_EQ(options.shadow_size, model->vis.quality.shadowsize);
  EXPECT_EQ(options.supersample, 1);
  EXPECT_EQ(options.width, 256);
  EXPECT_EQ(options.height, 128);
  mjv_freeScene(&scene);
}

TEST(PreprocessTest, TurnsAsRobosuiteDoesTheLongWayRound) {
  const auto turn = [](double w, double x, double y, double z) {
    const double wxyz[] = {w, x, y, z};
    return AxisAngleAsRobosuite(wxyz);
  };
  const double pi = std::numbers::pi;
  EXPECT_NEAR((turn(std::cos(0.1), std::sin(0.1), 0, 0) - Eigen::Vector3d(0.2, 0, 0)).norm(), 0,
              1e-12);
  // The same rotation by the other quaternion: 2 pi less a bit, about the other axis.
  EXPECT_NEAR(
      (turn(-std::cos(0.1), -std::sin(0.1), 0, 0) - Eigen::Vector3d(0.2 - 2 * pi, 0, 0)).norm(), 0,
      1e-12);
  EXPECT_NEAR((turn(0, 0, 1, 0) - Eigen::Vector3d(0, pi, 0)).norm(), 0, 1e-12);
  EXPECT_EQ(turn(1, 0, 0, 0), Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(turn(-1, 0, 0, 0), Eigen::Vector3d(0, 0, 0)) << "not 2 pi";
  EXPECT_EQ(turn(1 + 1e-12, 0, 0, 0), Eigen::Vector3d(0, 0, 0)) << "a quaternion is seldom exact";
}

}  // namespace
}  // namespace robostress::libero
