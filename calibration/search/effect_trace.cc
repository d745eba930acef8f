#include "calibration/search/effect_trace.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/search/acceptance.h"
#include "calibration/search/pair_screening.h"
#include "calibration/search/parallel.h"
#include "calibration/search/refits.h"
#include "calibration/search/rivals.h"

namespace robostress::calibration {
namespace {

constexpr double kResolution = 0.01;   // of the declared error: the kernel resolves no less
constexpr double kAtFloor = 1.1;       // times the floor: little is left
constexpr double kDetourGain = 0.85;   // error of a way that does not lead over the best model
constexpr double kNotTestable = 0.02;  // surviving share
constexpr double kSimilarErrors = 2;   // standard errors of the difference over folds
constexpr double kAsWell = 0.05;       // a simpler model's error may be larger by this share
constexpr double kOutclassed = 3;      // times the lowest error of a round
constexpr double kOfLost = 0.05;       // share of the best gain, where linear ones mean little
constexpr size_t kAlternatives = 3;
constexpr int kRestarts = 2;  // from a better declared model

// Effects by name, with a partner where there is one.
std::string NameOf(const Candidate& candidate) { return candidate.effect->type; }

std::vector<std::string> Sorted(std::vector<std::string> names) {
  std::sort(names.begin(), names.end());
  return names;
}

class Search {
 public:
  Search(const JointProblem& problem, const Hypothesis& start, const SignalScales& scales,
         const std::vector<int>& other_joints, Folds folds, const TraceOptions& options)
      : problem_(problem),
        scales_(scales),
        other_joints_(other_joints),
        options_(options),
        refits_(problem, start, folds),
        fit_windows_(refits_.windows()),
        floor_(problem.ProjectedFloor(fit_windows_)),
        acceptance_(problem, fit_windows_, floor_) {}

  Trace Run(const Hypothesis& declared) {
    options_.progress("fitting the declared model");
    Trace trace = From(refits_.Declared(declared));
    for (int i = 0; i < kRestarts && GetsUnstuck(trace); ++i) {
      options_.progress("the declared model fits better from where the search ended: again");
      trace = From(trace.declared);
    }
    Finish(trace);
    return trace;
  }

 private:
  // Searches on top of a declared model that was fitted.
  Trace From(const TracedModel& declared) {
    Trace trace;
    trace.declared = declared;
    std::vector<TracedModel> beam = {trace.declared};
    TracedModel best = trace.declared;
    while (!beam.empty() && static_cast<int>(beam.front().added.size()) < options_.max_effects) {
      // Nothing but noise is left.
      if (LittleLeft(trace.declared, best)) break;
      std::vector<TracedModel> next, doubtful;
      bool detour = false;
      for (const TracedModel& base : beam) {
        trace.rounds.push_back(Round(base, next, doubtful));
        if (base.added.empty()) NoteNotTestable(trace);
        if (&base == &beam.front() && next.empty() && MayTakePair(base))
          PairRound(base, trace.rounds.back(), next, doubtful);
        if (&base != &beam.front() || !next.empty()) continue;
        // A leader that nothing improves on is the answer, unless much is left and another way
        // leads much further.
        detour = true;
      }
      // What can not be the machine is better than nothing to predict with; the verdict claims none
      // of it.
      if (next.empty()) next = std::move(doubtful);
      KeepBest(next, best);
      const bool from_answer = detour && !best.added.empty();
      if (from_answer && !options_.detours) break;
      const double wanted = detour ? kDetourGain : 1 - Acceptance::kMinCvGain;
      if (next.empty() || next.front().cv.Rms() > wanted * best.cv.Rms()) break;
      if (from_answer && !trace.before_detour) trace.before_detour = best;
      best = next.front();
      beam = std::move(next);
    }
    trace.after = Confirmed(ByWeight(Trim(Simplest(beam, best), trace.declared)), trace.declared);
    return trace;
  }

  // The fit of the declared model may have got stuck, so that an effect that is not there helped it
  // on. Gives `trace` the better one.
  bool GetsUnstuck(Trace& trace) {
    std::vector<TracedModel> helped;
    if (!trace.after.added.empty()) helped.push_back(trace.after);
    if (const TracedModel* const lowest = refits_.LowestWithOneEffect()) helped.push_back(*lowest);
    const double declared = trace.declared.cv.Rms();
    for (const TracedModel& model : helped) {
      const TracedModel bare = Bare(model);
      if (bare.cv.Rms() < (1 - Acceptance::kMinCvGain) * trace.declared.cv.Rms())
        trace.declared = bare;
    }
    return trace.declared.cv.Rms() < declared;
  }

  TracedModel Bare(TracedModel model) {
    while (!model.added.empty()) model = refits_.Without(model, model.added.size() - 1);
    return model;
  }

  // Rivals, and fits to all windows.
  void Finish(Trace& trace) {
    RivalSearch rivals(
        refits_, scales_, [this](const TracedModel& base) { return Candidates(base); },
        options_.finalists);
    for (const std::string& effect : trace.after.added) {
      options_.progress(absl::StrCat("rivals of ", effect));
      trace.rivals.push_back(rivals.RivalsOf(trace.after, effect, trace.alternatives));
    }
    if (trace.alternatives.empty())
      trace.alternatives = refits_.Nearest(trace.after.added, kAlternatives);
    trace.declared.fit = OnAllWindows(trace.declared);
    trace.after.fit = trace.after.added.empty() ? trace.declared.fit : OnAllWindows(trace.after);
  }

  // Noise, or what the kernel's own integration leaves.
  bool LittleLeft(const TracedModel& declared, const TracedModel& model) const {
    return !model.added.empty() &&
           (model.cv.Rms() < kAtFloor * floor_ ||
            acceptance_.Excess(model) < kResolution * kResolution * acceptance_.Excess(declared));
  }

  // Screens everything on top of `base`, refits the finalists, and adds what is accepted to `next`.
  RoundReport Round(const TracedModel& base, std::vector<TracedModel>& next,
                    std::vector<TracedModel>& doubtful) {
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
    const bool within_noise = acceptance_.Excess(base) <= 0;
    const bool hopeless = contenders.empty() || report.cv_error <= 1e-12 || within_noise;
    const int refits =
        hopeless ? 0 : ChooseFinalists(contenders, screening.candidates(), options_.finalists);
    options_.progress(absl::StrFormat(
        "%s: error %.3g, %.2f times the floor; %d candidates screened, %d refitted",
        base.added.empty() ? "declared model" : "with " + absl::StrJoin(base.added, "+"),
        report.cv_error, report.cv_error / std::max(floor_, 1e-300), contenders.size(), refits));
    std::vector<TracedModel> models(refits);
    std::vector<double> promised(refits);
    ParallelFor(refits, [&](int i) {
      models[i] = refits_.OnTrial(base, screening, contenders[i]);
      promised[i] = contenders[i].Promised(base.fit.rms);
    });
    refits_.SettleBest(models, promised, base.fit.rms);
    const bool lost = base.added.empty() && refits_.IsLost(base.fit);
    if (base.added.empty() && (lost || AllLeaveMuch(base, models)))
      FromOwnValues(base, contenders, models);
    refits_.Restart(models, lost);
    refits_.CrossValidateBest(models);
    for (size_t i = 0; i < contenders.size(); ++i) {
      CandidateReport line;
      line.type = NameOf(screening.candidates()[contenders[i].candidate]);
      line.surviving = contenders[i].surviving;
      line.linear_gain = contenders[i].gain;
      line.p_value = contenders[i].p;
      if (i < models.size()) {
        TracedModel& model = models[i];
        line.refitted = true;
        line.cv_gain = 1 - (model.cv.energy.empty() ? model.fit.rms / base.fit.rms
                                                    : model.cv.Rms() / base.cv.Rms());
        model.p_values.push_back(contenders[i].p);
        model.cv_gains.push_back(line.cv_gain);
        Decide(base, model, contenders[i].p, line, next, doubtful);
        if (!model.cv.energy.empty()) refits_.Keep(std::move(model));
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

  // Says in `line` whether `model` is accepted, and puts it where it belongs.
  void Decide(const TracedModel& base, const TracedModel& model, double p, CandidateReport& line,
              std::vector<TracedModel>& next, std::vector<TracedModel>& doubtful) const {
    line.reason = acceptance_.Objection(base, model, p);
    if (!line.reason.empty()) return;
    line.reason = acceptance_.Doubt(model);
    line.accepted = line.reason.empty();
    (line.accepted ? next : doubtful).push_back(model);
  }

  // No candidate explains the residual from where the declared model was fitted.
  bool AllLeaveMuch(const TracedModel& base, const std::vector<TracedModel>& models) const {
    return refits_.LeavesMuch(base.fit) &&
           std::all_of(models.begin(), models.end(),
                       [&](const TracedModel& model) { return refits_.LeavesMuch(model.fit); });
  }

  // Screens and fits again from the rig's own values: a declared model that was bent to stand in
  // for an effect shows its signature where the machine never was. Of a candidate that was refitted
  // the better fit stays; others come in behind, and `contenders` is put in the order of `models`.
  void FromOwnValues(const TracedModel& base, std::vector<Contender>& contenders,
                     std::vector<TracedModel>& models) {
    options_.progress("much is left from here: again from the rig's own values");
    TracedModel own = base;
    own.fit = refits_.OwnValues();
    const Screening screening(problem_, own.fit, scales_, Candidates(own), fit_windows_);
    const NullDistribution null =
        DrawNull(problem_, screening, fit_windows_, options_.surrogates, options_.seed);
    std::vector<Contender> others = Rank(screening, null);
    if (others.empty()) return;
    const int count = ChooseFinalists(others, screening.candidates(), options_.finalists, kOfLost);
    std::vector<TracedModel> found(count);
    std::vector<double> promised(count);
    ParallelFor(count, [&](int i) {
      found[i] = refits_.OnTrial(own, screening, others[i]);
      promised[i] = others[i].Promised(own.fit.rms);
    });
    refits_.SettleBest(found, promised, own.fit.rms);
    for (int i = 0; i < count; ++i) {
      const auto same = std::find_if(contenders.begin(), contenders.end(), [&](const auto& c) {
        return c.candidate == others[i].candidate;
      });
      if (same == contenders.end()) continue;
      same->p = std::min(same->p, others[i].p);
      const size_t at = same - contenders.begin();
      if (at < models.size()) {
        if (found[i].fit.rms < models[at].fit.rms) models[at] = std::move(found[i]);
        continue;
      }
      std::swap(*same, contenders[models.size()]);
      models.push_back(std::move(found[i]));
    }
  }

  // A pair is tried where no single effect is accepted and more than noise is left.
  bool MayTakePair(const TracedModel& base) const {
    return static_cast<int>(base.added.size()) + 2 <= options_.max_effects &&
           base.cv.Rms() > kAtFloor * floor_ && acceptance_.Excess(base) > 0;
  }

  // Two effects may hide each other: neither explains much alone.
  void PairRound(const TracedModel& base, RoundReport& report, std::vector<TracedModel>& next,
                 std::vector<TracedModel>& doubtful) {
    const Screening screening(problem_, base.fit, scales_, Candidates(base), fit_windows_);
    const std::vector<PairContender> pairs =
        ScreenPairs(problem_, screening, scales_, fit_windows_, options_.surrogates, options_.seed);
    std::vector<TracedModel> models(pairs.size(), base);
    ParallelFor(static_cast<int>(pairs.size()), [&](int i) {
      for (const int candidate : pairs[i].candidates)
        models[i].added.push_back(NameOf(screening.candidates()[candidate]));
      models[i].fit =
          Widen(problem_, Minimise(problem_, pairs[i].start, fit_windows_), fit_windows_);
      models[i].cv = {};
    });
    refits_.CrossValidateBest(models);
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
      model.p_values.resize(model.added.size(), pairs[i].p);
      model.cv_gains.resize(model.added.size(), line.cv_gain);
      Decide(base, model, pairs[i].p, line, next, doubtful);
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
    std::set<std::vector<std::string>> seen;
    const double outclassed = models.empty() ? 0 : kOutclassed * models.front().cv.Rms();
    std::erase_if(models, [&](const TracedModel& model) {
      return !seen.insert(Sorted(model.added)).second || model.cv.Rms() > outclassed ||
             (Contains(model, best) && !acceptance_.ExplainsMore(best, model));
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
           cv.Rms() < (1 + kAsWell) * least.Rms();
  }

  static bool Contains(const TracedModel& model, const TracedModel& part) {
    return std::all_of(part.added.begin(), part.added.end(), [&](const std::string& effect) {
      return std::find(model.added.begin(), model.added.end(), effect) != model.added.end();
    });
  }

  // Drops effects that the later ones made needless.
  TracedModel Trim(TracedModel model, const TracedModel& declared) {
    for (size_t i = 0; model.added.size() > 1 && i < model.added.size();) {
      TracedModel without = refits_.Without(model, i);
      if (without.cv.Rms() < (1 + Acceptance::kMinCvGain) * model.cv.Rms()) {
        model = std::move(without);
        i = 0;
      } else {
        ++i;
      }
    }
    return model.added.empty() ? declared : model;
  }

  JointFit OnAllWindows(const TracedModel& model) const {
    return Minimise(problem_, model.fit.best, problem_.OfRole(LogRole::kFit));
  }

  // Where two effects can give the same torque, as a spring and a polynomial, neither's size is
  // known: an amplitude of several that the fit does without is held at zero.
  void DropNeedlessSizes(TracedModel& model) const {
    const size_t free = model.fit.best.free.size();
    for (size_t i = 0; model.added.size() > 1 && i < model.added.size(); ++i)
      model.fit = DropNeedless(problem_, std::move(model.fit), model.added[i], fit_windows_);
    if (model.fit.best.free.size() < free) refits_.CrossValidate(model);
  }

  // Drops effects whose size a fit to all windows, to its end, does not bear out.
  TracedModel Confirmed(TracedModel model, const TracedModel& declared) {
    while (!model.added.empty()) {
      DropNeedlessSizes(model);
      TracedModel whole = model;
      whole.fit = OnAllWindows(model);
      const auto effect =
          std::find_if(model.added.begin(), model.added.end(), [&](const std::string& added) {
            return !acceptance_.SizeObjection(whole, added).empty();
          });
      if (effect == model.added.end()) return model;
      model = refits_.Without(model, effect - model.added.begin());
    }
    return declared;
  }

  // With the effect first whose absence costs most: a beam may have come by another way.
  TracedModel ByWeight(TracedModel model) {
    std::vector<std::pair<double, size_t>> order;
    for (size_t i = 0; model.added.size() > 1 && i < model.added.size(); ++i)
      order.emplace_back(-refits_.Without(model, i).cv.Rms(), i);
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

  const JointProblem& problem_;
  const SignalScales& scales_;
  const std::vector<int>& other_joints_;
  const TraceOptions& options_;
  Refits refits_;
  const WindowSet& fit_windows_;
  const double floor_;
  const Acceptance acceptance_;
};

}  // namespace

Trace TraceJoint(const JointProblem& problem, const Hypothesis& start, const Hypothesis& declared,
                 const SignalScales& scales, const std::vector<int>& other_joints, Folds folds,
                 const TraceOptions& options) {
  return Search(problem, start, scales, other_joints, folds, options).Run(declared);
}

}  // namespace robostress::calibration
