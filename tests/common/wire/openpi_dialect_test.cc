#include "common/wire/openpi_dialect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config.h"
#include "common/wire/openpi_observation.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "tests/common/wire/openpi_bytes.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// Views of different pixels, 5 x 2: [3, 2, 3] could be read both ways.
Observation Seen(int views, int state) {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  for (int i = 0; i < views; ++i) {
    Image image{5, 2, {}};
    for (int k = 0; k < 30; ++k) image.data.push_back(static_cast<uint8_t>(40 * i + k));
    observation.views.push_back({"camera" + std::to_string(i), image});
  }
  observation.proprioception = Eigen::VectorXf::LinSpaced(state, -1, 1.0f / 3);
  return observation;
}
PolicySpec SpecFor(const Observation& observation) {
  PolicySpec spec;
  for (const CameraView& view : observation.views) spec.cameras.push_back(view.camera);
  spec.image_width = 5;
  spec.image_height = 2;
  spec.state_dim = static_cast<int>(observation.proprioception.size());
  return spec;
}
std::string Pixels(const Image& image) { return {image.data.begin(), image.data.end()}; }

TEST(OpenpiDialect, WritesWhatOpenpisClientsWrite) {
  const Observation seen = Seen(2, 8);
  std::vector<double> state(seen.proprioception.begin(), seen.proprioception.end());
  OpenpiBytes libero;
  libero.Map(5).Text("observation/image").Array("|u1", {2, 5, 3}, Pixels(seen.views[0].image));
  libero.Text("observation/wrist_image").Array("|u1", {2, 5, 3}, Pixels(seen.views[1].image));
  libero.Text("observation/state").Numbers<double>("<f8", {8}, state);
  libero.Text("prompt").Text("put the bowl on the plate").Text("reset").True();
  EXPECT_EQ(*WriteOpenpiObservation(seen, *OpenpiDialectNamed("libero"),
                                    {{"reset", OpenpiWriter().Boolean(true).Take()}}),
            libero.bytes());

  const Observation high = Seen(1, 14);
  state.assign(high.proprioception.begin(), high.proprioception.end());
  std::string planes;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = c; i < 30; i += 3) planes += static_cast<char>(high.views[0].image.data[i]);
  }
  OpenpiBytes aloha;
  aloha.Map(3).Text("images").Map(1).Text("cam_high").Array("|u1", {3, 2, 5}, planes);
  aloha.Text("state").Numbers<double>("<f8", {14}, state);
  aloha.Text("prompt").Text("put the bowl on the plate");
  EXPECT_EQ(*WriteOpenpiObservation(high, *OpenpiDialectNamed("aloha")), aloha.bytes());
}

TEST(OpenpiDialect, IsReadAsItWasWritten) {
  for (const OpenpiDialect& dialect : OpenpiDialects()) {
    const Observation seen = Seen(static_cast<int>(dialect.cameras.size()), 8);
    const auto written = WriteOpenpiObservation(seen, dialect);
    ASSERT_TRUE(written.ok()) << dialect.name << written.status();
    const auto message = DecodeOpenpi(*written);
    ASSERT_TRUE(message.ok()) << dialect.name << message.status();
    const auto read = ReadOpenpiObservation(*message, SpecFor(seen), {}, false);
    ASSERT_TRUE(read.ok()) << dialect.name << read.status();
    EXPECT_EQ(read->instruction, seen.instruction);
    EXPECT_EQ(read->proprioception, seen.proprioception) << dialect.name;
    ASSERT_EQ(read->views.size(), seen.views.size());
    for (size_t i = 0; i < seen.views.size(); ++i)
      EXPECT_EQ(read->views[i].image.data, seen.views[i].image.data) << dialect.name << i;
  }
}

TEST(OpenpiDialect, PartsTheStateAsDroidDoes) {
  const std::string written = *WriteOpenpiObservation(Seen(2, 8), *OpenpiDialectNamed("droid"));
  const OpenpiValue message = *DecodeOpenpi(written);
  EXPECT_EQ(OpenpiCount(*message.Find("observation/joint_position")), 7u);
  EXPECT_EQ(OpenpiCount(*message.Find("observation/gripper_position")), 1u);
}

TEST(OpenpiDialect, IsAFileOfKeysForAnotherServer) {
  const auto dialect = ParseConfig<OpenpiDialect>(
      "keys.yaml", "{name: lab, images_in: pictures, state: [joints], prompt: task}");
  ASSERT_TRUE(dialect.ok()) << dialect.status();
  const std::string written = *WriteOpenpiObservation(Seen(1, 3), *dialect);
  const OpenpiValue message = *DecodeOpenpi(written);
  EXPECT_NE(message.Find("pictures")->Find("camera0"), nullptr);  // the camera's own name
  EXPECT_EQ(OpenpiCount(*message.Find("joints")), 3u);
  EXPECT_EQ(*OpenpiText("task", *message.Find("task"), 100), "put the bowl on the plate");
}

TEST(OpenpiDialect, NamesWhatItHasNoKeyFor) {
  const auto refusal = [](const Observation& observation, const char* dialect) {
    return std::string(
        WriteOpenpiObservation(observation, *OpenpiDialectNamed(dialect)).status().message());
  };
  EXPECT_THAT(refusal(Seen(3, 8), "libero"),
              HasSubstr("dialect libero has keys for 2 cameras, the observation has 3 views"));
  EXPECT_THAT(refusal(Seen(2, 6), "droid"),
              HasSubstr("observation/joint_position + observation/gripper_position of 7 and the "
                        "rest; the state has 6 numbers"));
  EXPECT_THAT(std::string(OpenpiDialectNamed("bridge").status().message()),
              HasSubstr("known: libero, aloha, droid"));
}

}  // namespace
}  // namespace robostress
