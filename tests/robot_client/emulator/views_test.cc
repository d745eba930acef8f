// The emulated arm's base and wrist views as cameras. Skips, saying so, where EGL gives no context.

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "robot_client/cameras/mapped_frames.h"
#include "robot_client/can/in_process_bus.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/emulator/rendered_source.h"
#include "robot_client/emulator/view_server.h"

namespace robostress::piper {
namespace {

struct Bench {
  EmulatedTime time;
  InProcessBus bus{time};
  std::unique_ptr<PiperEmulator> emulator;
  Bench() {
    auto made = PiperEmulator::Create({}, bus.Attach(), time);
    EXPECT_TRUE(made.ok()) << made.status();
    emulator = *std::move(made);
    time.Add(emulator.get());
    time.SleepUntil(100'000'000);
  }
};

size_t Colours(const Image& image) {
  std::set<std::array<uint8_t, 3>> colours;
  for (size_t i = 0; i + 2 < image.data.size(); i += 3)
    colours.insert({image.data[i], image.data[i + 1], image.data[i + 2]});
  return colours.size();
}

TEST(ViewsTest, AreDrawnOncePerPeriodAndFollowTheArm) {
  Bench bench;
  auto renderer = ViewRenderer::Create(bench.emulator->plant().model(), 160, 120);
  if (!renderer.ok()) GTEST_SKIP() << renderer.status();
  for (const char* camera : {"piper_base_view", "piper_wrist_view"}) {
    RenderedSource source("base", camera, &bench.emulator->plant(), renderer->get(), &bench.time);
    ASSERT_TRUE(source.Start().ok()) << source.status();
    const auto first = source.Latest();
    ASSERT_NE(first, nullptr);
    EXPECT_EQ(first->image.width, 160);
    EXPECT_GT(Colours(first->image), 20u) << camera << " shows something";
    EXPECT_EQ(source.Latest(), first) << "the same picture within a period";
    bench.emulator->plant().Reset({0.6, 1.2, -1.0, 0, 0.5, 0}, 0.05);
    bench.time.SleepUntil(bench.time.now_ns() + 40'000'000);
    const auto second = source.Latest();
    EXPECT_GT(second->sequence, first->sequence);
    EXPECT_GT(second->stamp_ns, first->stamp_ns);
    EXPECT_EQ(second->stamp_ns, source.newest_stamp_ns());
    EXPECT_NE(second->image.data, first->image.data) << camera;
    bench.emulator->plant().Reset({}, 0);
  }
  RenderedSource unknown("base", "nose", &bench.emulator->plant(), renderer->get(), &bench.time);
  EXPECT_EQ(unknown.Start().code(), absl::StatusCode::kNotFound);
}

TEST(ViewsTest, ReachAClientThroughMappedFiles) {
  Bench bench;
  MonotonicClock clock;
  const std::string prefix = ::testing::TempDir() + "/views";
  auto server = ViewServer::Create({.prefix = prefix, .width = 96, .height = 64},
                                   bench.emulator->plant(), &clock);
  if (!server.ok()) GTEST_SKIP() << server.status();
  (*server)->Show(bench.emulator->plant().data());
  MappedSource wrist("wrist", prefix + ".wrist", &clock);
  ASSERT_TRUE(wrist.Start().ok()) << wrist.status();
  const int64_t until = clock.now_ns() + 20'000'000'000;
  while (wrist.newest_stamp_ns() == 0 && clock.now_ns() < until)
    clock.SleepUntil(clock.now_ns() + 5'000'000);
  const auto frame = wrist.Latest();
  ASSERT_NE(frame, nullptr);
  EXPECT_EQ(frame->image.width, 96);
  EXPECT_GT(Colours(frame->image), 10u);
  EXPECT_LE(frame->stamp_ns, clock.now_ns());
}

}  // namespace
}  // namespace robostress::piper
