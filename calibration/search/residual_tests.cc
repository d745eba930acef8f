#include "calibration/search/residual_tests.h"

#include <algorithm>
#include <cmath>
#include <unsupported/Eigen/FFT>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress::calibration {
namespace {

constexpr int kLags = 20;
constexpr int kBins = 24;
constexpr int kBands = 30;           // of spectra
constexpr double kLocalised = 0.5;   // of the energy of the means, within
constexpr double kNarrow = 1.0 / 3;  // of the bins

// What a residual is held against, for the rows of a residual vector.
struct Regressor {
  std::string name, unit;
  std::vector<double> values;
};

// Of input inverse the load is the model's: the logged torque is in the residual itself.
std::vector<Regressor> Regressors(const JointProblem& problem, const JointModel& model,
                                  const WindowSet& chosen) {
  const JointTrack& any = problem.tracks().front();
  const bool inverse = model.input == JointInput::kInverse;
  std::vector<Regressor> regressors = {
      {"position", "rad", {}}, {"velocity", "rad/s", {}}, {"load", "Nm", {}}, {"time", "s", {}}};
  std::vector<int> others;
  for (int i = 0; i < static_cast<int>(any.log->joints.size()); ++i) {
    if (i == any.joint) continue;
    others.push_back(i);
    const std::string& name = any.log->joints[i].name;
    regressors.push_back({absl::StrCat("position of ", name), "rad", {}});
    regressors.push_back({absl::StrCat("velocity of ", name), "rad/s", {}});
  }
  std::vector<std::vector<double>> loads;  // less what was logged
  for (size_t i = 0; inverse && i < problem.tracks().size(); ++i)
    loads.push_back(problem.TrackResidual(model, i));
  for (size_t i = 0; i < problem.windows().size(); ++i) {
    if (!chosen[i]) continue;
    const Window& window = problem.windows()[i];
    const JointTrack& track = problem.tracks()[window.track];
    const JointRecord& record = track.record();
    for (int k = window.first; k < window.first + window.rows; k += problem.stride()) {
      regressors[0].values.push_back(record.q_smooth[k]);
      regressors[1].values.push_back(record.dq[k]);
      const double asked = inverse               ? record.tau[k] + loads[window.track][k]
                           : !record.tau.empty() ? record.tau[k]
                           : record.command.empty()
                               ? 0
                               : model.servo.kp * (record.command[k] - record.q_smooth[k]);
      regressors[2].values.push_back(asked);
      regressors[3].values.push_back(k * track.log->dt);
      for (size_t i = 0; i < others.size(); ++i) {
        const JointMotion& motion = track.log->joints[others[i]].motion;
        regressors[4 + 2 * i].values.push_back(motion.q[k]);
        regressors[5 + 2 * i].values.push_back(motion.dq[k]);
      }
    }
  }
  return regressors;
}

struct Binned {
  std::vector<double> x, mean;
  double explained = 0;
};

// Means over bins of equal count.
Binned BinMeans(const std::vector<double>& against, const Eigen::VectorXd& r) {
  std::vector<int> order(against.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return against[a] < against[b]; });
  Binned binned;
  double between = 0;
  const int n = static_cast<int>(order.size()), bins = std::min(kBins, n);
  for (int bin = 0; bin < bins; ++bin) {
    const int begin = static_cast<int>(int64_t{n} * bin / bins);
    const int end = static_cast<int>(int64_t{n} * (bin + 1) / bins);
    double x = 0, mean = 0;
    for (int i = begin; i < end; ++i) x += against[order[i]], mean += r[order[i]];
    x /= end - begin, mean /= end - begin;
    binned.x.push_back(x);
    binned.mean.push_back(mean);
    between += mean * mean * (end - begin);
  }
  binned.explained = r.squaredNorm() > 0 ? between / r.squaredNorm() : 0;
  return binned;
}

// Root mean square per band of frequency, windows one after the other.
Binned Spectrum(const Eigen::VectorXd& r, double dt) {
  std::vector<std::complex<double>> transform;
  Eigen::FFT<double>().fwd(transform, std::vector<double>(r.begin(), r.end()));
  const double n = static_cast<double>(r.size()), nyquist = 0.5 / dt;
  const double lowest = std::max(1.0 / (n * dt), nyquist / 2000);
  Binned bands;
  std::vector<double> energy(kBands, 0);
  for (size_t k = 1; k <= transform.size() / 2; ++k) {
    const double f = static_cast<double>(k) / (n * dt);
    if (f < lowest) continue;
    const int band = std::min(
        kBands - 1, static_cast<int>(std::log(f / lowest) / std::log(nyquist / lowest) * kBands));
    energy[band] += 2 * std::norm(transform[k]) / (n * n);
  }
  for (int band = 0; band < kBands; ++band) {
    if (energy[band] == 0) continue;
    bands.x.push_back(lowest * std::pow(nyquist / lowest, (band + 0.5) / kBands));
    bands.mean.push_back(std::sqrt(energy[band]));
  }
  return bands;
}

}  // namespace

WhitenessReport TestWhiteness(const JointProblem& problem, const Eigen::VectorXd& residual,
                              const WindowSet& chosen) {
  WhitenessReport report;
  const double energy = residual.squaredNorm();
  double pairs_of_one = 0;
  for (int lag = 1; lag <= kLags; ++lag) {
    double sum = 0, pairs = 0;
    int row = 0;
    for (size_t i = 0; i < problem.windows().size(); ++i) {
      if (!chosen[i]) continue;
      const int rows = problem.Rows(problem.windows()[i]);
      const auto part = residual.segment(row, rows);
      if (rows > lag) {
        sum += part.head(rows - lag).dot(part.tail(rows - lag));
        pairs += rows - lag;
      }
      row += rows;
    }
    if (pairs == 0 || energy == 0) break;
    if (lag == 1) pairs_of_one = pairs;
    const double rho = sum / pairs / (energy / static_cast<double>(residual.size()));
    if (std::abs(rho) > std::abs(report.autocorrelation)) report.autocorrelation = rho;
  }
  // The largest of kLags normals (Bonferroni, 1 %: 3.5 standard errors); 0.02 for the projection.
  report.limit = 3.5 / std::sqrt(std::max(pairs_of_one, 1.0)) + 0.02;
  report.white = std::abs(report.autocorrelation) <= report.limit;
  return report;
}

std::vector<StructureCurve> MeasureStructure(const JointProblem& problem,
                                             const JointModel& declared, const JointModel& after,
                                             const WindowSet& chosen, double scale) {
  const Eigen::VectorXd before = problem.Projected(declared, chosen) * scale;
  const Eigen::VectorXd later = problem.Projected(after, chosen) * scale;
  std::vector<StructureCurve> curves;
  // 99 % of the share that bins take of noise.
  const double n = static_cast<double>(before.size());
  const double limit = (kBins + 2.33 * std::sqrt(2.0 * kBins)) / std::max(n, 1.0);
  for (const Regressor& regressor : Regressors(problem, declared, chosen)) {
    const Binned a = BinMeans(regressor.values, before), b = BinMeans(regressor.values, later);
    curves.push_back(
        {regressor.name, regressor.unit, a.x, a.mean, b.mean, a.explained, b.explained, limit});
  }
  const double dt = problem.tracks().front().log->dt * problem.stride();
  const Binned a = Spectrum(before, dt), b = Spectrum(later, dt);
  curves.push_back({"frequency", "Hz", a.x, a.mean, b.mean, 0, 0, 0});
  return curves;
}

std::string WhereItIs(const StructureCurve& curve, bool after) {
  const std::vector<double>& mean = after ? curve.after : curve.declared;
  const int bins = static_cast<int>(mean.size());
  if (bins < 4) return "";
  const auto energy = [&](int bin) { return mean[bin] * mean[bin]; };
  double all = 0;
  int first = 0;
  for (int i = 0; i < bins; ++i) {
    all += energy(i);
    if (energy(i) > energy(first)) first = i;
  }
  int last = first;
  const double least = 0.25 * energy(first);  // half of the peak
  while (first > 0 && energy(first - 1) > least) --first;
  while (last + 1 < bins && energy(last + 1) > least) ++last;
  double held = 0;
  for (int i = first; i <= last; ++i) held += energy(i);
  if (held < kLocalised * all || last - first + 1 > kNarrow * bins) return "";
  const double low = first > 0 ? 0.5 * (curve.x[first - 1] + curve.x[first]) : curve.x[first];
  const double high = last + 1 < bins ? 0.5 * (curve.x[last] + curve.x[last + 1]) : curve.x[last];
  return absl::StrFormat(", most of it at %.2g to %.2g %s", low, high, curve.unit);
}

}  // namespace robostress::calibration
