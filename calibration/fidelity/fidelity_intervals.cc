#include "calibration/fidelity/fidelity_intervals.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "calibration/fidelity/dtw.h"
#include "common/random.h"

namespace robostress::calibration {
namespace {

struct Draws {
  std::vector<double> dtw, dtw_total, rise, excess;
};

Estimate MakeEstimate(double value, std::vector<double> draws, bool supported) {
  std::sort(draws.begin(), draws.end());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  if (!supported || draws.empty()) return {value, {nan, nan}};
  return {value, {Quantile(draws, 0.025), Quantile(draws, 0.975)}};
}

std::vector<Profile> Drawn(const std::vector<Profile>& profiles, const std::vector<int>& indices) {
  std::vector<Profile> drawn;
  for (const int i : indices) drawn.push_back(profiles[i]);
  return drawn;
}

std::vector<int> DrawIndices(size_t n, RandomStream& random) {
  std::vector<int> indices(n);
  for (int& i : indices) i = random.UniformInt(static_cast<int>(n));
  return indices;
}

}  // namespace

void AddIntervals(int replicates, int64_t seed, FidelityResult& result) {
  const std::vector<Profile>& loaded = result.measured.loaded;
  std::vector<Contender>& contenders = result.contenders;
  const size_t layouts = contenders[0].profiles.size();
  std::vector<Draws> draws(contenders.size());
  std::vector<double> measured_rise;
  RandomStream random(StreamKey("fidelity/bootstrap").With(seed));
  for (int r = 0; r < replicates; ++r) {
    const Profile measured = Mean(Drawn(loaded, DrawIndices(loaded.size(), random)));
    const std::vector<int> indices = DrawIndices(layouts, random);
    measured_rise.push_back(Rise(measured));
    for (size_t c = 0; c < contenders.size(); ++c) {
      const Profile mean = Mean(Drawn(contenders[c].profiles, indices));
      const Dtw dtw = DtwDistance(mean, measured);
      draws[c].dtw.push_back(dtw.per_step);
      draws[c].dtw_total.push_back(dtw.total);
      draws[c].rise.push_back(Rise(mean));
      draws[c].excess.push_back(dtw.per_step - draws[0].dtw.back());
    }
  }
  const bool several = layouts > 1;
  for (size_t c = 0; c < contenders.size(); ++c) {
    Contender& contender = contenders[c];
    const Dtw dtw = DtwDistance(contender.mean, result.measured_mean);
    contender.dtw = MakeEstimate(dtw.per_step, draws[c].dtw, several);
    contender.dtw_total = MakeEstimate(dtw.total, draws[c].dtw_total, several);
    contender.rise = MakeEstimate(Rise(contender.mean), draws[c].rise, several);
    contender.dtw_excess =
        MakeEstimate(dtw.per_step - contenders[0].dtw.value, draws[c].excess, several);
  }
  result.measured_rise = MakeEstimate(Rise(result.measured_mean), measured_rise, loaded.size() > 1);
  result.replay_dtw = 0;
  for (size_t k = 0; k < loaded.size() && loaded.size() > 1; ++k) {
    std::vector<Profile> others = loaded;
    others.erase(others.begin() + static_cast<long>(k));
    result.replay_dtw +=
        DtwDistance(loaded[k], Mean(others)).per_step / static_cast<double>(loaded.size());
  }
}

}  // namespace robostress::calibration
