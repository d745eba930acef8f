#include "robot_client/teach/episode_tap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "common/clock.h"

namespace robostress {
namespace {

using End = EpisodeTap::End;

// Ticks of live targets, 1/30 s apart, into a set without pictures.
struct Tapped {
  MonotonicClock clock;
  std::unique_ptr<DemonstrationWriter> writer;
  EpisodeTap tap{{}, nullptr};
  TickRecord tick;

  explicit Tapped(const std::string& name) : writer(Writer(name, &clock)), tap({}, writer.get()) {
    tick.state = ClientState::kMove;
    tick.flags = kTickLive;
    EXPECT_TRUE(writer->Begin("move").ok());
    tap.Open();
    Later(1.0);
  }
  void Later(double seconds) {
    tick.due_ns += std::lround(seconds * 1e9);
    tick.start_ns = tick.stamp_ns = tick.due_ns;
    ++tick.sequence;
    tap.Take(tick);
  }
  static std::unique_ptr<DemonstrationWriter> Writer(const std::string& name, const Clock* clock) {
    DemonstrationOptions options;
    options.directory = testing::TempDir() + "/episode_tap_" + name;
    std::filesystem::remove_all(options.directory);
    return DemonstrationWriter::Create(options, {}, clock).value();
  }
};

TEST(EpisodeTapTest, CountsTicksThatAreMissing) {
  Tapped t("missing");
  t.Later(1.0 / 30);
  EXPECT_EQ(t.tap.missing(), 0);
  t.Later(4.0 / 30);
  EXPECT_EQ(t.tap.missing(), 3);
  EXPECT_EQ(t.tap.ticks(), 3);
  EXPECT_EQ(t.tap.end(), End::kGoing);
  EXPECT_EQ(t.tap.Spoiled(), "");
}

TEST(EpisodeTapTest, AThreadThatStoodStillSpoilsTheEpisode) {
  Tapped t("gap");
  t.Later(0.21);
  EXPECT_EQ(t.tap.end(), End::kGap);
  EXPECT_THAT(t.tap.Spoiled(), testing::HasSubstr("stood still for more than 0.2 s"));
  t.Later(1.0 / 30);  // closed: nothing more is taken
  EXPECT_EQ(t.tap.ticks(), 1);
}

}  // namespace
}  // namespace robostress
