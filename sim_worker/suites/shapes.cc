#include "sim_worker/suites/shapes.h"

#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/check.h"

namespace robostress {
namespace {

// Contact bits. The robot touches contype bit 1 (panda_mjcf.h). Feet (2) stand on supports, bodies
// of objects (4) touch each other and walls; nothing else collides.
constexpr char kFootMask[] = R"(contype="2" conaffinity="0")";
constexpr char kBodyMask[] = R"(contype="5" conaffinity="4")";
constexpr char kSupportMask[] = R"(contype="0" conaffinity="2")";
constexpr char kWallMask[] = R"(contype="0" conaffinity="4")";
constexpr char kHandleMask[] = R"(contype="1" conaffinity="0")";

constexpr double kDrawerFront = -0.06;  // y of the cabinet's front [m]
constexpr double kKnobArm = 0.045;      // [m]

std::string Visual(const std::string& type, const std::string& size, const std::string& pos,
                   const std::string& color) {
  return absl::StrFormat(R"(<geom class="visual" type="%s" size="%s" pos="%s" rgba="%s"/>)", type,
                         size, pos, Rgba(color));
}

std::string Support(const std::string& size, const std::string& pos) {
  return absl::StrFormat(
      R"(<geom type="box" group="0" %s size="%s" pos="%s" friction="0.8 0.01 0.0001"/>)",
      kSupportMask, size, pos);
}

std::string Wall(const std::string& size, const std::string& pos) {
  return absl::StrFormat(
      R"(<geom type="box" group="0" %s size="%s" pos="%s" friction="0.3 0.005 0.0001"/>)",
      kWallMask, size, pos);
}

// A capsule that the gripper closes on, from `bottom` to `top` [m].
std::string HandlePost(double radius, double bottom, double top, const std::string& xy,
                       const std::string& color) {
  return absl::StrFormat(
      R"(<geom type="capsule" %s size="%g" fromto="%s %g %s %g" rgba="%s" friction="1 0.005 0.0001"/>)",
      kHandleMask, radius, xy, bottom + radius, xy, top - radius, Rgba(color));
}

// The collision shape of an object: one box between the pads and four feet, for a movable prop
// only.
std::string GraspProxy(const std::string& size, const std::string& pos, double foot_spread) {
  std::string xml = absl::StrFormat(
      R"(<geom type="box" group="0" %s size="%s" pos="%s" friction="1 0.02 0.0001" condim="4"/>)",
      kBodyMask, size, pos);
  for (int i = 0; i < 4; ++i) {
    absl::StrAppendFormat(
        &xml,
        R"(<geom type="sphere" group="0" %s size="0.006" pos="%g %g 0.006" friction="0.8 0.01 0.0001"/>)",
        kFootMask, (i & 1 ? 1 : -1) * foot_spread, (i & 2 ? 1 : -1) * foot_spread);
  }
  return xml;
}

std::string Inertial(double mass, double z) {
  return absl::StrFormat(R"(<inertial pos="0 0 %g" mass="%g" diaginertia="1e-4 1e-4 1e-4"/>)", z,
                         mass);
}

// Seen, and collided with if it can move.
struct Parts {
  std::string visual, proxy, inertial, children;
};

Parts PartsOf(const Prop& prop) {
  Parts parts;
  const std::string& c = prop.color;
  switch (prop.kind) {
    case PropKind::kPot:
      parts.visual = Visual("cylinder", "0.042 0.015", "0 0 0.015", c) +
                     Visual("cylinder", "0.036 0.002", "0 0 0.032", "black") +
                     Visual("cylinder", "0.032 0.002", "0 0 0.033", c) +
                     Visual("cylinder", "0.017 0.014", "0 0 0.047", c);
      parts.proxy = GraspProxy("0.016 0.016 0.028", "0 0 0.033", 0.03);
      parts.inertial = Inertial(0.10, 0.02);
      break;
    case PropKind::kCube:
      parts.visual = Visual("box", "0.02 0.02 0.02", "0 0 0.02", c);
      parts.proxy = GraspProxy("0.02 0.02 0.0185", "0 0 0.0215", 0.014);
      parts.inertial = Inertial(0.06, 0.02);
      break;
    case PropKind::kCan:
      parts.visual = Visual("cylinder", "0.021 0.03", "0 0 0.03", c);
      parts.proxy = GraspProxy("0.018 0.018 0.0285", "0 0 0.0315", 0.013);
      parts.inertial = Inertial(0.07, 0.025);
      break;
    case PropKind::kBottle:
      parts.visual = Visual("cylinder", "0.021 0.025", "0 0 0.025", c) +
                     Visual("cylinder", "0.014 0.013", "0 0 0.063", c);
      parts.proxy = GraspProxy("0.018 0.018 0.024", "0 0 0.027", 0.014);
      parts.inertial = Inertial(0.07, 0.022);
      break;
    case PropKind::kBrick:
      parts.visual = Visual("box", "0.036 0.019 0.015", "0 0 0.015", c);
      parts.proxy = GraspProxy("0.036 0.019 0.0135", "0 0 0.0165", 0.015);
      parts.inertial = Inertial(0.07, 0.015);
      break;
    case PropKind::kPlate:
      parts.visual = Visual("cylinder", "0.08 0.005", "0 0 0.005", c) +
                     Visual("cylinder", "0.058 0.0055", "0 0 0.0055", "silver");
      parts.children = Support("0.075 0.075 0.005", "0 0 0.006");
      parts.inertial = Inertial(0.2, 0.005);
      break;
    case PropKind::kBasket: {
      parts.visual = Visual("box", "0.075 0.075 0.002", "0 0 0.002", "dark_brown");
      const char* walls[4][2] = {{"0.004 0.079 0.02", "0.079 0 0.02"},
                                 {"0.004 0.079 0.02", "-0.079 0 0.02"},
                                 {"0.079 0.004 0.02", "0 0.079 0.02"},
                                 {"0.079 0.004 0.02", "0 -0.079 0.02"}};
      for (const auto& wall : walls) {
        parts.visual += Visual("box", wall[0], wall[1], c);
        parts.children += Wall(wall[0], wall[1]);
      }
      parts.children += Support("0.079 0.079 0.006", "0 0 -0.002");
      break;
    }
    case PropKind::kBox:
      parts.visual = Visual("box", "0.055 0.055 0.02", "0 0 0.02", c);
      parts.children = Support("0.055 0.055 0.02", "0 0 0.02");
      break;
    case PropKind::kMat:
      parts.visual = Visual("box", "0.085 0.085 0.001", "0 0 0.001", c);
      break;
    case PropKind::kRack:
      parts.visual = Visual("box", "0.06 0.06 0.008", "0 0 0.008", c);
      for (int i = -2; i <= 2; ++i) {
        parts.visual +=
            Visual("box", "0.005 0.058 0.002", absl::StrCat(0.024 * i, " 0 0.017"), "silver");
      }
      parts.children = Support("0.065 0.065 0.009", "0 0 0.009");
      break;
    case PropKind::kCabinet:
      parts.visual = Visual("box", "0.07 0.06 0.006", "0 0 0.072", c) +
                     Visual("box", "0.07 0.006 0.036", "0 0.054 0.036", c) +
                     Visual("box", "0.006 0.06 0.036", "0.064 0 0.036", c) +
                     Visual("box", "0.006 0.06 0.036", "-0.064 0 0.036", c);
      parts.children =
          Support("0.075 0.065 0.01", "0 0 0.068") +
          absl::StrFormat(
              R"(<body name="%s_drawer">%s<joint name="%s_slide" type="slide" axis="0 -1 0" limited="true" range="0 0.11" damping="8" armature="0.2" frictionloss="0.8"/>%s%s%s%s%s%s%s%s</body>)",
              prop.name, Inertial(0.4, 0.03), prop.name,
              Visual("box", "0.055 0.005 0.028", absl::StrCat("0 ", kDrawerFront + 0.003, " 0.032"),
                     "tan"),
              Visual("box", "0.055 0.05 0.003", "0 -0.005 0.012", "tan"),
              Visual("box", "0.006 0.02 0.006", absl::StrCat("0 ", kDrawerFront - 0.022, " 0.03"),
                     "black"),
              HandlePost(0.012, 0.004, 0.06, absl::StrCat("0 ", kDrawerFront - 0.045), "black"),
              Support("0.055 0.052 0.005", "0 -0.005 0.01"),
              Wall("0.055 0.004 0.02", absl::StrCat("0 ", kDrawerFront + 0.003, " 0.022")),
              Wall("0.004 0.05 0.02", "0.055 -0.005 0.022"),
              Wall("0.004 0.05 0.02", "-0.055 -0.005 0.022"));
      break;
    case PropKind::kStove:
      parts.visual = Visual("box", "0.07 0.07 0.01", "0 0 0.01", c) +
                     Visual("cylinder", "0.052 0.0012", "0 0 0.0205", "black") +
                     Visual("cylinder", "0.03 0.0014", "0 0 0.0208", "orange");
      parts.children =
          Support("0.075 0.075 0.01", "0 0 0.01") +
          absl::StrFormat(
              R"(<body name="%s_knob" pos="0 0.12 0">%s<joint name="%s_hinge" type="hinge" axis="0 0 -1" limited="true" range="0 1.7" damping="0.05" armature="0.005" frictionloss="0.02"/>%s%s%s</body>)",
              prop.name, Inertial(0.1, 0.02), prop.name,
              Visual("cylinder", "0.02 0.008", "0 0 0.008", c),
              Visual("box", "0.024 0.007 0.006", absl::StrCat(-kKnobArm / 2, " 0 0.014"), "orange"),
              HandlePost(0.012, 0.004, 0.06, absl::StrCat(-kKnobArm, " 0"), "orange"));
      break;
    case PropKind::kCup:
      parts.visual = Visual("cylinder", "0.026 0.03", "0 0 0.03", c) +
                     Visual("cylinder", "0.021 0.0305", "0 0 0.0305", "black");
      break;
  }
  return parts;
}

std::map<PropKind, ShapeInfo> MakeShapes() {
  std::map<PropKind, ShapeInfo> shapes;
  shapes[PropKind::kPot] = {0.045, 0.061, true, 0.047, 0.032, false, {}};
  shapes[PropKind::kCube] = {0.028, 0.04, true, 0.025, 0.040, false, {}};
  shapes[PropKind::kCan] = {0.026, 0.06, true, 0.038, 0.036, false, {}};
  shapes[PropKind::kBottle] = {0.026, 0.076, true, 0.043, 0.036, false, {}};
  shapes[PropKind::kBrick] = {0.036, 0.03, true, 0.021, 0.038, false, {}};
  shapes[PropKind::kPlate] = {
      0.08, 0.011, false, 0, 0, true, {"", {0, 0, 0.011}, {0.055, 0.055}, 0.006}};
  shapes[PropKind::kBasket] = {
      0.09, 0.04, false, 0, 0, true, {"", {0, 0, 0.004}, {0.075, 0.075}, 0.02}};
  shapes[PropKind::kBox] = {0.06, 0.04, false, 0, 0, true, {"", {0, 0, 0.04}, {0.05, 0.05}, 0.006}};
  shapes[PropKind::kMat] = {
      0.06, 0.002, false, 0, 0, true, {"", {0, 0, 0.0}, {0.045, 0.045}, 0.006}};
  shapes[PropKind::kRack] = {
      0.065, 0.02, false, 0, 0, true, {"", {0, 0, 0.018}, {0.055, 0.055}, 0.006}};
  shapes[PropKind::kCabinet] = {
      0.085, 0.078, false, 0, 0, true, {"", {0, 0, 0.078}, {0.06, 0.055}, 0.006}};
  shapes[PropKind::kStove] = {
      0.085, 0.022, false, 0, 0, true, {"", {0, 0, 0.02}, {0.055, 0.055}, 0.006}};
  shapes[PropKind::kCup] = {0.028, 0.06, false, 0, 0, false, {}};
  return shapes;
}

}  // namespace

const ShapeInfo& ShapeOf(PropKind kind) {
  static const std::map<PropKind, ShapeInfo>& shapes =
      *new std::map<PropKind, ShapeInfo>(MakeShapes());
  return shapes.at(kind);
}

const Region& DrawerRegion() {
  static const Region& region = *new Region{"_drawer", {0, -0.012, 0.015}, {0.045, 0.045}, 0.015};
  return region;
}

const Handle& DrawerHandle() {
  static const Handle& handle =
      *new Handle{"_drawer", "_slide", {0, kDrawerFront - 0.045, 0.04}, 0.024, 0.075};
  return handle;
}

const Handle& KnobHandle() {
  static const Handle& handle = *new Handle{"_knob", "_hinge", {-kKnobArm, 0, 0.04}, 0.024, 1.0};
  return handle;
}

std::string Rgba(const std::string& color) {
  static const std::map<std::string, std::string>& colors = *new std::map<std::string, std::string>{
      {"red", "0.9 0.08 0.06 1"},     {"blue", "0.08 0.2 0.9 1"},
      {"yellow", "0.98 0.85 0.05 1"}, {"green", "0.05 0.6 0.15 1"},
      {"purple", "0.5 0.1 0.65 1"},   {"orange", "1 0.45 0.02 1"},
      {"cyan", "0.05 0.75 0.85 1"},   {"pink", "1 0.45 0.7 1"},
      {"white", "0.97 0.97 0.97 1"},  {"black", "0.06 0.06 0.06 1"},
      {"brown", "0.5 0.3 0.14 1"},    {"dark_brown", "0.3 0.18 0.08 1"},
      {"grey", "0.35 0.36 0.4 1"},    {"silver", "0.78 0.78 0.8 1"},
      {"tan", "0.82 0.66 0.42 1"}};
  const auto it = colors.find(color);
  RS_CHECK(it != colors.end());
  return it->second;
}

std::string PropMjcf(const Prop& prop, Mobility mobility) {
  const Parts parts = PartsOf(prop);
  switch (mobility) {
    case Mobility::kStatic:
      return absl::StrFormat("<body name=\"%s\" mocap=\"true\">%s%s</body>\n", prop.name,
                             parts.visual, parts.children);
    case Mobility::kFree:
      return absl::StrFormat("<body name=\"%s\">%s<freejoint name=\"%s_joint\"/>%s%s%s</body>\n",
                             prop.name, parts.inertial, prop.name, parts.visual, parts.proxy,
                             parts.children);
    case Mobility::kPlanar:
      return absl::StrFormat(
          "<body name=\"%s\">%s"
          "<joint name=\"%s_x\" type=\"slide\" axis=\"1 0 0\" damping=\"4\" armature=\"0.2\" "
          "frictionloss=\"1\"/>"
          "<joint name=\"%s_y\" type=\"slide\" axis=\"0 1 0\" damping=\"4\" armature=\"0.2\" "
          "frictionloss=\"1\"/>"
          "%s%s<geom type=\"box\" group=\"0\" %s size=\"0.05 0.078 0.006\" pos=\"0 0 0.008\" "
          "friction=\"0.3 0.005 0.0001\"/>"
          "</body>\n",
          prop.name, parts.inertial, prop.name, prop.name, parts.visual, parts.children,
          kHandleMask);
  }
  return "";
}

}  // namespace robostress
