#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

namespace robostress {

inline constexpr char kNoOracle[] =
    "no oracles/pi0: set ROBOSTRESS_SHARED to the folder of shared data";

// A file of the pi0 oracle, or empty where it is absent. ctest starts tests in the source folder.
inline std::string OracleFile(const std::string& name) {
  const char* shared = std::getenv("ROBOSTRESS_SHARED");
  const auto path =
      std::filesystem::path(shared != nullptr ? shared : "../shared") / "oracles/pi0" / name;
  return std::filesystem::exists(path) ? path.string() : "";
}

}  // namespace robostress
