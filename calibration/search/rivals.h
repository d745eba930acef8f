#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calibration/search/refits.h"

namespace robostress::calibration {

// Finds, for effects that were added to a model, others that do as well in their place.
class RivalSearch {
 public:
  // `candidates` of a model; at most `finalists` are refitted. All that is passed outlives this.
  RivalSearch(Refits& refits, const SignalScales& scales,
              std::function<std::vector<Candidate>(const TracedModel&)> candidates, int finalists)
      : refits_(refits),
        scales_(scales),
        candidates_(std::move(candidates)),
        finalists_(finalists) {}

  // Types that fit the data as well as `effect` of `model` does, best first; their models are added
  // to `rival_models`.
  std::vector<std::string> RivalsOf(const TracedModel& model, const std::string& effect,
                                    std::vector<TracedModel>& rival_models);

 private:
  std::vector<TracedModel> FitInPlace(const TracedModel& model, const TracedModel& base,
                                      const std::string& effect, const Screening& screening,
                                      const std::vector<Contender>& others) const;

  Refits& refits_;
  const SignalScales& scales_;
  const std::function<std::vector<Candidate>(const TracedModel&)> candidates_;
  const int finalists_;
};

}  // namespace robostress::calibration
