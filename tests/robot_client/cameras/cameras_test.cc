#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <thread>

#include "common/atomic_file.h"
#include "robot_client/cameras/faulty_source.h"
#include "robot_client/cameras/file_source.h"
#include "robot_client/cameras/mapped_frames.h"
#include "robot_client/cameras/pixel_formats.h"
#include "robot_client/cameras/synthetic_source.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kMs = 1'000'000;

TEST(SyntheticSourceTest, CarriesItsNumberInThePicture) {
  ManualClock clock(5);
  SyntheticSource source({"base"}, &clock);
  ASSERT_TRUE(source.Start().ok());
  EXPECT_EQ(source.Latest(), nullptr) << "before the first exposure";
  EXPECT_EQ(source.newest_stamp_ns(), 0);
  for (const int64_t ms : {20, 500, 7000}) {
    clock.Advance(ms * kMs);
    const auto frame = source.Latest();
    ASSERT_NE(frame, nullptr);
    EXPECT_EQ(*SequenceIn(frame->image), frame->sequence);
    EXPECT_EQ(frame->stamp_ns, source.newest_stamp_ns());
    EXPECT_GE(clock.now_ns() - frame->stamp_ns, 10 * kMs);
    EXPECT_LT(clock.now_ns() - frame->stamp_ns, 44 * kMs);
  }
  Image grey{320, 240, std::vector<uint8_t>(size_t{3} * 320 * 240, 128)};
  EXPECT_FALSE(SequenceIn(grey).ok());
}

struct Faulty {
  ManualClock clock{5};
  FaultySource source{std::make_unique<SyntheticSource>(SyntheticSourceOptions{"base"}, &clock),
                      &clock};
  Faulty() { EXPECT_TRUE(source.Start().ok()); }
  std::shared_ptr<const Frame> After(int64_t ms) {
    clock.Advance(ms * kMs);
    return source.Latest();
  }
};

TEST(FaultySourceTest, UnpluggedItDeliversNothingNewAndSaysSo) {
  Faulty camera;
  camera.After(200);
  const int64_t before = camera.source.newest_stamp_ns();
  camera.source.Set(CameraFault::kUnplug);
  camera.After(1000);
  EXPECT_EQ(camera.source.newest_stamp_ns(), before);
  EXPECT_THAT(std::string(camera.source.status().message()), HasSubstr("unplugged"));
}

TEST(FaultySourceTest, FrozenThePictureStaysAndTheStampGoesOn) {
  Faulty camera;
  const auto before = camera.After(200);
  camera.source.Set(CameraFault::kFreeze);
  const auto after = camera.After(500);
  EXPECT_EQ(before->image.data, after->image.data);
  EXPECT_GT(after->stamp_ns, before->stamp_ns);
}

TEST(FaultySourceTest, DelayedEveryPictureIsThatMuchOlder) {
  Faulty camera;
  camera.source.Set(CameraFault::kDelay, 0.3);
  for (int i = 0; i < 60; ++i) {
    const auto frame = camera.After(33);
    if (i < 20) continue;
    ASSERT_NE(frame, nullptr);
    const int64_t age = camera.clock.now_ns() - frame->stamp_ns;
    EXPECT_GE(age, 300 * kMs);
    EXPECT_LT(age, 380 * kMs);
    EXPECT_GE(camera.clock.now_ns() - camera.source.newest_stamp_ns(), 300 * kMs);
  }
}

TEST(FaultySourceTest, DropsAboutTheShareAsked) {
  Faulty camera;
  camera.After(100);
  camera.source.Set(CameraFault::kDrop, 0.4);
  int changed = 0;
  uint64_t last = 0;
  for (int i = 0; i < 300; ++i) {
    const auto frame = camera.After(34);
    if (frame->sequence != last) ++changed;
    last = frame->sequence;
  }
  EXPECT_NEAR(changed, 180, 40);
}

TEST(FaultySourceTest, CorruptsTheTopOfThePictureOnly) {
  Faulty camera;
  const auto whole = camera.After(200);
  camera.source.Set(CameraFault::kCorrupt);
  const auto corrupt = camera.source.Latest();
  EXPECT_FALSE(SequenceIn(corrupt->image).ok());
  EXPECT_TRUE(std::equal(whole->image.data.end() - 30000, whole->image.data.end(),
                         corrupt->image.data.end() - 30000));
}

TEST(FileSourceTest, PlaysPicturesInOrderAndAgainOrNot) {
  const std::string folder = ::testing::TempDir() + "/file_source";
  std::filesystem::remove_all(folder);
  ASSERT_TRUE(MakeDirectories(folder).ok());
  for (int i = 0; i < 3; ++i) {
    const Image image{2, 1, std::vector<uint8_t>(6, static_cast<uint8_t>(10 * i))};
    ASSERT_TRUE(
        WriteFileAtomically(folder + "/" + std::to_string(i) + ".ppm", FormatPpm(image)).ok());
  }
  for (const bool loop : {true, false}) {
    ManualClock clock(7);
    FileSource source({"wrist", folder, 10, loop}, &clock);
    ASSERT_TRUE(source.Start().ok());
    for (int i = 0; i < 5; ++i) {
      EXPECT_EQ(source.Latest()->image.data[0], loop ? 10 * (i % 3) : 10 * std::min(i, 2));
      clock.Advance(100 * kMs);
    }
    EXPECT_EQ(source.status().ok(), loop);
    if (!loop) {
      EXPECT_EQ(clock.now_ns() - source.newest_stamp_ns(), 300 * kMs) << "it has stopped";
    }
  }
  ManualClock clock;
  FileSource missing({"wrist", folder + "/none"}, &clock);
  EXPECT_EQ(missing.Start().code(), absl::StatusCode::kNotFound);
}

TEST(MappedFramesTest, AReaderSeesWholePicturesAndTheirStamps) {
  const std::string path = ::testing::TempDir() + "/mapped_frames";
  std::filesystem::remove(path);
  ManualClock clock(1'000'000'000);
  MappedSource source("base", path, &clock);
  EXPECT_THAT(std::string(source.Start().message()), HasSubstr("--views"));
  auto writer = MappedFrameWriter::Create(path, 64, 48);
  ASSERT_TRUE(writer.ok()) << writer.status();
  ASSERT_TRUE(source.Start().ok());
  EXPECT_EQ(source.Latest(), nullptr);
  EXPECT_EQ(source.newest_stamp_ns(), 0);
  std::atomic<bool> stop{false};
  // Every picture is of one colour, its number; a torn one would have two.
  std::thread write([&] {
    for (int i = 1; !stop; ++i) {
      const Image image{64, 48, std::vector<uint8_t>(size_t{3} * 64 * 48, static_cast<uint8_t>(i))};
      ASSERT_TRUE((*writer)->Write(image, i).ok());
    }
  });
  uint64_t last = 0;
  for (int reads = 0; reads < 2000;) {
    const auto frame = source.Latest();
    if (frame == nullptr) continue;
    ++reads;
    EXPECT_GE(frame->sequence, last);
    last = frame->sequence;
    EXPECT_EQ(frame->stamp_ns, static_cast<int64_t>(frame->sequence));
    for (const uint8_t value : frame->image.data) {
      ASSERT_EQ(value, static_cast<uint8_t>(frame->sequence));
    }
  }
  stop = true;
  write.join();
  EXPECT_EQ((*writer)->Write(Image{2, 2, std::vector<uint8_t>(12)}, 1).code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(MappedFramesTest, AWriterThatStartsAnewIsFoundAgainAndDamageIsRefused) {
  const std::string path = ::testing::TempDir() + "/mapped_again";
  ManualClock clock(10'000'000'000);
  const Image image{8, 8, std::vector<uint8_t>(192, 5)};
  auto writer = MappedFrameWriter::Create(path, 8, 8);
  ASSERT_TRUE(writer.ok() && (*writer)->Write(image, clock.now_ns()).ok());
  MappedSource source("base", path, &clock);
  ASSERT_TRUE(source.Start().ok());
  EXPECT_TRUE(source.status().ok());
  clock.Advance(5'000'000'000);
  EXPECT_FALSE(source.status().ok());
  auto again = MappedFrameWriter::Create(path, 8, 8);
  ASSERT_TRUE(again.ok() && (*again)->Write(image, clock.now_ns()).ok());
  ASSERT_NE(source.Latest(), nullptr);
  EXPECT_EQ(source.Latest()->stamp_ns, clock.now_ns());
  ASSERT_TRUE(WriteFileAtomically(path, "RSFRAME1 and nothing else").ok());
  MappedSource damaged("base", path, &clock);
  EXPECT_EQ(damaged.Start().code(), absl::StatusCode::kDataLoss);
}

// Any moment is a moment of truncation: a reader that mapped the file would die of SIGBUS here.
TEST(MappedFramesTest, AFileThatIsTruncatedStopsTheCameraSaysWhyAndComesBack) {
  const std::string path = ::testing::TempDir() + "/mapped_truncated";
  ManualClock clock(10'000'000'000);
  auto writer = MappedFrameWriter::Create(path, 64, 48);
  ASSERT_TRUE(writer.ok());
  const auto write = [&](uint8_t colour) {
    clock.Advance(33 * kMs);
    const Image image{64, 48, std::vector<uint8_t>(size_t{3} * 64 * 48, colour)};
    ASSERT_TRUE((*writer)->Write(image, clock.now_ns()).ok());
  };
  write(1);
  MappedSource source("wrist", path, &clock);
  ASSERT_TRUE(source.Start().ok());
  write(2);
  const auto whole = std::filesystem::file_size(path);
  for (const off_t length : {off_t{0}, off_t{8}, off_t{16}, off_t{30}, off_t{4096},
                             static_cast<off_t>(whole / 2), static_cast<off_t>(whole) - 1}) {
    const int64_t stamp = source.newest_stamp_ns();
    const auto before = source.Latest();
    ASSERT_EQ(truncate(path.c_str(), length), 0);
    clock.Advance(600 * kMs);
    EXPECT_EQ(source.newest_stamp_ns(), stamp) << length << ": it grows old";
    EXPECT_EQ(source.Latest(), before);
    EXPECT_THAT(std::string(source.status().message()),
                HasSubstr("camera 'wrist': " + path + " is truncated: " + std::to_string(length)));
    write(3);
    write(4);
    EXPECT_EQ(std::filesystem::file_size(path), whole);
    EXPECT_TRUE(source.status().ok()) << source.status();
    EXPECT_EQ(source.newest_stamp_ns(), clock.now_ns());
    EXPECT_EQ(source.Latest()->image.data[0], 4);
  }
}

TEST(MappedFramesTest, SurvivesAFileThatIsTruncatedWhileItIsRead) {
  const std::string path = ::testing::TempDir() + "/mapped_shaken";
  ManualClock clock(1'000'000'000);
  auto writer = MappedFrameWriter::Create(path, 64, 48);
  ASSERT_TRUE(writer.ok());
  MappedSource source("base", path, &clock);
  ASSERT_TRUE(source.Start().ok());
  std::atomic<bool> stop{false};
  std::thread shake([&] {
    for (int i = 1; !stop; ++i) {
      const Image image{64, 48, std::vector<uint8_t>(size_t{3} * 64 * 48, static_cast<uint8_t>(i))};
      ASSERT_TRUE((*writer)->Write(image, i).ok());
      if (i % 3 == 0) {
        ASSERT_EQ(truncate(path.c_str(), (i * 997) % 18000), 0);
      }
    }
  });
  std::thread control([&] {
    while (!stop) EXPECT_GE(source.newest_stamp_ns(), 0);
  });
  uint64_t last = 0;
  for (int changed = 0; changed < 300;) {
    const auto frame = source.Latest();
    if (frame == nullptr || frame->sequence == last) continue;
    ++changed;
    last = frame->sequence;
    ASSERT_EQ(frame->image.data.size(), size_t{3} * 64 * 48);
  }
  stop = true;
  shake.join();
  control.join();
}

TEST(MappedFramesTest, AStampFromTheFutureIsStaleNotFreshForEver) {
  const std::string path = ::testing::TempDir() + "/mapped_future";
  ManualClock clock(10'000'000'000);
  auto writer = MappedFrameWriter::Create(path, 8, 8);
  const Image image{8, 8, std::vector<uint8_t>(192, 5)};
  ASSERT_TRUE(writer.ok() && (*writer)->Write(image, clock.now_ns()).ok());
  MappedSource source("base", path, &clock);
  ASSERT_TRUE(source.Start().ok());
  const int64_t good = source.newest_stamp_ns();
  ASSERT_TRUE((*writer)->Write(image, clock.now_ns() + 3'600'000'000'000).ok());
  clock.Advance(600 * kMs);
  EXPECT_EQ(source.newest_stamp_ns(), good);
  EXPECT_EQ(source.Latest(), nullptr) << "only the picture from the future was asked for";
  EXPECT_THAT(std::string(source.status().message()), HasSubstr("3599.400 s in the future"));
  ASSERT_TRUE((*writer)->Write(image, clock.now_ns()).ok());
  EXPECT_EQ(source.newest_stamp_ns(), clock.now_ns());
  EXPECT_TRUE(source.status().ok());
}

TEST(FrameStampsTest, ACameraFromTheFutureCountsAsOneThatDeliveredNothing) {
  Faulty ahead, sound;
  sound.After(200);
  ahead.After(200);
  ahead.source.Set(CameraFault::kFuture, 0.5);
  EXPECT_GT(ahead.source.newest_stamp_ns(), ahead.clock.now_ns());
  const FrameStamps stamps({&sound.source, &ahead.source}, &ahead.clock);
  EXPECT_EQ(stamps.Oldest(), 0);
  ahead.source.Set(CameraFault::kFuture, 0.01);
  EXPECT_EQ(stamps.Oldest(), sound.source.newest_stamp_ns()) << "a driver's rounding is none";
}

TEST(PixelFormatsTest, YuyvBecomesRgbAsBt601Says) {
  // Black, white, and pure red (Y 81, U 90, V 240).
  const uint8_t bytes[] = {16, 128, 235, 128, 81, 90, 81, 240};
  const auto image = RgbFromYuyv({reinterpret_cast<const char*>(bytes), 8}, 4, 1, 8);
  ASSERT_TRUE(image.ok());
  const std::vector<int> expected = {0, 0, 0, 255, 255, 255, 255, 0, 0, 255, 0, 0};
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(image->data[i], expected[i], 2) << i;
  EXPECT_FALSE(RgbFromYuyv({reinterpret_cast<const char*>(bytes), 7}, 4, 1, 8).ok());
  EXPECT_FALSE(RgbFromYuyv({reinterpret_cast<const char*>(bytes), 8}, 3, 1, 8).ok());
}

TEST(PixelFormatsTest, PpmIsReadBackAndDamageIsNamed) {
  const Image image{3, 2, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18}};
  const std::string bytes = FormatPpm(image);
  const auto back = ParsePpm("a.ppm", bytes);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->data, image.data);
  for (size_t cut = 0; cut < bytes.size(); ++cut)
    EXPECT_FALSE(ParsePpm("a.ppm", bytes.substr(0, cut)).ok()) << cut;
  EXPECT_THAT(std::string(ParsePpm("a.ppm", "P6\n99999 1\n255\n").status().message()),
              HasSubstr("a.ppm"));
}

}  // namespace
}  // namespace robostress
