#include "common/libero/own_tasks.h"

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/libero/home.h"
#include "common/suites.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr LiberosOwnSuite kSuites[] = {
    {"libero_spatial",
     {"pick_up_the_black_bowl_between_the_plate_and_the_ramekin_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_next_to_the_ramekin_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_from_table_center_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_on_the_cookie_box_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_in_the_top_drawer_of_the_wooden_cabinet_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_on_the_ramekin_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_next_to_the_cookie_box_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_on_the_stove_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_next_to_the_plate_and_place_it_on_the_plate",
      "pick_up_the_black_bowl_on_the_wooden_cabinet_and_place_it_on_the_plate"}},
    {"libero_object",
     {"pick_up_the_alphabet_soup_and_place_it_in_the_basket",
      "pick_up_the_cream_cheese_and_place_it_in_the_basket",
      "pick_up_the_salad_dressing_and_place_it_in_the_basket",
      "pick_up_the_bbq_sauce_and_place_it_in_the_basket",
      "pick_up_the_ketchup_and_place_it_in_the_basket",
      "pick_up_the_tomato_sauce_and_place_it_in_the_basket",
      "pick_up_the_butter_and_place_it_in_the_basket",
      "pick_up_the_milk_and_place_it_in_the_basket",
      "pick_up_the_chocolate_pudding_and_place_it_in_the_basket",
      "pick_up_the_orange_juice_and_place_it_in_the_basket"}},
    {"libero_goal",
     {"open_the_middle_drawer_of_the_cabinet", "put_the_bowl_on_the_stove",
      "put_the_wine_bottle_on_top_of_the_cabinet", "open_the_top_drawer_and_put_the_bowl_inside",
      "put_the_bowl_on_top_of_the_cabinet", "push_the_plate_to_the_front_of_the_stove",
      "put_the_cream_cheese_in_the_bowl", "turn_on_the_stove", "put_the_bowl_on_the_plate",
      "put_the_wine_bottle_on_the_rack"}},
    {"libero_10",
     {"LIVING_ROOM_SCENE2_put_both_the_alphabet_soup_and_the_tomato_sauce_in_the_basket",
      "LIVING_ROOM_SCENE2_put_both_the_cream_cheese_box_and_the_butter_in_the_basket",
      "KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it",
      "KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it",
      "LIVING_ROOM_SCENE5_put_the_white_mug_on_the_left_plate_and_put_the_yellow_and_white_mug_on_"
      "the_right_plate",
      "STUDY_SCENE1_pick_up_the_book_and_place_it_in_the_back_compartment_of_the_caddy",
      "LIVING_ROOM_SCENE6_put_the_white_mug_on_the_plate_and_put_the_chocolate_pudding_to_the_"
      "right_of_the_plate",
      "LIVING_ROOM_SCENE1_put_both_the_alphabet_soup_and_the_cream_cheese_box_in_the_basket",
      "KITCHEN_SCENE8_put_both_moka_pots_on_the_stove",
      "KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it"}},
};

}  // namespace

absl::Span<const LiberosOwnSuite> LiberosOwnSuites() { return kSuites; }

std::string LiberosOwnFolder(const std::string& libero_root, const std::string& suite) {
  if (!IsLiberosOwn(suite)) return "";
  const std::string root = LiberoRoot(libero_root, "LIBERO_ROOT");
  for (const char* inside : {"/libero/libero", "/libero", ""}) {
    const std::string folder = absl::StrCat(root, inside, "/bddl_files/", suite);
    std::error_code ignored;
    if (!root.empty() && fs::is_directory(folder, ignored)) return folder;
  }
  return "";
}

std::string LiberosOwnSha256(const std::string& folder) {
  const fs::path tasks = folder;
  const fs::path states = tasks.parent_path().parent_path() / "init_files" / tasks.filename();
  std::string hashes;
  for (const LiberosOwnSuite& own : LiberosOwnSuites()) {
    if (own.suite != tasks.filename().string()) continue;
    for (const std::string_view name : own.tasks) {
      const std::string task(name);
      const auto bddl = Sha256OfFile((tasks / (task + ".bddl")).string());
      const auto of_states = Sha256OfFile((states / (task + ".pruned_init")).string());
      absl::StrAppend(&hashes, task, " ", bddl.value_or("missing"), " ",
                      of_states.value_or("missing"), "\n");
    }
  }
  return Sha256Hex(hashes);
}

}  // namespace robostress
