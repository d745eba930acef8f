#include "calibration/search/contenders.h"

#include <gtest/gtest.h>

#include "common/joint_errors/effects/effect_library.h"

namespace robostress::calibration {
namespace {

// Candidates by their names, with the gains of their signatures, best first.
struct Drawn {
  explicit Drawn(const std::vector<std::pair<std::string, double>>& gains) {
    for (const auto& [type, gain] : gains) {
      Contender contender;
      contender.candidate = static_cast<int>(candidates.size());
      contender.gain = gain;
      contender.p = contender.own_p = 0.005;
      contenders.push_back(contender);
      candidates.push_back({*FindEffect(type)});
    }
  }
  std::vector<std::string> Finalists(int at_most, double share) {
    std::vector<std::string> names;
    const int count = ChooseFinalists(contenders, candidates, at_most, share);
    for (int i = 0; i < count; ++i)
      names.push_back(candidates[static_cast<size_t>(contenders[i].candidate)].effect->type);
    return names;
  }
  std::vector<Contender> contenders;
  std::vector<Candidate> candidates;
};

using Names = std::vector<std::string>;

TEST(ChooseFinalists, ThoseThatReachAShareOfTheBestAreRefitted) {
  const std::vector<std::pair<std::string, double>> gains = {
      {"backlash", 0.8}, {"compliance", 0.3}, {"transport_delay", 0.1}, {"payload", 0.001}};
  EXPECT_EQ(Drawn(gains).Finalists(9, 0.25), Names({"backlash", "compliance"}));
  // Where linear signatures mean little, a small share will do.
  EXPECT_EQ(Drawn(gains).Finalists(9, 0.05), Names({"backlash", "compliance", "transport_delay"}));
  EXPECT_EQ(Drawn(gains).Finalists(1, 0.05), Names({"backlash"}));
}

TEST(ChooseFinalists, OneThatExplainsAlmostAllLeavesRoomForItsEqualsOnly) {
  EXPECT_EQ(Drawn({{"backlash", 0.99}, {"compliance", 0.85}, {"payload", 0.7}}).Finalists(9, 0.05),
            Names({"backlash", "compliance"}));
}

TEST(ChooseFinalists, WhatItsOwnChanceReachesAsWellIsNotRefitted) {
  Drawn drawn({{"backlash", 0.8}, {"compliance", 0.7}});
  drawn.contenders[1].own_p = 0.06;
  EXPECT_EQ(drawn.Finalists(9, 0.25), Names({"backlash"}));
}

// A small friction, of which a signature is made, lets a joint creep that a large one holds.
TEST(ChooseFinalists, FrictionThatBeatsTheLibrarysChanceComesAlong) {
  Drawn drawn({{"backlash", 0.8},
               {"payload", 0.15},
               {"stribeck_friction", 0.1},
               {"presliding_hysteresis", 0.05}});
  drawn.contenders[3].p = 0.02;
  EXPECT_EQ(drawn.Finalists(9, 0.25), Names({"backlash", "stribeck_friction"}));
}

}  // namespace
}  // namespace robostress::calibration
