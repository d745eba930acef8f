#include "robot_client/study/table_tasks.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"

namespace robostress::piper {
namespace {

// Contact bits: 1 touches the arm (piper_mjcf.h), 2 carries the bowl.
constexpr char kSupport[] = R"(contype="3" conaffinity="0" friction="0.8 0.01 0.0001" group="1")";
constexpr char kBowlContact[] =
    R"(contype="1" conaffinity="2" condim="4" friction="1 0.02 0.0001" group="1")";
constexpr char kSeen[] = R"(contype="0" conaffinity="0" group="1")";
constexpr int kBowlSides = 16;

template <class List>
absl::StatusOr<int> Find(const List& list, const std::string& name, const char* what) {
  std::vector<std::string> names;
  for (size_t i = 0; i < list.size(); ++i) {
    if (name == list[i].name) return static_cast<int>(i);
    names.push_back(list[i].name);
  }
  return absl::NotFoundError(
      absl::StrCat("no ", what, " '", name, "'; there are ", absl::StrJoin(names, ", ")));
}

// A ring of boxes around a disc; its frame lies at the centre of the underside.
std::string Bowl(const ObjectVariant& variant) {
  std::string xml = absl::StrFormat(
      R"(<body name="bowl"><freejoint name="bowl_free"/>
<geom type="cylinder" size="%g 0.003" pos="0 0 0.003" mass="0.03" rgba="%s" %s/>)",
      kBowlRadius - kBowlWall, variant.bowl_rgba, kBowlContact);
  const double middle = kBowlRadius - kBowlWall / 2;
  const double half_side = kBowlRadius * std::tan(M_PI / kBowlSides);
  for (int i = 0; i < kBowlSides; ++i) {
    const double angle = 2 * M_PI * i / kBowlSides;
    absl::StrAppendFormat(
        &xml,
        R"(<geom type="box" size="%g %g %g" pos="%g %g %g" euler="0 0 %g" mass="0.003" rgba="%s" %s/>)",
        kBowlWall / 2, half_side, kBowlHeight / 2, middle * std::cos(angle),
        middle * std::sin(angle), kBowlHeight / 2, angle, variant.bowl_rgba, kBowlContact);
  }
  return absl::StrCat(xml, "</body>\n");
}

std::string Cabinet() {
  const double front = -kCabinetHalfX, middle = kCabinetHeight / 2;
  return absl::StrFormat(
      R"(<body name="cabinet" mocap="true">
<geom type="box" size="%g %g 0.005" pos="0 0 %g" rgba="0.25 0.45 0.75 1" %s/>
<geom type="box" size="%g 0.004 %g" pos="0 %g %g" rgba="0.25 0.45 0.75 1" %s/>
<geom type="box" size="%g 0.004 %g" pos="0 %g %g" rgba="0.25 0.45 0.75 1" %s/>
<geom type="box" size="0.004 %g %g" pos="%g 0 %g" rgba="0.25 0.45 0.75 1" %s/>
<geom type="box" size="0.004 %g 0.02" pos="%g 0 0.022" rgba="0.85 0.85 0.88 1" %s/>
<body name="drawer">
  <inertial pos="0 0 0.07" mass="0.25" diaginertia="4e-4 4e-4 4e-4"/>
  <joint name="drawer_slide" type="slide" axis="-1 0 0" limited="true" range="0 %g" damping="6" armature="0.1" frictionloss="0.6"/>
  <geom type="box" size="0.004 %g 0.022" pos="%g 0 0.069" rgba="0.95 0.95 0.97 1" %s/>
  <geom type="box" size="0.055 0.07 0.002" pos="0 0 0.05" rgba="0.9 0.9 0.9 1" %s/>
  <geom type="box" size="%g 0.004 0.004" pos="%g 0 0.07" rgba="0.15 0.15 0.15 1" %s/>
  <geom type="capsule" size="0.009" fromto="%g 0 0.045 %g 0 0.1" rgba="0.9 0.25 0.1 1" contype="1" conaffinity="0" condim="4" friction="1 0.02 0.0001" group="1"/>
  <site name="handle" pos="%g 0 0.07" size="0.002" group="4"/>
</body></body>
)",
      kCabinetHalfX, kCabinetHalfY, kCabinetHeight - 0.005, kSupport, kCabinetHalfX, middle,
      kCabinetHalfY - 0.004, middle, kSeen, kCabinetHalfX, middle, -kCabinetHalfY + 0.004, middle,
      kSeen, kCabinetHalfY, middle, kCabinetHalfX - 0.004, middle, kSeen, kCabinetHalfY - 0.008,
      front + 0.004, kSeen, kDrawerTravel, kCabinetHalfY - 0.006, front, kSeen, kSeen,
      kHandleOffset / 2, front - kHandleOffset / 2, kSeen, front - kHandleOffset,
      front - kHandleOffset, front - kHandleOffset);
}

}  // namespace

absl::StatusOr<int> FindTableTask(const std::string& name) {
  return Find(kTableTasks, name, "task");
}

absl::StatusOr<int> FindObjectVariant(const std::string& name) {
  return Find(kObjectVariants, name, "object variant");
}

PiperScene MakeTableScene(const ObjectVariant& variant) {
  PiperScene scene;
  scene.name = "piper_table";
  scene.world_xml = absl::StrCat(
      absl::StrFormat(
          R"(<geom name="table" type="plane" size="1.5 1.5 0.1" rgba="0.72 0.66 0.56 1" %s/>
<body name="plate" mocap="true">
<geom type="cylinder" size="%g %g" pos="0 0 %g" rgba="%s" %s/>
<geom type="cylinder" size="%g 0.0005" pos="0 0 %g" rgba="0.75 0.2 0.2 1" %s/>
<geom type="cylinder" size="%g 0.0006" pos="0 0 %g" rgba="%s" %s/></body>
<body name="gift_box" mocap="true">
<geom type="box" size="%g %g %g" pos="0 0 %g" rgba="0.75 0.12 0.18 1" %s/>
<geom type="box" size="0.01 %g 0.0005" pos="0 0 %g" rgba="0.98 0.85 0.2 1" %s/>
<geom type="box" size="%g 0.01 0.0005" pos="0 0 %g" rgba="0.98 0.85 0.2 1" %s/></body>
)",
          kSupport, kPlateRadius, kPlateHeight / 2, kPlateHeight / 2, variant.plate_rgba, kSupport,
          kPlateRadius - 0.012, kPlateHeight, kSeen, kPlateRadius - 0.018, kPlateHeight,
          variant.plate_rgba, kSeen, kBoxHalf, kBoxHalf, kBoxHeight / 2, kBoxHeight / 2, kSupport,
          kBoxHalf, kBoxHeight, kSeen, kBoxHalf, kBoxHeight, kSeen),
      Cabinet(), Bowl(variant));
  return scene;
}

}  // namespace robostress::piper
