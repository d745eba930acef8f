#include "tests/common/libero/shared_data.h"

#include <cstdlib>
#include <filesystem>

namespace robostress::libero {

std::string SharedFolder() {
  const char* given = std::getenv("ROBOSTRESS_SHARED");
  const std::filesystem::path folder =
      given != nullptr ? given : "../shared";  // ctest starts tests in the source folder
  return std::filesystem::exists(folder / "data/libero_tree")
             ? std::filesystem::absolute(folder).string()
             : "";
}

std::string LiberoTree() { return SharedFolder() + "/data/libero_tree"; }
std::string RobosuiteTree() { return SharedFolder() + "/data/robosuite_tree"; }

}  // namespace robostress::libero
