#include "sim_worker/renderer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <numeric>
#include <set>
#include <string>
#include <thread>

#include "common/atomic_file.h"
#include "common/image.h"
#include "sim_worker/unseen_geoms.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

// A red cube in the middle of a camera's view, a green one above it in the picture.
constexpr char kCubes[] = R"(<mujoco>
  <visual><quality offsamples="0"/></visual>
  <worldbody>
    <light pos="0 0 3" directional="true"/>
    <camera name="front" pos="0 -2 0" xyaxes="1 0 0 0 0 1" fovy="45"/>
    <geom name="red" group="1" type="box" size="0.1 0.1 0.1" rgba="1 0 0 1"/>
    <geom name="green" group="1" type="box" size="0.1 0.1 0.1" pos="0.3 0 0.5" rgba="0 1 0 1"/>
    <geom name="hidden" group="0" type="box" size="0.2 0.2 0.2" pos="-0.5 0 0" rgba="0 0 1 1"/>
  </worldbody></mujoco>)";

struct Cubes {
  Cubes() : model(CompileModel("cubes", kCubes).value()), data(mj_makeData(model.get())) {
    mj_forward(model.get(), data);
    renderer = Renderer::Create(model).value();
  }
  ~Cubes() { mj_deleteData(data); }
  SharedModel model;
  mjData* data;
  std::unique_ptr<Renderer> renderer;
};

int Channel(const Image& image, int x, int y, int c) {
  return image.data[3 * (y * image.width + x) + c];
}

TEST(Renderer, PutsTheTopRowFirstAndHidesCollisionGeometry) {
  Cubes cubes;
  const Image image =
      cubes.renderer->Render(*cubes.data, "front", {.width = 120, .height = 80}).value();
  ASSERT_EQ(image.width, 120);
  ASSERT_EQ(image.height, 80);
  const auto red = [&](int x, int y) {
    return Channel(image, x, y, 0) > 2 * Channel(image, x, y, 1) + 20;
  };
  const auto green = [&](int x, int y) {
    return Channel(image, x, y, 1) > 2 * Channel(image, x, y, 0) + 20;
  };
  EXPECT_TRUE(red(60, 40));
  // fovy 45 at 2 m: 80 px are 1.66 m, so 0.5 m up is 24 px and 0.3 m right 14 px.
  EXPECT_TRUE(green(74, 16));
  EXPECT_FALSE(green(74, 64));
  int blue = 0;
  for (int i = 0; i < image.width * image.height; ++i)
    blue += image.data[3 * i + 2] > image.data[3 * i] + 100;
  EXPECT_EQ(blue, 0);
}

TEST(Renderer, RepeatsAnImageExactlyAndContextsDoNotDisturbEachOther) {
  Cubes a, b;
  const RenderOptions options{.width = 64, .height = 64};
  const Image first = a.renderer->Render(*a.data, "front", options).value();
  const Image other = b.renderer->Render(*b.data, "front", options).value();
  EXPECT_EQ(first.data, other.data);
  EXPECT_EQ(a.renderer->Render(*a.data, "front", options).value().data, first.data);
  b.renderer.reset();
  EXPECT_EQ(a.renderer->Render(*a.data, "front", options).value().data, first.data);
}

TEST(Renderer, WorksOnSeveralThreadsAtOnce) {
  Cubes main_thread;
  const RenderOptions options{.width = 64, .height = 64};
  const Image expected = main_thread.renderer->Render(*main_thread.data, "front", options).value();
  std::vector<std::thread> threads;
  std::vector<Image> images(2);
  for (Image& image : images) {
    threads.emplace_back([&image, &options] {
      Cubes own;
      image = own.renderer->Render(*own.data, "front", options).value();
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (const Image& image : images) EXPECT_EQ(image.data, expected.data);
}

TEST(Renderer, SupersamplingAveragesBoxes) {
  Cubes cubes;
  const Image fine =
      cubes.renderer->Render(*cubes.data, "front", {.width = 96, .height = 96}).value();
  const Image averaged =
      cubes.renderer->Render(*cubes.data, "front", {.width = 48, .height = 48, .supersample = 2})
          .value();
  EXPECT_EQ(averaged.data, ResizeArea(fine, 48, 48).data);
}

// A cube over a shining floor, lit from the side.
constexpr char kCubeOnFloor[] = R"(<mujoco>
  <asset><material name="shiny" reflectance="0.5"/></asset>
  <worldbody>
    <light pos="-2 0 2" dir="1 0 -1" directional="true"/>
    <camera name="front" pos="0 -2 0.6" xyaxes="1 0 0 0 0.3 1" fovy="45"/>
    <geom name="floor" group="1" type="plane" size="2 2 0.1" material="shiny"/>
    <geom name="cube" group="1" type="box" size="0.1 0.1 0.1" pos="0 0 0.15" rgba="1 0 0 1"/>
  </worldbody></mujoco>)";

TEST(Renderer, ShadowsReflectionsAndSamplesEachChangeThePicture) {
  const SharedModel model = CompileModel("cube on floor", kCubeOnFloor).value();
  mjData* data = mj_makeData(model.get());
  mj_forward(model.get(), data);
  const auto renderer = Renderer::Create(model).value();
  const auto render = [&](RenderOptions options) {
    options.width = options.height = 96;
    return renderer->Render(*data, "front", options).value();
  };
  const Image plain = render({});
  const auto sum = [](const Image& image) {
    return std::accumulate(image.data.begin(), image.data.end(), int64_t{0});
  };
  EXPECT_LT(sum(render({.shadows = true})), sum(plain)) << "a shadow is darker";
  const Image mirrored = render({.reflections = true});
  int red = 0;  // on the floor, where nothing red is seen without
  for (int y = 0; y < 96; ++y) {
    for (int x = 0; x < 96; ++x)
      red += Channel(mirrored, x, y, 0) > Channel(mirrored, x, y, 1) + 8 &&
             Channel(plain, x, y, 0) == Channel(plain, x, y, 1);
  }
  EXPECT_GT(red, 10) << "the cube below the floor";
  // Along an edge the red of four samples is neither the cube's nor the floor's.
  const auto levels = [](const Image& image) {
    std::set<int> values;
    for (size_t i = 0; i < image.data.size(); i += 3)
      values.insert(image.data[i] - image.data[i + 1]);
    return values.size();
  };
  EXPECT_GT(levels(render({.samples = 4})), levels(plain) + 2);
  EXPECT_EQ(render({}).data, plain.data) << "options leave nothing behind";
  const absl::Status refused = renderer->Render(*data, "front", {.samples = -1}).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(refused.message().find("-1 samples"), std::string::npos);
  EXPECT_EQ(renderer->Render(*data, "front", {.shadow_size = 20000}).status().code(),
            absl::StatusCode::kInvalidArgument);
  mj_deleteData(data);
}

// Balls before the camera, behind it, beside the view, and over it but in the floor's mirror.
TEST(Renderer, LeavesOutWhatNoPixelCanShow) {
  const SharedModel model = CompileModel("balls", R"(<mujoco>
    <asset><material name="shiny" reflectance="0.5"/></asset>
    <worldbody>
      <light name="lamp" pos="0 0 3" directional="true"/>
      <camera name="front" pos="0 -2 0.5" xyaxes="1 0 0 0 0.2 1" fovy="45"/>
      <geom name="seen" type="sphere" group="1" size="0.1" pos="0 0 0.2"/>
      <geom name="behind" type="sphere" group="1" size="0.1" pos="0 -3 0.6"/>
      <geom name="beside" type="sphere" group="1" size="0.1" pos="2 0 0.2"/>
      <geom name="at_the_edge" type="sphere" group="1" size="0.1" pos="0.86 0 0.2"/>
      <geom name="mirrored" type="sphere" group="1" size="0.2" pos="0 1 1.4" rgba="1 0 0 1"/>
      <geom name="floor" type="box" group="1" size="3 3 0.1" pos="0 0 -0.1" material="shiny"/>
    </worldbody></mujoco>)")
                                .value();
  mjData* data = mj_makeData(model.get());
  mj_forward(model.get(), data);
  mjvScene scene;
  mjv_defaultScene(&scene);
  mjv_makeScene(model.get(), &scene, 100);
  mjvCamera camera;
  mjv_defaultCamera(&camera);
  camera.type = mjCAMERA_FIXED;
  camera.fixedcamid = 0;
  mjvOption visual;
  mjv_defaultOption(&visual);
  const auto kept = [&](bool shadows, bool reflections) {
    mjv_updateScene(model.get(), data, &visual, nullptr, &camera, mjCAT_ALL, &scene);
    scene.flags[mjRND_SHADOW] = shadows;
    scene.flags[mjRND_REFLECTION] = reflections;
    LeaveOutUnseen(*model, 1.0, scene);
    std::set<std::string> names;
    for (int i = 0; i < scene.ngeom; ++i)
      names.insert(mj_id2name(model.get(), mjOBJ_GEOM, scene.geoms[i].objid));
    return names;
  };
  using Names = std::set<std::string>;
  EXPECT_EQ(kept(false, false), (Names{"seen", "at_the_edge", "floor"}));
  EXPECT_EQ(kept(false, true), (Names{"seen", "at_the_edge", "mirrored", "floor"}));
  EXPECT_EQ(kept(true, false).size(), 6u) << "a shadow can fall into the view from anywhere";
  mjv_freeScene(&scene);

  const auto renderer = Renderer::Create(model).value();
  const Image mirror =
      renderer->Render(*data, "front", {.width = 96, .height = 96, .reflections = true}).value();
  int red = 0;
  for (int i = 0; i < 96 * 96; ++i) red += mirror.data[3 * i] > mirror.data[3 * i + 1] + 8;
  EXPECT_GT(red, 10) << "the ball over the view, in the floor";
  mj_deleteData(data);
}

TEST(Renderer, GrowsItsBufferForALargerImage) {
  Cubes cubes;  // MuJoCo's default buffer is 640 x 480
  const Image image =
      cubes.renderer->Render(*cubes.data, "front", {.width = 900, .height = 700}).value();
  EXPECT_GT(Channel(image, 450, 350, 0), 60);
}

TEST(Renderer, NamesTheKnownCamerasWhenOneIsUnknown) {
  Cubes cubes;
  const auto image = cubes.renderer->Render(*cubes.data, "side", {});
  EXPECT_EQ(image.status().code(), absl::StatusCode::kNotFound);
  EXPECT_NE(image.status().message().find("front"), std::string::npos);
  EXPECT_EQ(cubes.renderer->Render(*cubes.data, "front", {.width = 0}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(Renderer, DrawsThePandaFromBothCameras) {
  auto sim = MakeTestSim();
  ASSERT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  ASSERT_TRUE(sim->Settle(10).ok());
  auto renderer =
      Renderer::Create(CompileModel("test scene", ComposePandaScene(TestScene())).value()).value();
  std::vector<Image> views;
  for (const char* camera : {"agentview", "robot0_eye_in_hand"}) {
    views.push_back(renderer->Render(sim->data(), camera, {.supersample = 2}).value());
    double mean = 0, square = 0;
    for (const uint8_t v : views.back().data) mean += v, square += double(v) * v;
    mean /= views.back().data.size();
    EXPECT_GT(square / views.back().data.size() - mean * mean, 200) << camera << " shows nothing";
  }
  if (const char* file = std::getenv("ROBOSTRESS_RENDER_TEST_PNG")) {
    ASSERT_TRUE(WriteFileAtomically(file, EncodePng(HStack(views, 4)).value()).ok());
  }
}

}  // namespace
}  // namespace robostress
