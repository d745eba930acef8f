#include "calibration/search/contenders.h"

#include <algorithm>
#include <set>

#include "calibration/search/acceptance.h"

namespace robostress::calibration {

std::vector<Contender> Rank(const Screening& screening, const NullDistribution& null) {
  std::vector<Contender> contenders(screening.candidates().size());
  for (size_t i = 0; i < contenders.size(); ++i) contenders[i].candidate = static_cast<int>(i);
  for (const Signature& signature : screening.signatures()) {
    Contender& own = contenders[signature.candidate];
    own.starts.push_back(&signature);
    own.surviving = std::max(own.surviving, signature.surviving);
  }
  for (Contender& contender : contenders) {
    std::stable_sort(contender.starts.begin(), contender.starts.end(),
                     [&](const Signature* a, const Signature* b) {
                       return screening.Gain(*a) > screening.Gain(*b);
                     });
    if (contender.starts.empty()) continue;
    contender.gain = screening.Gain(*contender.starts.front());
    contender.p = null.PValue(contender.gain);
    contender.own_p = null.PValueOf(contender.candidate, contender.gain);
  }
  std::stable_sort(contenders.begin(), contenders.end(),
                   [](const Contender& a, const Contender& b) { return a.gain > b.gain; });
  return contenders;
}

int ChooseFinalists(std::vector<Contender>& contenders, const std::vector<Candidate>& candidates,
                    int at_most, double share) {
  int count = 0;
  const double best = contenders.front().gain;
  for (const Contender& contender : contenders) {
    if (count == at_most || contender.gain < Acceptance::kMinCvGain ||
        contender.gain < (best > 0.95 ? 0.8 : share) * best ||
        contender.own_p > 5 * Acceptance::kMaxPValue)
      break;
    ++count;
  }
  const auto sticks = [&](const Contender& contender) {
    static const std::set<std::string> types = {"stribeck_friction", "presliding_hysteresis",
                                                "load_dependent_friction"};
    return contender.p <= Acceptance::kMaxPValue &&
           types.count(candidates[contender.candidate].effect->type) > 0;
  };
  const auto rest = std::stable_partition(contenders.begin() + count, contenders.end(), sticks);
  return static_cast<int>(rest - contenders.begin());
}

}  // namespace robostress::calibration
