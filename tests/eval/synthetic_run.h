#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "eval/store/run_store.h"
#include "gtest/gtest.h"

namespace robostress {

// A fresh empty folder for the running test.
inline std::string TestFolder() {
  const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
  const std::string folder =
      ::testing::TempDir() + "robostress_" + test->test_suite_name() + "_" + test->name();
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  return folder;
}

// A finished unit in memory: one task, outcomes in episode order; updates[i] belong to episode i
// (missing: 0).
inline UnitResult SyntheticUnit(const std::string& scenario, const std::string& method,
                                const std::vector<int>& outcomes,
                                const std::vector<int>& updates = {},
                                const std::string& suite = "tabletop_goal") {
  UnitResult unit;
  unit.config.suite = suite;
  unit.config.scenario = scenario;
  unit.config.method = *MakeMethod(method);
  unit.config.tasks = {0};
  unit.config.episodes = static_cast<int>(outcomes.size());
  unit.id = suite + "-" + scenario + "-L5-nano-" + method + "-s0";
  for (size_t i = 0; i < outcomes.size(); ++i) {
    EpisodeRow row;
    row.episode = row.initial_state = static_cast<int>(i);
    row.success = outcomes[i] != 0;
    row.updates = i < updates.size() ? updates[i] : 0;
    row.steps = 100, row.chunks = 20;
    const nlohmann::json fields = {{"suite", suite},
                                   {"scenario", scenario},
                                   {"method", method},
                                   {"episode", i},
                                   {"success", row.success}};
    row.record = fields.dump();
    unit.episodes.push_back(row);
  }
  return unit;
}

}  // namespace robostress
