#include "common/rpc/convert_observations.h"

#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

TEST(ConvertTest, ObservationSurvivesTheWireExactly) {
  const Observation sent = MakeObservation();
  const absl::StatusOr<Observation> got = FromProto(Transmit(ToProto(sent)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(got->instruction, sent.instruction);
  ASSERT_EQ(got->views.size(), 1u);
  EXPECT_EQ(got->views[0].camera, "agentview");
  EXPECT_EQ(got->views[0].image.data, sent.views[0].image.data);
  EXPECT_EQ(got->proprioception, sent.proprioception);
}

TEST(ConvertTest, RefusesHostileObservations) {
  using M = v1::Observation;
  ExpectRefused<M>(
      ToProto(MakeObservation()),
      {{[](M& m) { m.set_instruction(std::string(5000, 'a')); },
        "observation.instruction has 5000 bytes, at most 4096"},
       {[](M& m) { m.mutable_views(0)->set_camera(""); }, "observation.views.camera is empty"},
       {[](M& m) { m.mutable_views(0)->set_camera("a\nb"); },
        "observation.views.camera contains byte 10"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_width(0); },
        "observation.views.image.width is 0"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_width(4294967295u); },
        "width is 4294967295, must be 1 to 4096"},
       {[](M& m) { m.mutable_views(0)->mutable_image()->set_height(4096); },
        "has 6 bytes of image data, 2 x 4096 RGB needs 24576"},
       {[](M& m) { m.set_proprioception(0, static_cast<float>(kNan)); },
        "observation.proprioception[0] is nan"},
       {[](M& m) {
          for (int i = 0; i < 20; ++i) *m.add_views() = m.views(0);
        },
        "observation.views size is 21, must be 0 to 16"}});
}

}  // namespace
}  // namespace robostress
