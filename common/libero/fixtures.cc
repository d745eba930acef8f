#include "common/libero/fixtures.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace robostress {

namespace {

// False: `text` is none of the words.
bool ReadWord(const std::string& text, LiberoFixtures& fixtures) {
  if (text == "centred") return true;
  if (text == "sampled") {
    fixtures.source = LiberoFixtures::Source::kSampled;
    return true;
  }
  absl::string_view seed = text;
  fixtures.each_seeded = absl::ConsumePrefix(&seed, "numpy-each:");
  if (text != "numpy" && !((fixtures.each_seeded || absl::ConsumePrefix(&seed, "numpy:")) &&
                           absl::SimpleAtoi(seed, &fixtures.seed)))
    return false;
  fixtures.source = LiberoFixtures::Source::kNumpy;
  return true;
}

}  // namespace

bool NamesFixtureTable(const std::string& text) {
  LiberoFixtures ignored;
  return !text.empty() && !ReadWord(text, ignored);
}

absl::StatusOr<LiberoFixtures> ParseLiberoFixtures(const std::string& text) {
  LiberoFixtures fixtures;
  if (ReadWord(text, fixtures)) return fixtures;
  fixtures = {};
  std::error_code ignored;
  if (access(text.c_str(), R_OK) != 0 || std::filesystem::is_directory(text, ignored)) {
    return absl::InvalidArgumentError(
        absl::StrCat("libero_fixtures '", text,
                     "' is neither centred, sampled, numpy, numpy:SEED nor numpy-each:SEED (0 to "
                     "4294967295), nor a readable file with a table of poses"));
  }
  std::ifstream file(text);
  if (!nlohmann::json::parse(file, nullptr, /*allow_exceptions=*/false).is_object()) {
    return absl::InvalidArgumentError(
        absl::StrCat("libero_fixtures ", text,
                     ": no JSON object; a table is {\"TASK\": {\"INITIAL_STATE\": {\"FIXTURE\": "
                     "{\"pos\": [x, y, "
                     "z], \"quat\": [w, x, y, z]}}}}"));
  }
  fixtures.source = LiberoFixtures::Source::kTable;
  fixtures.table = text;
  return fixtures;
}

}  // namespace robostress
