// What is exported against eval/docs/result.schema.json, by a validator from PyPI.
#include <functional>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/common/wire/openpi_venv.h"
#include "tests/eval/shared_run.h"

namespace robostress {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

class ResultSchema : public ::testing::Test {
 protected:
  void SetUp() override {
    venv_ = OpenpiVenv::Make(JSONSCHEMA_VENV, JSONSCHEMA_REQUIREMENTS, "jsonschema");
    if (!venv_.failure.empty()) GTEST_SKIP() << venv_.failure;
  }
  // Exit code and output of the validator.
  std::pair<int, std::string> Validate(const std::string& text) {
    const std::string file = TestFolder() + "/result.json";
    EXPECT_TRUE(WriteFileAtomically(file, text).ok());
    const auto [output, code] = RunProgram(
        venv_.python, absl::StrCat(ROBOSTRESS_SOURCE_DIR,
                                   "/tests/eval/report/"
                                   "result_schema_check.py ",
                                   ROBOSTRESS_SOURCE_DIR, "/eval/docs/result.schema.json ", file));
    return {code, output};
  }

  OpenpiVenv venv_;
};

TEST_F(ResultSchema, TakesWhatIsExported) {
  RunData own;
  for (const char* method : {"base", "gain", "null", "ours"})
    own.units.push_back(SyntheticUnit("heavy_payload", method, {1, 0, 1, 1}));
  own.units.push_back(SyntheticUnit("clean", "base", {1, 0, 1, 1}, {}, "tabletop_long"));
  RunData alone;
  alone.units.push_back(SyntheticUnit("clean", "base", {1}));
  for (const RunData& run : {RemoteRun(), own, alone}) {
    const auto [code, output] = Validate(WriteResultFile(Exported(run)));
    EXPECT_EQ(code, 0) << output;
  }
}

TEST_F(ResultSchema, RefusesWhatTheReaderRefuses) {
  const json whole = json::parse(WriteResultFile(Exported(RemoteRun())));
  const std::vector<std::pair<std::string, json>> wrong = {
      {"/results/0/n", -1},          {"/results/0/rate", 1.5},
      {"/results/0/successes", 0.5}, {"/schema_version", 2},
      {"/results/0/severity", 6},    {"/results/0/host", "gpu"},
      {"/policies/0/label", ""},     {"/notes/0", "a\u202eb"},
      {"/notes/0", "a\u009bb"},      {"/results/3/versus_base/p", 2},
      {"/methods/0/role", "best"},   {"/results", json::array()}};
  for (const auto& [place, value] : wrong) {
    json changed = whole;
    changed[json::json_pointer(place)] = value;
    EXPECT_FALSE(ParseResultFile("theirs", changed.dump()).ok()) << place;
    EXPECT_EQ(Validate(changed.dump()).first, 1) << place;
  }
}

}  // namespace
}  // namespace robostress
