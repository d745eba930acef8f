#include "sim_worker/libero/object_file.h"

#include <gmock/gmock.h>

#include "absl/strings/str_replace.h"

namespace robostress::libero {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kCabinet[] = R"(<mujoco>
<worldbody><body>
  <body name="object">
    <geom type="box" size="1 1 1" group="0"/>
    <geom type="box" size="1 1 1" group="3"/>
    <geom type="box" size="1 1 1" group="1"/>
    <body name="drawer">
      <joint name="level" type="slide"/>
      <geom type="box" size="1 1 1" group="0"/>
      <site name="top_region"/>
    </body>
  </body>
  <site name="bottom_site" pos="0 0 -0.05"/>
  <site name="top_site" pos="0 0 0.2"/>
  <site name="horizontal_radius_site" pos="0.1 0 0"/>
</body></worldbody></mujoco>)";

absl::StatusOr<ObjectFile> Parse(const std::string& text, bool fixture = true) {
  return ObjectFile::Parse("/assets/cabinet.xml", text, "cabinet_1", fixture);
}

std::string ErrorOf(const std::string& from, const std::string& to) {
  const std::string text = absl::StrReplaceAll(kCabinet, {{from, to}});
  EXPECT_NE(text, kCabinet) << from;
  const absl::StatusOr<ObjectFile> object = Parse(text);
  return object.ok() ? "parsed" : std::string(object.status().message());
}

TEST(ObjectFileTest, CarriesTheInstancesNamesAndItsRegionsJoints) {
  const absl::StatusOr<ObjectFile> fixture = Parse(kCabinet);
  ASSERT_TRUE(fixture.ok()) << fixture.status();
  EXPECT_EQ(fixture->bottom(), -0.05);
  EXPECT_EQ(fixture->top(), 0.2);
  EXPECT_EQ(fixture->horizontal_radius(), 0.1);
  EXPECT_THAT(fixture->joints(), ElementsAre("cabinet_1_level"));
  EXPECT_THAT(fixture->contact_geoms(), ElementsAre("cabinet_1_g0", "cabinet_1_g3"))
      << "numbered over all geoms, the dropped one of group 3 included";
  const SiteOwner& region = fixture->sites().at("cabinet_1_top_region");
  EXPECT_EQ(region.parent, "cabinet_1");
  EXPECT_THAT(region.joints, ElementsAre("cabinet_1_level"));
}

TEST(ObjectFileTest, OnlyAMovableObjectGetsAFreeJointAndItMovesNoRegion) {
  const absl::StatusOr<ObjectFile> movable = Parse(kCabinet, /*fixture=*/false);
  ASSERT_TRUE(movable.ok()) << movable.status();
  EXPECT_THAT(movable->joints(), ElementsAre("cabinet_1_level", "cabinet_1_joint0"));
  EXPECT_THAT(movable->sites().at("cabinet_1_top_region").joints, ElementsAre("cabinet_1_level"));
}

TEST(ObjectFileTest, AGeomInsideADroppedGeomIsDroppedWithIt) {
  const absl::StatusOr<ObjectFile> object = Parse(absl::StrReplaceAll(
      kCabinet, {{R"(group="3"/>)", R"(group="3"><geom group="2"/><geom group="0"/></geom>)"}}));
  ASSERT_TRUE(object.ok()) << object.status();
  EXPECT_THAT(object->contact_geoms(), ElementsAre("cabinet_1_g0", "cabinet_1_g5"));
}

TEST(ObjectFileTest, ErrorsNameFileAndPlace) {
  EXPECT_THAT(ErrorOf("</worldbody>", ""), HasSubstr("/assets/cabinet.xml:"));
  EXPECT_THAT(ErrorOf("name=\"object\"", "name=\"thing\""),
              HasSubstr("/assets/cabinet.xml: no worldbody/body/body[@name='object']"));
  EXPECT_THAT(ErrorOf("bottom_site", "floor_site"),
              HasSubstr("/assets/cabinet.xml: no bottom_site"));
  EXPECT_THAT(ErrorOf("top_site", "floor_site"), HasSubstr("/assets/cabinet.xml: no top_site"));
  EXPECT_THAT(ErrorOf("0 0 -0.05", "0 0"),
              HasSubstr("/assets/cabinet.xml:13: bottom_site's pos has 2 numbers"));
  EXPECT_THAT(ErrorOf("0 0 -0.05", "0 0 low"),
              HasSubstr("/assets/cabinet.xml:13: <site pos=\"0 0 low\">: 'low' is not a number"));
  EXPECT_THAT(ErrorOf("name=\"level\" ", ""),
              HasSubstr("/assets/cabinet.xml:8: a <joint> without a name"));
  EXPECT_THAT(ErrorOf("type=\"slide\"", "class=\"rail\""),
              HasSubstr("/assets/cabinet.xml:8: default class 'rail' does not exist"));
  EXPECT_THAT(ErrorOf("type=\"slide\"", "childclass=\"rail\""),
              HasSubstr("/assets/cabinet.xml:8: childclass is not supported"));
}

TEST(ObjectFileTest, AnObjectWithoutPartsHasNone) {
  const absl::StatusOr<ObjectFile> object = Parse(
      R"(<mujoco><worldbody><body><body name="object"/><site name="bottom_site"/><site name="top_site"/>
               <site name="horizontal_radius_site"/></body></worldbody></mujoco>)");
  ASSERT_TRUE(object.ok()) << object.status();
  EXPECT_THAT(object->joints(), IsEmpty());
  EXPECT_THAT(object->contact_geoms(), IsEmpty());
}

}  // namespace
}  // namespace robostress::libero
