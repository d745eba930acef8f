#include "calibration/trace.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/acceptance.h"
#include "calibration/pair_screening.h"
#include "calibration/parallel.h"

namespace robostress::calibration {
namespace {

constexpr double kResolution = 0.05;   // of the declared error: the kernel resolves no less
constexpr double kAtFloor = 1.1;       // times the floor: little is left
constexpr double kDetourGain = 0.85;   // error of a way that does not lead over the best model
constexpr double kNotTestable = 0.02;  // surviving share
constexpr double kSimilarErrors = 2;   // standard errors of the difference over folds
constexpr double kRivalMargin = 0.05;  // a rival's error may be larger by this share
constexpr double kAlikeMargin = 0.25;  // of one whose signature looks alike
constexpr double kAlike = 0.95;        // |cos| between signatures
constexpr double kRivalGain = 0.5;     // of the effect's own linear gain
constexpr int64_t kMaxWindows = 120;   // that a search simulates
constexpr int kCrossValidated = 4;     // refitted candidates of a round, the lowest errors
constexpr double kFarOff = 5;          // times the lowest error after the first iterations
constexpr double kOutclassed = 3;      // times the lowest error of a round
constexpr int kStartsPerCandidate = 2;

// Effects by name, with a partner where there is one.
std::string NameOf(const Candidate& candidate) { return candidate.effect->type; }

std::string KeyOf(std::vector<std::string> added) {
  std::sort(added.begin(), added.end());
  return absl::StrJoin(added, "+");
}

// A candidate on top of a base, after screening.
struct Contender {
  int candidate = 0;
  std::vector<const Signature*> starts;  // best first
  double gain = 0, p = 1, own_p = 1, surviving = 0;
};

class Search {
 public:
  Search(const JointProblem& problem, const SignalScales& scales,
         const std::vector<int>& other_joints, Folds folds, const TraceOptions& options)
      : problem_(problem),
        scales_(scales),
        other_joints_(other_joints),
        options_(options),
        fit_windows_(Thinned(problem.OfRole(LogRole::kFit))),
        folds_(MakeFolds(problem, folds)) {
    for (WindowSet& fold : folds_)
      for (size_t i = 0; i < fold.size(); ++i) fold[i] &= fit_windows_[i];
  }

  Trace Run(const Hypothesis& declared) {
    Trace trace;
    options_.progress("fitting the declared model");
    trace.declared.fit = Minimise(problem_, declared, fit_windows_);
    trace.declared.cv = CrossValidate(problem_, trace.declared.fit, folds_);
    floor_ = problem_.ProjectedFloor(fit_windows_);
    acceptance_.emplace(problem_, fit_windows_, floor_);
    std::vector<TracedModel> beam = {trace.declared};
    TracedModel best = trace.declared;
    while (!beam.empty() && static_cast<int>(beam.front().added.size()) < options_.max_effects) {
      // Nothing but noise is left.
      if (LittleLeft(trace.declared, best)) break;
      std::vector<TracedModel> next;
      double wanted = 1 - Acceptance::kMinCvGain;  // of the leader's error
      for (const TracedModel& base : beam) {
        trace.rounds.push_back(Round(base, next));
        if (base.added.empty()) NoteNotTestable(trace);
        if (&base == &beam.front() && next.empty() && MayTakePair(base))
          PairRound(base, trace.rounds.back(), next);
        if (&base != &beam.front() || !next.empty()) continue;
        // A leader that nothing improves on is the answer, unless much is left and another way
        // leads much further.
        wanted = kDetourGain;
      }
      KeepBest(next, best);
      if (next.empty() || next.front().cv.Rms() > wanted * best.cv.Rms()) break;
      best = next.front();
      beam = std::move(next);
    }
    trace.after = ByWeight(Trim(Simplest(beam, best), trace.declared));
    for (const std::string& effect : trace.after.added)
      trace.rivals.push_back(Rivals(trace.after, effect));
    const WindowSet all = problem_.OfRole(LogRole::kFit);
    trace.declared.fit = Minimise(problem_, trace.declared.fit.best, all);
    trace.after.fit = trace.after.added.empty() ? trace.declared.fit
                                                : Minimise(problem_, trace.after.fit.best, all);
    return trace;
  }

 private:
  // At most kMaxWindows of `windows`, evenly.
  static WindowSet Thinned(WindowSet windows) {
    const auto count = std::count(windows.begin(), windows.end(), 1);
    int64_t seen = 0;
    for (char& window : windows) {
      if (!window) continue;
      window =
          count <= kMaxWindows || seen * kMaxWindows / count != (seen + 1) * kMaxWindows / count;
      ++seen;
    }
    return windows;
  }

  // Noise, or what the kernel's own integration leaves.
  bool LittleLeft(const TracedModel& declared, const TracedModel& model) const {
    return !model.added.empty() &&
           (model.cv.Rms() < kAtFloor * floor_ ||
            acceptance_->Excess(model) < kResolution * kResolution * acceptance_->Excess(declared));
  }

  // Screens everything on top of `base`, refits the finalists, and adds what is accepted to `next`.
  RoundReport Round(const TracedModel& base, std::vector<TracedModel>& next) {
    RoundReport report;
    report.base = base.added;
    report.cv_error = base.cv.Rms();
    const Screening screening(problem_, base.fit, scales_, Candidates(base), fit_windows_);
    const NullDistribution null =
        DrawNull(problem_, screening, fit_windows_, options_.surrogates, options_.seed);
    report.null_95 = null.Quantile(0.95);
    report.null_99 = null.Quantile(0.99);
    std::vector<Contender> contenders = Rank(screening, null);
    // Nothing that could lower the error by as little as acceptance asks for.
    const bool within_noise = acceptance_->Excess(base) <= 0;
    const bool hopeless = contenders.empty() || report.cv_error <= 1e-12 || within_noise;
    const int refits = hopeless ? 0 : ChooseFinalists(contenders, screening);
    options_.progress(absl::StrFormat(
        "%s: error %.3g, %.2f times the floor; %d candidates screened, %d refitted",
        base.added.empty() ? "declared model" : "with " + KeyOf(base.added), report.cv_error,
        report.cv_error / std::max(floor_, 1e-300), contenders.size(), refits));
    std::vector<TracedModel> models(refits);
    ParallelFor(refits, [&](int i) { models[i] = OnTrial(base, screening, contenders[i]); });
    SettleBest(models, base.fit.rms);
    CrossValidateBest(models);
    for (size_t i = 0; i < contenders.size(); ++i) {
      CandidateReport line;
      line.type = NameOf(screening.candidates()[contenders[i].candidate]);
      line.surviving = contenders[i].surviving;
      line.linear_gain = contenders[i].gain;
      line.p_value = contenders[i].p;
      if (static_cast<int>(i) < refits) {
        TracedModel& model = models[i];
        line.refitted = true;
        line.cv_gain = 1 - (model.cv.energy.empty() ? model.fit.rms / base.fit.rms
                                                    : model.cv.Rms() / base.cv.Rms());
        line.reason = acceptance_->Objection(base, model, contenders[i].p);
        line.accepted = line.reason.empty();
        model.p_values.push_back(contenders[i].p);
        model.cv_gains.push_back(line.cv_gain);
        if (line.accepted) next.push_back(model);
        if (!model.cv.energy.empty()) known_[KeyOf(model.added)] = std::move(model);
      } else {
        line.reason =
            contenders[i].surviving < kNotTestable
                ? "the declared parameters imitate it on this data"
            : within_noise ? "the error is within the noise, nothing is left to explain"
            : contenders[i].p <= Acceptance::kMaxPValue
                ? "others explain more of the residual"
                : absl::StrFormat("explains %.1f %% of the residual, chance up to %.1f %%",
                                  100 * contenders[i].gain, 100 * report.null_99);
      }
      report.candidates.push_back(std::move(line));
    }
    std::stable_sort(report.candidates.begin(), report.candidates.end(),
                     [](const CandidateReport& a, const CandidateReport& b) {
                       return std::make_tuple(a.accepted, a.cv_gain, a.linear_gain) >
                              std::make_tuple(b.accepted, b.cv_gain, b.linear_gain);
                     });
    return report;
  }

  // A pair is tried where no single effect is accepted and more than noise is left.
  bool MayTakePair(const TracedModel& base) const {
    return static_cast<int>(base.added.size()) + 2 <= options_.max_effects &&
           base.cv.Rms() > kAtFloor * floor_ && acceptance_->Excess(base) > 0;
  }

  // Two effects may hide each other: neither explains much alone.
  void PairRound(const TracedModel& base, RoundReport& report, std::vector<TracedModel>& next) {
    const Screening screening(problem_, base.fit, scales_, Candidates(base), fit_windows_);
    const std::vector<PairContender> pairs =
        ScreenPairs(problem_, screening, scales_, fit_windows_, options_.surrogates, options_.seed);
    std::vector<TracedModel> models(pairs.size(), base);
    ParallelFor(static_cast<int>(pairs.size()), [&](int i) {
      for (const int candidate : pairs[i].candidates)
        models[i].added.push_back(NameOf(screening.candidates()[candidate]));
      models[i].fit = Minimise(problem_, pairs[i].start, fit_windows_);
      models[i].cv = {};
    });
    CrossValidateBest(models);
    options_.progress(absl::StrFormat("no single effect; %d pairs refitted", pairs.size()));
    for (size_t i = 0; i < pairs.size(); ++i) {
      TracedModel& model = models[i];
      CandidateReport line;
      line.type = absl::StrCat(model.added[base.added.size()], "+", model.added.back());
      line.surviving = 1;
      line.linear_gain = pairs[i].gain;
      line.p_value = pairs[i].p;
      line.refitted = true;
      line.cv_gain = 1 - (model.cv.energy.empty() ? model.fit.rms / base.fit.rms
                                                  : model.cv.Rms() / base.cv.Rms());
      line.reason = acceptance_->Objection(base, model, pairs[i].p);
      line.accepted = line.reason.empty();
      model.p_values.resize(model.added.size(), pairs[i].p);
      model.cv_gains.resize(model.added.size(), line.cv_gain);
      if (line.accepted) next.push_back(model);
      report.candidates.push_back(std::move(line));
    }
  }

  std::vector<Candidate> Candidates(const TracedModel& base) const {
    const bool has_torque =
        std::all_of(problem_.tracks().begin(), problem_.tracks().end(),
                    [](const JointTrack& track) { return !track.record().tau.empty(); });
    std::vector<Candidate> candidates =
        CandidatesFor(base.fit.best.model, other_joints_, has_torque);
    std::erase_if(candidates, [&](const Candidate& candidate) {
      return std::find(options_.exclude.begin(), options_.exclude.end(), NameOf(candidate)) !=
             options_.exclude.end();
    });
    return candidates;
  }

  static std::vector<Contender> Rank(const Screening& screening, const NullDistribution& null) {
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

  // Finalists, moved to the front: what beats its own chance, of what could matter beside the best;
  // and dry friction that beats the library's, because a small friction, of which a signature is
  // made, lets a joint creep that a large one holds.
  int ChooseFinalists(std::vector<Contender>& contenders, const Screening& screening) const {
    int count = 0;
    const double best = contenders.front().gain;
    for (const Contender& contender : contenders) {
      if (count == options_.finalists || contender.gain < Acceptance::kMinCvGain ||
          contender.gain < (best > 0.95 ? 0.8 : 0.25) * best ||
          contender.own_p > 5 * Acceptance::kMaxPValue)
        break;
      ++count;
    }
    const auto sticks = [&](const Contender& contender) {
      static const std::set<std::string> types = {"stribeck_friction", "presliding_hysteresis",
                                                  "load_dependent_friction"};
      return contender.p <= Acceptance::kMaxPValue &&
             types.count(NameOf(screening.candidates()[contender.candidate])) > 0;
    };
    const auto rest = std::stable_partition(contenders.begin() + count, contenders.end(), sticks);
    return static_cast<int>(rest - contenders.begin());
  }

  // `base` with a candidate, after the first iterations of its fit.
  TracedModel OnTrial(const TracedModel& base, const Screening& screening,
                      const Contender& contender) const {
    std::vector<Hypothesis> starts;
    for (size_t i = 0; i < contender.starts.size() && i < kStartsPerCandidate; ++i) {
      starts.push_back(screening.LinearStart(*contender.starts[i]));
      if (i == 0) starts.push_back(contender.starts[i]->start);
    }
    TracedModel model = base;
    model.added.push_back(NameOf(screening.candidates()[contender.candidate]));
    model.fit = Try(problem_, starts, fit_windows_);
    model.cv = {};
    return model;
  }

  // Goes on with the fits that may come near the lowest of them, or near `error`; a start that was
  // far off is no more worth than that.
  void SettleBest(std::vector<TracedModel>& models, double error) const {
    for (const TracedModel& model : models) error = std::min(error, model.fit.rms);
    ParallelFor(static_cast<int>(models.size()), [&](int i) {
      TracedModel& model = models[i];
      if (model.fit.rms > kFarOff * error || !model.cv.energy.empty()) return;
      model.fit = Settle(problem_, model.fit, fit_windows_);
      if (model.added.back() == "stribeck_friction")
        model.fit = MinimiseFriction(problem_, model.fit.best, fit_windows_);
    });
  }

  void CrossValidateBest(std::vector<TracedModel>& models) const {
    std::vector<TracedModel*> order;
    for (TracedModel& model : models) order.push_back(&model);
    std::stable_sort(order.begin(), order.end(), [](const TracedModel* a, const TracedModel* b) {
      return a->fit.rms < b->fit.rms;
    });
    if (order.size() > kCrossValidated) order.resize(kCrossValidated);
    std::erase_if(order, [&](const TracedModel* model) {
      return model->fit.rms > kOutclassed * order.front()->fit.rms;
    });
    for (TracedModel* model : order) model->cv = CrossValidate(problem_, model->fit, folds_);
  }

  void NoteNotTestable(Trace& trace) const {
    for (const CandidateReport& line : trace.rounds.back().candidates)
      if (line.surviving < kNotTestable) trace.not_testable.emplace_back(line.type, line.surviving);
  }

  // Of `models` the best `beam` that are worth going on with; one that contains `best` must be an
  // improvement on it.
  void KeepBest(std::vector<TracedModel>& models, const TracedModel& best) const {
    std::stable_sort(models.begin(), models.end(), [](const TracedModel& a, const TracedModel& b) {
      return a.cv.Rms() < b.cv.Rms();
    });
    std::set<std::string> seen;
    const double outclassed = models.empty() ? 0 : kOutclassed * models.front().cv.Rms();
    std::erase_if(models, [&](const TracedModel& model) {
      return !seen.insert(KeyOf(model.added)).second || model.cv.Rms() > outclassed ||
             (Contains(model, best) && !acceptance_->ExplainsMore(best, model));
    });
    if (static_cast<int>(models.size()) > options_.beam) models.resize(options_.beam);
  }

  // Of the models that were accepted beside `best`, the one with the fewest parameters that does no
  // worse as far as the folds can tell: a polynomial follows everything a little.
  static TracedModel Simplest(const std::vector<TracedModel>& accepted, TracedModel best) {
    const CrossValidation least = best.cv;
    for (const TracedModel& model : accepted)
      if (model.fit.best.free.size() < best.fit.best.free.size() && DoesAsWell(least, model.cv))
        best = model;
    return best;
  }

  // `cv` is larger than `least` by chance, and by little.
  static bool DoesAsWell(const CrossValidation& least, const CrossValidation& cv) {
    const PairedDifference difference = Compare(least, cv);
    return difference.mean < kSimilarErrors * difference.standard_error &&
           cv.Rms() < (1 + kRivalMargin) * least.Rms();
  }

  static bool Contains(const TracedModel& model, const TracedModel& part) {
    return std::all_of(part.added.begin(), part.added.end(), [&](const std::string& effect) {
      return std::find(model.added.begin(), model.added.end(), effect) != model.added.end();
    });
  }

  // Drops effects that the later ones made needless.
  TracedModel Trim(TracedModel model, const TracedModel& declared) {
    for (size_t i = 0; model.added.size() > 1 && i < model.added.size();) {
      TracedModel without = Without(model, i);
      if (without.cv.Rms() < (1 + Acceptance::kMinCvGain) * model.cv.Rms()) {
        model = std::move(without);
        i = 0;
      } else {
        ++i;
      }
    }
    return model.added.empty() ? declared : model;
  }

  // With the effect first whose absence costs most: a beam may have come by another way.
  TracedModel ByWeight(TracedModel model) {
    std::vector<std::pair<double, size_t>> order;
    for (size_t i = 0; model.added.size() > 1 && i < model.added.size(); ++i)
      order.emplace_back(-Without(model, i).cv.Rms(), i);
    std::sort(order.begin(), order.end());
    const TracedModel before = model;
    for (size_t to = 0; to < order.size(); ++to) {
      const size_t from = order[to].second;
      model.added[to] = before.added[from];
      model.p_values[to] = before.p_values[from];
      model.cv_gains[to] = before.cv_gains[from];
    }
    return model;
  }

  TracedModel Without(const TracedModel& model, size_t index) {
    TracedModel result = model;
    result.added.erase(result.added.begin() + static_cast<int>(index));
    result.p_values.erase(result.p_values.begin() + static_cast<int>(index));
    result.cv_gains.erase(result.cv_gains.begin() + static_cast<int>(index));
    result.fit =
        Minimise(problem_, WithoutEffect(model.fit.best, model.added[index]), fit_windows_);
    // The search came by here on another way, perhaps to a lesser minimum.
    const auto known = known_.find(KeyOf(result.added));
    if (known != known_.end() && known->second.fit.rms <= result.fit.rms) return known->second;
    result.cv = CrossValidate(problem_, result.fit, folds_);
    if (known != known_.end()) {
      result.added = known->second.added;
      result.p_values = known->second.p_values;
      result.cv_gains = known->second.cv_gains;
    }
    return known_[KeyOf(result.added)] = result;
  }

  // Effects that do as well in the place of `effect`.
  std::vector<std::string> Rivals(const TracedModel& model, const std::string& effect) {
    const size_t index =
        std::find(model.added.begin(), model.added.end(), effect) - model.added.begin();
    TracedModel base = Without(model, index);
    if (base.added.empty()) base.fit.best = WithoutEffect(base.fit.best, effect);
    const Screening screening(problem_, base.fit, scales_, Candidates(base), fit_windows_);
    // The effect's share in the fitted prediction, as a direction.
    Eigen::MatrixXd share =
        problem_.Projected(ModelAt(model.fit.best, model.fit.best.x), fit_windows_) -
        problem_.Projected(ModelAt(base.fit.best, base.fit.best.x), fit_windows_);
    screening.RemoveImitated(share);
    std::vector<Contender> others;
    const NullDistribution nothing{{},
                                   std::vector<std::vector<double>>(screening.candidates().size())};
    for (Contender& contender : Rank(screening, nothing))
      if (NameOf(screening.candidates()[contender.candidate]) != effect &&
          contender.gain > kRivalGain * GainOf(screening, effect))
        others.push_back(std::move(contender));
    if (static_cast<int>(others.size()) > options_.finalists) others.resize(options_.finalists);
    std::vector<TracedModel> models(others.size());
    std::vector<char> fresh(others.size(), 0);
    for (size_t i = 0; i < others.size(); ++i) {
      std::vector<std::string> added = base.added;
      added.push_back(NameOf(screening.candidates()[others[i].candidate]));
      const auto known = known_.find(KeyOf(added));
      if (known != known_.end()) {
        models[i] = known->second;
      } else {
        fresh[i] = 1;
      }
    }
    options_.progress(absl::StrCat("rivals of ", effect));
    ParallelFor(static_cast<int>(others.size()), [&](int i) {
      if (fresh[i]) models[i] = OnTrial(base, screening, others[i]);
    });
    SettleBest(models, model.fit.rms);
    for (size_t i = 0; i < others.size(); ++i) {
      // What fits far worse is no rival, whatever cross-validation says.
      if (models[i].cv.energy.empty() && models[i].fit.rms < 2 * model.fit.rms)
        models[i].cv = CrossValidate(problem_, models[i].fit, folds_);
    }
    std::vector<std::string> rivals;
    for (size_t i = 0; i < others.size(); ++i) {
      const Signature& signature = *others[i].starts.front();
      const double cosine =
          (signature.basis.transpose() * share).norm() / std::max(share.norm(), 1e-300);
      if (!models[i].cv.energy.empty() && IsRival(model, models[i], cosine))
        rivals.push_back(NameOf(screening.candidates()[others[i].candidate]));
    }
    return rivals;
  }

  static double GainOf(const Screening& screening, const std::string& effect) {
    double gain = 0;
    for (const Signature& signature : screening.signatures())
      if (NameOf(screening.candidates()[signature.candidate]) == effect)
        gain = std::max(gain, screening.Gain(signature));
    return gain;
  }

  bool IsRival(const TracedModel& best, const TracedModel& other, double cosine) const {
    const PairedDifference difference = Compare(best.cv, other.cv);
    const double ratio = other.cv.Rms() / std::max(best.cv.Rms(), 1e-300);
    const bool simpler = best.fit.best.free.size() < other.fit.best.free.size();
    // One that needs more parameters to do no better is not needed.
    if (simpler && ratio >= 1) return false;
    if (difference.mean < kSimilarErrors * difference.standard_error) return true;
    return ratio < 1 + (cosine > kAlike ? kAlikeMargin : kRivalMargin);
  }

  const JointProblem& problem_;
  const SignalScales& scales_;
  const std::vector<int>& other_joints_;
  const TraceOptions& options_;
  const WindowSet fit_windows_;
  std::vector<WindowSet> folds_;
  double floor_ = 0;
  std::optional<Acceptance> acceptance_;
  std::map<std::string, TracedModel> known_;  // by KeyOf
};

}  // namespace

Trace TraceJoint(const JointProblem& problem, const Hypothesis& declared,
                 const SignalScales& scales, const std::vector<int>& other_joints, Folds folds,
                 const TraceOptions& options) {
  return Search(problem, scales, other_joints, folds, options).Run(declared);
}

}  // namespace robostress::calibration
