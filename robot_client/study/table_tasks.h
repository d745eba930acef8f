#pragma once

#include <array>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/emulator/piper_mjcf.h"

// The tasks of the paper's real-arm experiments (its Table real and sec:real) as a scene under an
// emulated Piper: three ways to put a bowl on a plate, and a drawer. Shapes, places and words are
// ours; the paper shows the objects on photographs only.
namespace robostress::piper {

enum class TableTaskKind { kBowlToPlate, kOpenDrawer };
enum class BowlPlace { kNextToPlate, kOnCabinet, kOnBox };

struct TableTask {
  const char* name;
  const char* instruction;
  TableTaskKind kind;
  BowlPlace bowl;  // where it stands at the start
};
// In the paper's order: Tasks 1 to 4.
inline constexpr std::array<TableTask, 4> kTableTasks = {{
    {"bowl_next_to_plate", "pick up the gray bowl next to the plate and place it on the plate",
     TableTaskKind::kBowlToPlate, BowlPlace::kNextToPlate},
    {"bowl_on_cabinet", "pick up the gray bowl on the cabinet and place it on the plate",
     TableTaskKind::kBowlToPlate, BowlPlace::kOnCabinet},
    {"bowl_on_box", "pick up the gray bowl on the gift box and place it on the plate",
     TableTaskKind::kBowlToPlate, BowlPlace::kOnBox},
    {"open_drawer", "open the top drawer of the cabinet", TableTaskKind::kOpenDrawer,
     BowlPlace::kNextToPlate},
}};

// What bowl and plate look like, and how Task 1 is worded with them.
struct ObjectVariant {
  const char* name;
  const char* bowl_rgba;
  const char* plate_rgba;
  const char* instruction;  // of Task 1
};
// The first is what demonstrations show; the other five no training sees (paper, sec:real).
inline constexpr std::array<ObjectVariant, 6> kObjectVariants = {{
    {"gray", "0.42 0.43 0.46 1", "0.93 0.93 0.9 1",
     "pick up the gray bowl next to the plate and place it on the plate"},
    {"wooden", "0.62 0.42 0.22 1", "0.93 0.93 0.9 1",
     "pick up the wooden bowl next to the plate and place it on the plate"},
    {"plum", "0.45 0.16 0.38 1", "0.93 0.93 0.9 1",
     "pick up the plum-colored bowl next to the plate and place it on the plate"},
    {"light_blue", "0.55 0.76 0.92 1", "0.93 0.93 0.9 1",
     "pick up the light-blue bowl next to the plate and place it on the plate"},
    {"yellow_plate", "0.42 0.43 0.46 1", "0.95 0.82 0.3 1",
     "pick up the gray bowl next to the yellow plate and place it on the yellow plate"},
    {"green_plate", "0.42 0.43 0.46 1", "0.3 0.55 0.45 1",
     "pick up the gray bowl next to the green plate and place it on the green plate"},
}};

// NOT_FOUND lists the names.
absl::StatusOr<int> FindTableTask(const std::string& name);
absl::StatusOr<int> FindObjectVariant(const std::string& name);

// Sizes that scene, judge and expert share [m].
inline constexpr double kBowlRadius = 0.055, kBowlHeight = 0.05, kBowlWall = 0.006;
inline constexpr double kPlateRadius = 0.09, kPlateHeight = 0.01;
inline constexpr double kBoxHalf = 0.055, kBoxHeight = 0.05;
inline constexpr double kCabinetHeight = 0.1, kCabinetHalfX = 0.07, kCabinetHalfY = 0.08;
inline constexpr double kHandleOffset = 0.045;  // of the post before the cabinet's front
inline constexpr double kDrawerTravel = 0.1;

// Table, plate, gift box, cabinet with a drawer, bowl. Bodies: bowl (joint bowl_free), plate,
// gift_box, cabinet (mocap), drawer (joint drawer_slide, opens along -x); site handle.
PiperScene MakeTableScene(const ObjectVariant& variant);

}  // namespace robostress::piper
