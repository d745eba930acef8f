#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/config.h"
#include "common/method_options.h"

namespace robostress {
namespace {

// "`key: value`, ..." of what differs from the defaults, in the order of the options.
std::string Over(const MethodOptions& options) {
  const YAML::Node given = YAML::Load(DumpConfig(options));
  const YAML::Node defaults = YAML::Load(DumpConfig(MethodOptions()));
  std::vector<std::string> changes;
  for (const auto& entry : given) {
    const std::string key = entry.first.Scalar();
    const YAML::Node usual = defaults[key];  // not defined: written only where it is another
    if (key != "method" && (!usual.IsDefined() || entry.second.Scalar() != usual.Scalar()))
      changes.push_back(absl::StrCat("`", key, ": ", entry.second.Scalar(), "`"));
  }
  return absl::StrJoin(changes, ", ");
}

TEST(MethodPresets, AreWhatTheAdaptersReadmeSays) {
  std::vector<std::string> rows;
  for (const std::string& name : MethodNames()) {
    const std::string over = Over(*MakeMethod(name));
    rows.push_back(absl::StrCat("| `", name, "` | ", over, over.empty() ? "|" : " |"));
  }
  std::ifstream file("adapter/README.md");
  ASSERT_TRUE(file) << "run from the source tree";
  std::vector<std::string> written;
  bool inside = false;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("## ")) inside = line == "## What a preset sets";
    if (inside && line.starts_with("| `")) written.push_back(line);
  }
  EXPECT_THAT(written, testing::ElementsAreArray(rows));
}

TEST(MethodPresets, DefaultsAreThePapers) {
  const MethodOptions o;
  EXPECT_EQ(o.rank, 4);
  EXPECT_EQ(o.lora_init_std, 0.01);
  EXPECT_EQ(o.beta1, 0.9);
  EXPECT_EQ(o.beta2, 0.999);
  EXPECT_EQ(o.adam_epsilon, 1e-8);
  EXPECT_EQ(o.clip_norm, 1);
  EXPECT_EQ(o.anchor_weight, 1e-4);
  EXPECT_EQ(o.buffer_chunks, 32);
  EXPECT_EQ(o.update_interval, 8);
  EXPECT_EQ(o.batch, 4);
  EXPECT_EQ(o.tracking_gain, 0.267);
  EXPECT_TRUE(o.use_residual && o.clip_command && o.track_intent);
  EXPECT_FALSE(o.adapt || o.direct);
  EXPECT_EQ(o.gain, 1);
  EXPECT_EQ(o.lora, LoraKind::kPerHead);
}

}  // namespace
}  // namespace robostress
