#include "calibration/search/joint_problem.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "common/check.h"

namespace robostress::calibration {
namespace {

constexpr int kMaxResiduals = 8000;  // of a problem; more rows are thinned out
constexpr int kEnoughRuns = 8;       // of a log
constexpr int kReversalRows = 8;     // silent each side of a reversal
constexpr double kStep = 1e-4;       // of forward differences, in units of the scale
// The measured state of a start is believed to this many standard deviations: beside noise it has
// the bias of smoothing.
constexpr double kStartTrust = 8;
// On generated two-link arms with nothing hidden, joints were left with up to 2.5 times the noise.
constexpr double kArmFloor = 2.5;

// Of input inverse: where a motion turns, its smoothed velocity says neither when dry friction
// turns nor whether the joint rests. Those rows say nothing.
void SilenceReversals(const JointRecord& record, std::vector<double>& residual) {
  const double slow = 4 * record.start_noise_dq;
  const int rows = static_cast<int>(residual.size());
  std::vector<char> silent(rows, 0);
  for (int i = 0; i < rows; ++i) {
    const bool turns = i > 0 && record.dq[i] * record.dq[i - 1] <= 0;
    if (!turns && std::abs(record.dq[i]) > slow) continue;
    for (int k = std::max(0, i - kReversalRows); k < std::min(rows, i + kReversalRows + 1); ++k)
      silent[k] = 1;
  }
  for (int i = 0; i < rows; ++i)
    if (silent[i]) residual[i] = 0;
}

// Rows that a recorder lost say nothing. A free run that meets a guess ends there, and one that
// starts near a guess does not begin; whole runs go on. Nor does the first of many free runs: what
// happened before the log is hidden, as where a gap stood or how a bristle was bent.
std::vector<char> SilentRows(const MeasuredLog& log, int window) {
  const int rows = log.rows;
  const bool many = window > 0 && rows >= kEnoughRuns * window;
  if (log.absent.empty() && !many) return {};
  std::vector<char> silent(rows, 0);
  if (many) std::fill_n(silent.begin(), window, 1);
  if (log.absent.empty()) return silent;
  for (int i = 0; i < rows; ++i) silent[i] |= log.absent[i] != 0;
  for (int first = 0; window > 0 && first < rows; first += window) {
    const auto guessed = [&](int from, int to) {
      const auto begin = log.absent.begin();
      return std::find(begin + std::max(0, from), begin + std::min(rows, to),
                       MeasuredLog::kGuessed) -
             begin;
    };
    const int end = std::min(rows, first + window), near = MeasuredLog::kSmoothing;
    int lost = static_cast<int>(guessed(first, end));
    if (guessed(first - near, first + near) < std::min(rows, first + near)) lost = first;
    for (int i = lost; i < end; ++i) silent[i] = 1;
  }
  return silent;
}

bool Motion(JointInput input) {
  return input == JointInput::kPositionTarget || input == JointInput::kTorque;
}

}  // namespace

JointProblem::JointProblem(std::string joint, std::vector<JointTrack> tracks, int window)
    : joint_(std::move(joint)), tracks_(std::move(tracks)), window_(window) {
  int total = 0;
  for (size_t track = 0; track < tracks_.size(); ++track) {
    const MeasuredLog& log = *tracks_[track].log;
    if (!tracks_[track].single) floor_scale_ = kArmFloor;
    first_window_.push_back(windows_.size());
    const int step = window > 0 ? window : log.rows;
    for (int first = 0; first < log.rows; first += step)
      windows_.push_back({track, first, std::min(step, log.rows - first)});
    total += log.rows;
    silent_.push_back(SilentRows(log, window));
  }
  first_window_.push_back(windows_.size());
  stride_ = std::max(1, (total + kMaxResiduals - 1) / kMaxResiduals);
}

WindowSet JointProblem::OfRole(LogRole role) const {
  WindowSet chosen(windows_.size(), 0);
  for (size_t i = 0; i < chosen.size(); ++i)
    chosen[i] = tracks_[windows_[i].track].log->role == role;
  return chosen;
}

int JointProblem::Rows(const WindowSet& chosen) const {
  int rows = 0;
  for (size_t i = 0; i < windows_.size(); ++i) rows += chosen[i] ? Rows(windows_[i]) : 0;
  return rows;
}

void JointProblem::Predict(const JointModel& model, size_t index, const std::vector<char>& chosen,
                           JointSimulation::StartOffset offset,
                           std::vector<double>& residual) const {
  const JointTrack& track = tracks_[index];
  const absl::StatusOr<JointModel> own = WithOverrides(model, joint_, track.log->overrides);
  RS_CHECK(own.ok());
  residual.assign(track.log->rows, 0);
  JointSimulation(track).Predict(*own, window_, chosen, offset, absl::MakeSpan(residual));
  const std::vector<double>& measured = track.measured(model.input);
  for (size_t i = 0; i < residual.size(); ++i) residual[i] -= measured[i];
  if (model.input == JointInput::kInverse) SilenceReversals(track.record(), residual);
  const std::vector<char>& silent = silent_[index];
  const auto heard = [&](size_t row) { return silent.empty() || !silent[row]; };
  double mean = 0, count = 0;
  for (size_t i = 0; i < residual.size(); ++i)
    if (heard(i)) mean += residual[i], count += 1;
  // Two encoders have two zeros.
  mean = model.input == JointInput::kTransmission ? mean / std::max(count, 1.0) : 0;
  for (size_t i = 0; i < residual.size(); ++i) residual[i] = heard(i) ? residual[i] - mean : 0;
}

std::vector<double> JointProblem::TrackResidual(const JointModel& model, size_t track) const {
  std::vector<double> residual;
  Predict(model, track, {}, {}, residual);
  return residual;
}

Eigen::VectorXd JointProblem::Gather(const JointModel& model, const WindowSet& chosen,
                                     JointSimulation::StartOffset offset) const {
  Eigen::VectorXd result(Rows(chosen));
  int row = 0;
  std::vector<double> residual;
  for (size_t track = 0; track < tracks_.size(); ++track) {
    const std::vector<char> own(chosen.begin() + first_window_[track],
                                chosen.begin() + first_window_[track + 1]);
    if (std::find(own.begin(), own.end(), 1) == own.end()) continue;
    Predict(model, track, own, offset, residual);
    for (size_t i = 0; i < own.size(); ++i) {
      if (!own[i]) continue;
      const Window& window = windows_[first_window_[track] + i];
      for (int k = 0; k < window.rows; k += stride_) result[row++] = residual[window.first + k];
    }
  }
  return result;
}

Eigen::VectorXd JointProblem::Residuals(const JointModel& model, const WindowSet& chosen) const {
  return Gather(model, chosen, {});
}

double JointProblem::Rms(const JointModel& model, const WindowSet& chosen) const {
  const Eigen::VectorXd r = Residuals(model, chosen);
  return r.size() == 0 ? 0 : std::sqrt(r.squaredNorm() / static_cast<double>(r.size()));
}

void JointProblem::LinearizeStarts(const JointModel& model) {
  if (!Motion(model.input)) return;
  const WindowSet all = All();
  const Eigen::VectorXd r = Residuals(model, all);
  double noise = 0, dt = 1;
  for (const JointTrack& track : tracks_) {
    noise = std::max(noise, track.record().noise);
    dt = track.log->dt;
  }
  const double dq = std::max(noise, 1e-9), dv = dq / dt * 0.1;
  starts_.resize(r.size(), 2);
  starts_.col(0) = (Gather(model, all, {dq, 0}) - r) / dq;
  starts_.col(1) = (Gather(model, all, {0, dv}) - r) / dv;
}

namespace {

// r - S (S'S + ridge)^-1 S' r of one window.
Eigen::Matrix2d StartGain(const Eigen::MatrixX2d& S, const JointRecord& record) {
  const double noise = record.noise;
  const double value = kStartTrust * record.start_noise_q;
  const double slope = kStartTrust * record.start_noise_dq;
  Eigen::Matrix2d A = S.transpose() * S;
  const double tiny = 1e-12 * (A.trace() + 1e-300);
  A(0, 0) += (noise > 0 ? std::pow(noise / value, 2) : 0) + tiny;
  A(1, 1) += (noise > 0 ? std::pow(noise / slope, 2) : 0) + tiny;
  return A.inverse();
}

}  // namespace

void JointProblem::Project(const WindowSet& chosen, Eigen::Ref<Eigen::MatrixXd> m) const {
  if (starts_.rows() == 0) return;
  int from = 0, to = 0;
  for (size_t i = 0; i < windows_.size(); ++i) {
    const int rows = Rows(windows_[i]);
    if (chosen[i]) {
      const Eigen::MatrixX2d S = starts_.middleRows(from, rows);
      const Eigen::Matrix2d gain = StartGain(S, Record(windows_[i]));
      auto block = m.middleRows(to, rows);
      block -= S * (gain * (S.transpose() * block));
      to += rows;
    }
    from += rows;
  }
}

Eigen::VectorXd JointProblem::Projected(const JointModel& model, const WindowSet& chosen) const {
  Eigen::VectorXd r = Residuals(model, chosen);
  Project(chosen, r);
  return r;
}

double JointProblem::ProjectedFloor(const WindowSet& chosen) const {
  double sum = 0;
  int count = 0, from = 0;
  for (size_t i = 0; i < windows_.size(); ++i) {
    const int rows = Rows(windows_[i]);
    if (chosen[i]) {
      double trace = rows;  // of P'P
      if (starts_.rows() > 0) {
        const Eigen::MatrixX2d S = starts_.middleRows(from, rows);
        const Eigen::Matrix2d SS = S.transpose() * S;
        const Eigen::Matrix2d gain = StartGain(S, Record(windows_[i]));
        trace += (gain * SS * gain * SS).trace() - 2 * (gain * SS).trace();
      }
      sum += trace * Heard(windows_[i]) * NoiseVariance(windows_[i]);
      count += rows;
    }
    from += rows;
  }
  return count == 0 ? 0 : floor_scale_ * std::sqrt(sum / count);
}

double JointProblem::Heard(const Window& window) const {
  const std::vector<char>& silent = silent_[window.track];
  if (silent.empty()) return 1;
  const auto begin = silent.begin() + window.first;
  return 1 - static_cast<double>(std::count(begin, begin + window.rows, 1)) / window.rows;
}

double JointProblem::Floor(const WindowSet& chosen) const {
  double sum = 0;
  int count = 0, from = 0;
  for (size_t i = 0; i < windows_.size(); ++i) {
    const int rows = Rows(windows_[i]);
    if (chosen[i]) {
      const JointRecord& record = Record(windows_[i]);
      sum += rows * Heard(windows_[i]) * NoiseVariance(windows_[i]);
      if (starts_.rows() > 0) {
        const Eigen::MatrixX2d S = starts_.middleRows(from, rows);
        sum += Heard(windows_[i]) * S.col(0).squaredNorm() * std::pow(record.start_noise_q, 2) +
               S.col(1).squaredNorm() * std::pow(record.start_noise_dq, 2);
      }
      count += rows;
    }
    from += rows;
  }
  return count == 0 ? 0 : floor_scale_ * std::sqrt(sum / count);
}

Eigen::MatrixXd JointProblem::Jacobian(const Hypothesis& h, const Eigen::VectorXd& x,
                                       const Eigen::VectorXd& at_x, const WindowSet& chosen) const {
  Eigen::MatrixXd J(at_x.size(), x.size());
  for (int i = 0; i < x.size(); ++i) {
    Eigen::VectorXd moved = x;
    // Into the bounds.
    const double step = kStep * std::max(1.0, std::abs(x[i]));
    moved[i] += x[i] + step > h.free[i].upper ? -step : step;
    J.col(i) = (Projected(ModelAt(h, moved), chosen) - at_x) / (moved[i] - x[i]);
  }
  return J;
}

}  // namespace robostress::calibration
