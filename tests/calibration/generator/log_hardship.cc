#include "tests/calibration/generator/log_hardship.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress::generator {
namespace {

constexpr double kLost = 0.006;  // chance of a row to be the first of one to three that are lost
constexpr double kRateShare = 0.8;
constexpr double kPhase = 0.37;  // [rows] of the first time that is read, after the first row

std::vector<std::vector<double>*> ChannelsOf(JointChannels& joint) {
  return {&joint.command, &joint.q, &joint.motor, &joint.torque, &joint.clean};
}

Recording WithoutLostRows(Recording log, RandomStream& random) {
  std::vector<char> lost(log.t.size(), 0);
  for (size_t i = 1; i + 3 < lost.size(); ++i) {
    if (lost[i - 1] || random.Uniform() >= kLost) continue;
    const int count = 1 + random.UniformInt(3);
    std::fill_n(lost.begin() + static_cast<std::ptrdiff_t>(i), count, 1);
  }
  const auto drop = [&](std::vector<double>& values) {
    if (values.empty()) return;
    size_t to = 0;
    for (size_t i = 0; i < lost.size(); ++i)
      if (!lost[i]) values[to++] = values[i];
    values.resize(to);
  };
  for (JointChannels& joint : log.joints)
    for (std::vector<double>* channel : ChannelsOf(joint)) drop(*channel);
  drop(log.t);
  return log;
}

Recording ReadElsewhen(const Recording& log) {
  Recording result = log;
  const size_t rows = static_cast<size_t>((static_cast<double>(log.t.size()) - 2) * kRateShare);
  const auto read = [&](const std::vector<double>& values) {
    std::vector<double> drawn;
    for (size_t k = 0; k < rows && !values.empty(); ++k) {
      const double at = kPhase + static_cast<double>(k) / kRateShare;
      const auto row = static_cast<size_t>(at);
      const double share = at - static_cast<double>(row);
      drawn.push_back((1 - share) * values[row] + share * values[row + 1]);
    }
    return drawn;
  };
  for (size_t i = 0; i < log.joints.size(); ++i) {
    JointChannels from = log.joints[i];
    const auto sources = ChannelsOf(from), targets = ChannelsOf(result.joints[i]);
    for (size_t c = 0; c < sources.size(); ++c) *targets[c] = read(*sources[c]);
  }
  result.t = read(log.t);
  return result;
}

}  // namespace

const std::vector<std::string>& HardshipNames() {
  static const auto& names = *new std::vector<std::string>{
      "none",      "slow",    "drops",        "jitter", "ramped",   "resampled",
      "long_wave", "coulomb", "frictionless", "harsh",  "no_torque"};
  return names;
}

absl::StatusOr<Hardship> ParseHardship(const std::string& name) {
  const auto& names = HardshipNames();
  const auto found = std::find(names.begin(), names.end(), name);
  if (found != names.end()) return static_cast<Hardship>(found - names.begin());
  return absl::NotFoundError(
      absl::StrCat("hardship '", name, "' is unknown; known: ", absl::StrJoin(names, ", ")));
}

Recording Spoil(const Recording& recording, Hardship hardship, RandomStream random) {
  if (hardship == Hardship::kDrops) return WithoutLostRows(recording, random);
  if (hardship == Hardship::kResampled) return ReadElsewhen(recording);
  return recording;
}

double LoggedRate(Hardship hardship, double rate_hz) {
  return hardship == Hardship::kResampled ? kRateShare * rate_hz : rate_hz;
}

}  // namespace robostress::generator
