#include "calibration/search/signatures.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <mutex>
#include <set>

#include "calibration/search/parallel.h"

namespace robostress::calibration {
namespace {

constexpr double kRank = 1e-7;  // of QR decompositions
constexpr double kIdle = 0.03;  // of the effect's largest column

// Orthonormal basis of the columns' span [rows, rank]; nothing where one is not finite, because
// a prediction diverged.
Eigen::MatrixXd BasisOf(const Eigen::MatrixXd& columns) {
  if (columns.cols() == 0 || !columns.allFinite()) return columns.leftCols(0);
  Eigen::MatrixXd scaled = columns;
  for (int i = 0; i < scaled.cols(); ++i) {
    const double norm = scaled.col(i).norm();
    if (norm > 0) scaled.col(i) /= norm;
  }
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(scaled);
  qr.setThreshold(kRank);
  return qr.householderQ() * Eigen::MatrixXd::Identity(columns.rows(), qr.rank());
}

// Indices in x of the effect's amplitudes; its free parameters stand last.
std::vector<int> AmplitudesIn(const Hypothesis& h, const EffectInfo& effect) {
  std::vector<int> indices;
  for (const int amplitude : effect.amplitudes) {
    const std::string path = effect.type + "." + effect.parameters[amplitude].name;
    for (size_t i = 0; i < h.free.size(); ++i) {
      if (h.free[i].path == path) indices.push_back(static_cast<int>(i));
    }
  }
  return indices;
}

// Fixes amplitudes at 0 that move next to nothing, as a tilt about an axis that gravity does not
// know; a fit would run to a bound with them. `columns` [rows, amplitudes].
void DropIdle(const EffectInfo& effect, Signature& signature, Eigen::MatrixXd& columns) {
  const Eigen::VectorXd norms = columns.colwise().norm();
  if (!norms.allFinite()) return;
  std::vector<int> kept;
  for (int k = 0; k < norms.size(); ++k)
    if (norms[k] >= kIdle * norms.maxCoeff()) kept.push_back(k);
  for (int k = static_cast<int>(norms.size()) - 1; k >= 0; --k)
    if (std::find(kept.begin(), kept.end(), k) == kept.end())
      signature.start = FixedAtZero(signature.start, signature.columns[k]);
  columns = columns(Eigen::all, kept).eval();
  signature.columns = AmplitudesIn(signature.start, effect);
}

}  // namespace

std::vector<Candidate> CandidatesFor(const JointModel& model, const std::vector<int>& other_joints,
                                     bool has_torque) {
  std::vector<Candidate> candidates;
  for (const EffectInfo& effect : EffectLibrary()) {
    const bool there =
        std::any_of(model.effects.begin(), model.effects.end(),
                    [&](const EffectInstance& e) { return e.info->type == effect.type; });
    if (there) continue;
    const EffectStage stage = effect.stage;
    bool seen = true;
    if (model.input == JointInput::kTransmission)
      seen = stage == EffectStage::kTransmission || stage == EffectStage::kSensor ||
             (stage == EffectStage::kCommand && effect.type != "rate_limit");
    if (model.input == JointInput::kTransmission && effect.type == "compliance") seen = has_torque;
    if (model.input == JointInput::kInverse)
      seen = stage == EffectStage::kJoint || stage == EffectStage::kDrive ||
             stage == EffectStage::kSensor;
    if (!seen) continue;
    if (effect.type == "encoder_eccentricity" && !model.hinge) continue;
    if (effect.coupled) {
      const int known = PartnerOf(model);
      for (const int joint : other_joints)
        if (known < 0 || joint == known) candidates.push_back({&effect, joint});
    } else {
      candidates.push_back({&effect, -1});
    }
  }
  return candidates;
}

Screening::Screening(const JointProblem& problem, const JointFit& fit, const SignalScales& scales,
                     std::vector<Candidate> candidates, const WindowSet& chosen)
    : candidates_(std::move(candidates)) {
  const Hypothesis& base = fit.best;
  std::erase_if(candidates_,
                [&](const Candidate& candidate) { return !IsLogged(*candidate.effect, scales); });
  at_base_ = problem.Projected(ModelAt(base, base.x), chosen);
  imitated_ = BasisOf(problem.Jacobian(base, base.x, at_base_, chosen));
  Eigen::MatrixXd r = at_base_;
  RemoveImitated(r);
  residual_ = r.col(0);
  std::vector<std::vector<Signature>> found(candidates_.size());
  ParallelFor(static_cast<int>(candidates_.size()), [&](int i) {
    const Candidate& candidate = candidates_[i];
    for (const Hypothesis& start : WithEffect(base, *candidate.effect, scales, candidate.partner)) {
      Signature signature{i, start, AmplitudesIn(start, *candidate.effect), {}, {}, 0};
      // Of starts that differ in sign one is enough.
      const auto negative = [&](int column) { return start.x[column] < 0; };
      if (std::any_of(signature.columns.begin(), signature.columns.end(), negative)) continue;
      Eigen::MatrixXd columns(at_base_.size(), signature.columns.size());
      for (size_t k = 0; k < signature.columns.size(); ++k) {
        Eigen::VectorXd x = start.x;
        for (const int other : signature.columns)
          if (other != signature.columns[k]) x[other] = 0;
        columns.col(static_cast<int>(k)) =
            (problem.Projected(ModelAt(start, x), chosen) - at_base_) / x[signature.columns[k]];
      }
      DropIdle(*candidate.effect, signature, columns);
      const double whole = columns.squaredNorm();
      Eigen::MatrixXd free = columns;
      RemoveImitated(free);
      signature.surviving = whole > 0 ? free.squaredNorm() / whole : 0;
      if (signature.surviving > kRank && std::isfinite(whole)) {
        signature.basis = BasisOf(free);
        signature.columns_of_basis = signature.basis.transpose() * free;
      } else {
        signature.basis.resize(at_base_.size(), 0);
      }
      found[i].push_back(std::move(signature));
    }
  });
  for (auto& signatures : found)
    for (Signature& signature : signatures) signatures_.push_back(std::move(signature));
}

void Screening::RemoveImitated(Eigen::MatrixXd& columns) const {
  if (imitated_.cols() > 0) columns -= imitated_ * (imitated_.transpose() * columns).eval();
}

double Screening::Gain(const Signature& signature) const {
  const double whole = residual_.squaredNorm();
  if (signature.basis.cols() == 0 || whole == 0) return 0;
  return (signature.basis.transpose() * residual_).squaredNorm() / whole;
}

Hypothesis Screening::LinearStart(const Signature& signature) const {
  Hypothesis h = signature.start;
  if (signature.basis.cols() == 0) return h;  // imitated: no direction of its own
  const Eigen::VectorXd wanted = -(signature.basis.transpose() * residual_);
  const Eigen::VectorXd amplitudes =
      signature.columns_of_basis.completeOrthogonalDecomposition().solve(wanted);
  for (size_t k = 0; k < signature.columns.size(); ++k) {
    const int i = signature.columns[k];
    h.x[i] = std::clamp(amplitudes[static_cast<int>(k)], h.free[i].lower, h.free[i].upper);
  }
  return h;
}

}  // namespace robostress::calibration
