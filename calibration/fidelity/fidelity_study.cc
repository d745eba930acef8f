#include "calibration/fidelity/fidelity_study.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <utility>

#include "absl/strings/str_format.h"
#include "calibration/fidelity/dtw.h"
#include "calibration/fidelity/fidelity_intervals.h"
#include "calibration/fidelity/replay_pool.h"
#include "common/status_macros.h"
#include "common/suites.h"

namespace robostress::calibration {
namespace {

using Path = std::vector<Eigen::Vector3d>;

// Heavy Payload with other factors; {1, 1} is the arm without the payload.
Scenario HeavyPayload(double gravity, double compliance) {
  Scenario scenario = MakeScenario("heavy_payload", 5).value();
  for (SeverityFactors& w : scenario.end) w.gravity = gravity, w.compliance = compliance;
  return scenario;
}

// A layout with its demonstration and the replay that deviations are relative to.
struct Layout {
  int index = 0;
  Demonstration demonstration;
  GraspSpan span;
  Path reference;
};

absl::StatusOr<std::vector<Layout>> PrepareLayouts(ReplayPool& pool,
                                                   const std::vector<int>& indices,
                                                   const Scenario& unperturbed) {
  RS_ASSIGN_OR_RETURN(std::vector<Demonstration> demonstrations, pool.Record(indices, unperturbed));
  std::vector<ReplayPool::Job> jobs;
  for (size_t i = 0; i < indices.size(); ++i)
    jobs.push_back({indices[i], &demonstrations[i], {.scenario = unperturbed}});
  RS_ASSIGN_OR_RETURN(const std::vector<Replay> replays, pool.Run(jobs));
  std::vector<Layout> layouts;
  for (size_t i = 0; i < indices.size(); ++i) {
    const absl::StatusOr<GraspSpan> span = FindGrasp(replays[i]);
    if (!span.ok()) {
      return absl::FailedPreconditionError(
          absl::StrFormat("layout %d: the unperturbed replay loses the object: %s; leave it out "
                          "with --first-layout",
                          indices[i], span.status().message()));
    }
    layouts.push_back(
        {indices[i], std::move(demonstrations[i]), *span, AtPhases(replays[i], *span)});
  }
  return layouts;
}

double RmsDifference(const Profile& a, const Profile& b) {
  double squares = 0;
  for (int i = 0; i < kPhases; ++i) squares += (a[i] - b[i]) * (a[i] - b[i]);
  return std::sqrt(squares / kPhases);
}

// Profiles of the demonstration under pairs of factors, each simulated once.
class FactorFit {
 public:
  FactorFit(ReplayPool& pool, const Layout& layout, const Profile& target)
      : pool_(pool), layout_(layout), target_(target) {}

  // A grid over both factors, then a pattern search around its best point: the error is not smooth,
  // since a replay may slip or stick.
  absl::StatusOr<FittedFactors> Fit() {
    std::vector<Factors> grid;
    for (const double g : {1.0, 2.0, 3.0, 4.0, 6.0, 10.0, kLargestGravityFactor}) {
      for (const double c : {1.0, 2.0, 4.0, kLargestComplianceFactor}) grid.push_back({g, c});
    }
    RS_RETURN_IF_ERROR(Evaluate(grid));
    for (double step = 0.25; step > 0.012; step /= 2) {
      for (bool moved = true; moved;) {
        const Factors centre = Best();
        std::vector<Factors> around;
        for (const double g : {-step, 0.0, step}) {
          for (const double c : {-step, 0.0, step}) {
            around.push_back({std::clamp(centre.first * (1 + g), 1.0, kLargestGravityFactor),
                              std::clamp(centre.second * (1 + c), 1.0, kLargestComplianceFactor)});
          }
        }
        RS_RETURN_IF_ERROR(Evaluate(around));
        moved = Best() != centre;
      }
    }
    FittedFactors fit;
    std::tie(fit.gravity, fit.compliance) = Best();
    fit.rms = errors_.at(Best());
    fit.rms_nominal = errors_.at({1, 1});
    fit.gravity_at_bound = fit.gravity <= 1 || fit.gravity >= kLargestGravityFactor;
    fit.compliance_at_bound = fit.compliance <= 1 || fit.compliance >= kLargestComplianceFactor;
    fit.replays = static_cast<int>(errors_.size());
    return fit;
  }

 private:
  using Factors = std::pair<double, double>;  // gravity, compliance

  Factors Best() const {
    return std::min_element(errors_.begin(), errors_.end(),
                            [](const auto& a, const auto& b) { return a.second < b.second; })
        ->first;
  }

  absl::Status Evaluate(const std::vector<Factors>& all) {
    std::vector<Factors> fresh;
    for (const Factors& f : all) {
      if (!errors_.count(f) && std::find(fresh.begin(), fresh.end(), f) == fresh.end())
        fresh.push_back(f);
    }
    std::vector<ReplayPool::Job> jobs;
    for (const Factors& f : fresh) {
      jobs.push_back(
          {layout_.index, &layout_.demonstration, {.scenario = HeavyPayload(f.first, f.second)}});
    }
    RS_ASSIGN_OR_RETURN(const std::vector<Replay> replays, pool_.Run(jobs));
    for (size_t i = 0; i < fresh.size(); ++i) {
      errors_[fresh[i]] =
          RmsDifference(Deviation(AtPhases(replays[i], layout_.span), layout_.reference), target_);
    }
    return absl::OkStatus();
  }

  ReplayPool& pool_;
  const Layout& layout_;
  const Profile& target_;
  std::map<Factors, double> errors_;
};

// Deviations on every layout: of `scenario`, or with noise the mean over draws. paths, if asked
// for, receives the mean z over the carry.
absl::StatusOr<Contender> Replayed(ReplayPool& pool, const std::vector<Layout>& layouts,
                                   const std::string& name, const Scenario& scenario, double sigma,
                                   int draws, int64_t seed, double* vertical) {
  std::vector<ReplayPool::Job> jobs;
  for (const Layout& layout : layouts) {
    for (int k = 0; k < draws; ++k) {
      ReplayConditions conditions{.scenario = scenario, .command_sigma = sigma};
      conditions.noise = StreamKey("fidelity/noise").With(seed).With(layout.index).With(k);
      jobs.push_back({layout.index, &layout.demonstration, conditions});
    }
  }
  RS_ASSIGN_OR_RETURN(const std::vector<Replay> replays, pool.Run(jobs));
  Contender contender;
  contender.name = name;
  double z = 0;
  for (size_t i = 0; i < layouts.size(); ++i) {
    std::vector<Profile> profiles;
    for (int k = 0; k < draws; ++k) {
      const Replay& replay = replays[i * draws + k];
      contender.lost += !FindGrasp(replay).ok();
      const Path path = AtPhases(replay, layouts[i].span);
      profiles.push_back(Deviation(path, layouts[i].reference));
      for (int p = kPhasesBefore + 1; p < kPhases; ++p)
        z += (path[p] - layouts[i].reference[p]).z() / (kPhases - 1 - kPhasesBefore);
    }
    contender.profiles.push_back(Mean(profiles));
  }
  contender.replays = static_cast<int>(replays.size());
  contender.mean = Mean(contender.profiles);
  if (vertical != nullptr) *vertical = z / static_cast<double>(replays.size());
  return contender;
}

// The scale of Gaussian noise whose mean profile on the demonstration is nearest to the measured
// one by least squares; a deviation is proportional to the scale while the object is held.
absl::StatusOr<double> FitSigma(ReplayPool& pool, const std::vector<Layout>& demonstration,
                                const Scenario& unperturbed, const Profile& target,
                                const FidelityOptions& options) {
  constexpr int kDraws = 20;
  constexpr double kSmall = 0.01;
  RS_ASSIGN_OR_RETURN(const Contender noise, Replayed(pool, demonstration, "", unperturbed, kSmall,
                                                      kDraws, options.seed + 1, nullptr));
  double product = 0, squares = 0;
  for (int i = 0; i < kPhases; ++i) {
    product += noise.mean[i] * target[i];
    squares += noise.mean[i] * noise.mean[i];
  }
  return kSmall * product / squares;
}

absl::Status CheckOptions(const FidelityOptions& options) {
  const SuiteInfo* suite = FindSuite(options.task.suite);
  if (suite == nullptr) {
    return absl::NotFoundError(absl::StrFormat(
        "suite '%s' is unknown; robostress suites lists the known ones", options.task.suite));
  }
  const int last = options.first_layout + options.layouts - 1;
  if (options.layouts < 1 || options.first_layout < 0 || last >= suite->num_initial_states) {
    return absl::OutOfRangeError(absl::StrFormat("layouts %d to %d do not exist; %s has 0 to %d",
                                                 options.first_layout, last, options.task.suite,
                                                 suite->num_initial_states - 1));
  }
  if (options.demonstration_layout >= options.first_layout &&
      options.demonstration_layout <= last) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "layout %d is the demonstration's, which the factors are fitted to; the others (%d to %d) "
        "must be different ones",
        options.demonstration_layout, options.first_layout, last));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<FidelityResult> RunFidelity(const FidelityOptions& options) {
  RS_RETURN_IF_ERROR(CheckOptions(options));
  const auto say = [&](const std::string& text) {
    if (options.progress) options.progress(text);
  };
  FidelityResult result;
  if (options.measured_dir.empty()) {
    say("measured side: simulated replays with and without the payload");
    SimulatedArm arm;
    arm.task = options.task;
    arm.layout = options.demonstration_layout;
    arm.replays = options.replays;
    arm.payload_kg = options.payload_kg;
    arm.seed = options.seed;
    RS_ASSIGN_OR_RETURN(result.replays, SimulateMeasuredReplays(arm));
  } else {
    RS_ASSIGN_OR_RETURN(result.replays, ReadMeasuredReplays(options.measured_dir));
  }
  result.source = result.replays.source;
  RS_ASSIGN_OR_RETURN(result.measured, MeasureProfiles(result.replays));
  result.measured_mean = Mean(result.measured.loaded);

  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ReplayPool> pool,
                      ReplayPool::Create(options.task, 0, options.threads));
  result.instruction = pool->arm().instruction();
  const Scenario unperturbed =
      options.clean_reference ? MakeScenario("clean", 5).value() : HeavyPayload(1, 1);
  RS_ASSIGN_OR_RETURN(const std::vector<Layout> demonstration,
                      PrepareLayouts(*pool, {options.demonstration_layout}, unperturbed));
  say("fitting w_g and w_c to the demonstration");
  RS_ASSIGN_OR_RETURN(result.fit, FactorFit(*pool, demonstration[0], result.measured_mean).Fit());
  const Scenario model = HeavyPayload(result.fit.gravity, result.fit.compliance);
  RS_ASSIGN_OR_RETURN(const Contender fitted,
                      Replayed(*pool, demonstration, "", model, 0, 1, 0, nullptr));
  result.model_demonstration = fitted.mean;
  RS_ASSIGN_OR_RETURN(result.fitted_sigma,
                      FitSigma(*pool, demonstration, unperturbed, result.measured_mean, options));

  say(absl::StrFormat("replaying %d other layouts", options.layouts));
  std::vector<int> indices(options.layouts);
  std::iota(indices.begin(), indices.end(), options.first_layout);
  RS_ASSIGN_OR_RETURN(const std::vector<Layout> layouts,
                      PrepareLayouts(*pool, indices, unperturbed));
  RS_ASSIGN_OR_RETURN(Contender heavy, Replayed(*pool, layouts, "Heavy Payload, fitted", model, 0,
                                                1, 0, &result.model_vertical));
  result.contenders.push_back(std::move(heavy));
  for (const double sigma : {options.noise_sigma, result.fitted_sigma}) {
    RS_ASSIGN_OR_RETURN(Contender noise,
                        Replayed(*pool, layouts,
                                 absl::StrFormat("Gaussian noise, %.3g%s", sigma,
                                                 sigma == options.noise_sigma ? "" : " (fitted)"),
                                 unperturbed, sigma, options.noise_draws, options.seed, nullptr));
    result.contenders.push_back(std::move(noise));
  }
  for (int p = kPhasesBefore + 1; p < kPhases; ++p)
    result.measured_vertical += result.measured.vertical[p] / (kPhases - 1 - kPhasesBefore);
  AddIntervals(options.replicates, options.seed, result);
  return result;
}

}  // namespace robostress::calibration
