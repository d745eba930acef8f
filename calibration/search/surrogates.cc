#include "calibration/search/surrogates.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <unsupported/Eigen/FFT>

#include "calibration/search/parallel.h"
#include "common/random.h"
#include "common/statistics.h"

namespace robostress::calibration {
namespace {

constexpr int kBatch = 37;  // surrogates per product of matrices

// Rows [first, first + count) of a residual vector per track.
std::vector<std::pair<int, int>> TrackRows(const JointProblem& problem, const WindowSet& chosen) {
  std::vector<std::pair<int, int>> tracks(problem.tracks().size(), {0, 0});
  int row = 0;
  for (size_t i = 0; i < problem.windows().size(); ++i) {
    if (!chosen[i]) continue;
    const Window& window = problem.windows()[i];
    auto& [first, count] = tracks[window.track];
    if (count == 0) first = row;
    count += problem.Rows(window);
    row += problem.Rows(window);
  }
  return tracks;
}

// The next length that a fast transform likes: no prime factor above 5. Eigen's kissfft does not
// end at length 1 (a track whose windows have one row).
int SmoothLength(int count) {
  for (int length = std::max(count, 2);; ++length) {
    int rest = length;
    for (const int factor : {2, 3, 5})
      while (rest % factor == 0) rest /= factor;
    if (rest == 1) return length;
  }
}

// The spectrum of a signal that goes on from its beginning up to a smooth length.
std::vector<std::complex<double>> SpectrumOf(const Eigen::VectorXd& signal) {
  std::vector<double> extended(SmoothLength(static_cast<int>(signal.size())));
  for (size_t i = 0; i < extended.size(); ++i)
    extended[i] = signal[static_cast<int>(i) % static_cast<int>(signal.size())];
  std::vector<std::complex<double>> spectrum;
  Eigen::FFT<double>().fwd(spectrum, extended);
  return spectrum;
}

// A real signal with the amplitudes of `spectrum` and random phases.
Eigen::VectorXd RandomPhases(const std::vector<std::complex<double>>& spectrum,
                             RandomStream& random) {
  const int count = static_cast<int>(spectrum.size());
  std::vector<std::complex<double>> turned = spectrum;
  for (int k = 1; k < (count + 1) / 2; ++k) {
    turned[k] = std::polar(std::abs(spectrum[k]), random.Uniform(0, 2 * M_PI));
    turned[count - k] = std::conj(turned[k]);
  }
  std::vector<double> signal;
  Eigen::FFT<double>().inv(signal, turned);
  return Eigen::Map<const Eigen::VectorXd>(signal.data(), count);
}

}  // namespace

void ForSurrogates(const JointProblem& problem, const Screening& screening, const WindowSet& chosen,
                   int surrogates, uint64_t seed,
                   const std::function<void(int first, const Eigen::MatrixXd& drawn)>& use) {
  const auto tracks = TrackRows(problem, chosen);
  std::vector<std::vector<std::complex<double>>> spectra(tracks.size());
  for (size_t i = 0; i < tracks.size(); ++i) {
    const auto [first, count] = tracks[i];
    if (count == 0) continue;
    spectra[i] = SpectrumOf(screening.residual().segment(first, count));
  }
  ParallelFor((surrogates + kBatch - 1) / kBatch, [&](int batch) {
    const int begin = batch * kBatch, count = std::min(kBatch, surrogates - begin);
    Eigen::MatrixXd drawn = Eigen::MatrixXd::Zero(screening.residual().size(), count);
    for (int s = 0; s < count; ++s) {
      RandomStream random(StreamKey("calibration surrogate")
                              .With(static_cast<int64_t>(seed))
                              .With(int64_t{begin} + s));
      for (size_t i = 0; i < tracks.size(); ++i) {
        const auto [first, rows] = tracks[i];
        if (rows > 0)
          drawn.col(s).segment(first, rows) = RandomPhases(spectra[i], random).head(rows);
      }
    }
    screening.RemoveImitated(drawn);
    use(begin, drawn);
  });
}

NullDistribution DrawNull(const JointProblem& problem, const Screening& screening,
                          const WindowSet& chosen, int surrogates, uint64_t seed) {
  NullDistribution null;
  null.largest.assign(surrogates, 0);
  null.of_candidate.assign(screening.candidates().size(), std::vector<double>(surrogates, 0));
  ForSurrogates(problem, screening, chosen, surrogates, seed,
                [&](int begin, const Eigen::MatrixXd& drawn) {
                  const Eigen::RowVectorXd whole = drawn.colwise().squaredNorm();
                  for (const Signature& signature : screening.signatures()) {
                    if (signature.basis.cols() == 0) continue;
                    const Eigen::RowVectorXd explained =
                        (signature.basis.transpose() * drawn).colwise().squaredNorm();
                    for (int s = 0; s < drawn.cols(); ++s) {
                      const double gain = whole[s] > 0 ? explained[s] / whole[s] : 0;
                      double& own = null.of_candidate[signature.candidate][begin + s];
                      own = std::max(own, gain);
                      null.largest[begin + s] = std::max(null.largest[begin + s], gain);
                    }
                  }
                });
  return null;
}

double NullDistribution::Quantile(double share) const {
  std::vector<double> sorted = largest;
  std::sort(sorted.begin(), sorted.end());
  return sorted.empty() ? 0 : robostress::Quantile(sorted, share);
}

namespace {

double PValueIn(const std::vector<double>& drawn, double gain) {
  const auto reach =
      std::count_if(drawn.begin(), drawn.end(), [&](double value) { return value >= gain; });
  return (1.0 + static_cast<double>(reach)) / (1.0 + static_cast<double>(drawn.size()));
}

}  // namespace

double NullDistribution::PValue(double gain) const { return PValueIn(largest, gain); }
double NullDistribution::PValueOf(int candidate, double gain) const {
  return PValueIn(of_candidate[candidate], gain);
}

}  // namespace robostress::calibration
