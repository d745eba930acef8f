#include "calibration/search/pair_screening.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "calibration/search/surrogates.h"

namespace robostress::calibration {
namespace {

constexpr double kMaxPValue = 0.05;
constexpr double kAlike = 1e-6;  // of 1: what two signatures share beyond this is one direction

// A candidate's best signature and where its basis stands among all.
struct Member {
  const Signature* signature;
  int first, count;
};

std::vector<Member> BestSignatures(const Screening& screening) {
  std::vector<const Signature*> best(screening.candidates().size(), nullptr);
  for (const Signature& signature : screening.signatures()) {
    const Signature*& own = best[signature.candidate];
    if (signature.basis.cols() > 0 &&
        (own == nullptr || screening.Gain(signature) > screening.Gain(*own)))
      own = &signature;
  }
  std::vector<Member> members;
  int first = 0;
  for (const Signature* signature : best) {
    if (signature == nullptr) continue;
    members.push_back({signature, first, static_cast<int>(signature->basis.cols())});
    first += members.back().count;
  }
  return members;
}

// Two members' joint projector in coordinates of the bases: gain = |half * coefficients|^2.
struct Pair {
  int a, b;
  Eigen::MatrixXd half;  // [rank, a.count + b.count]
};

Pair MakePair(const std::vector<Member>& members, int a, int b, const Eigen::MatrixXd& gram) {
  const Member &one = members[a], &other = members[b];
  const int size = one.count + other.count;
  Eigen::MatrixXd own = Eigen::MatrixXd::Identity(size, size);
  own.topRightCorner(one.count, other.count) =
      gram.block(one.first, other.first, one.count, other.count);
  own.bottomLeftCorner(other.count, one.count) =
      own.topRightCorner(one.count, other.count).transpose().eval();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(own);
  Pair pair{a, b, Eigen::MatrixXd(0, size)};
  for (int i = 0; i < size; ++i) {
    const double value = eigen.eigenvalues()[i];
    if (value < kAlike) continue;
    pair.half.conservativeResize(pair.half.rows() + 1, size);
    pair.half.row(pair.half.rows() - 1) =
        eigen.eigenvectors().col(i).transpose() / std::sqrt(value);
  }
  return pair;
}

double Explained(const std::vector<Member>& members, const Pair& pair,
                 const Eigen::VectorXd& coefficients) {
  const Member &one = members[pair.a], &other = members[pair.b];
  Eigen::VectorXd own(one.count + other.count);
  own << coefficients.segment(one.first, one.count), coefficients.segment(other.first, other.count);
  return (pair.half * own).squaredNorm();
}

// The base with both effects: shapes of their signatures, amplitudes that lower the residual most.
Hypothesis StartOf(const Screening& screening, const SignalScales& scales, const Signature& a,
                   const Signature& b) {
  const Candidate& second = screening.candidates()[b.candidate];
  const int own = static_cast<int>(second.effect->parameters.size());
  Hypothesis h = a.start;
  for (const Hypothesis& both : WithEffect(a.start, *second.effect, scales, second.partner)) {
    const int shape =
        std::min<int>(own, static_cast<int>(std::min(both.x.size(), b.start.x.size())));
    h = both;
    if (both.x.tail(shape).isApprox(b.start.x.tail(shape))) break;
  }
  const int of_a = static_cast<int>(a.columns.size()), of_b = static_cast<int>(b.columns.size());
  Eigen::MatrixXd columns(screening.residual().size(), of_a + of_b);
  columns << a.basis * a.columns_of_basis, b.basis * b.columns_of_basis;
  const Eigen::VectorXd amplitudes =
      columns.completeOrthogonalDecomposition().solve(-screening.residual());
  const auto set = [&](const Hypothesis& from, int column, double amplitude) {
    for (size_t i = 0; i < h.free.size(); ++i) {
      if (h.free[i].path == from.free[column].path)
        h.x[static_cast<int>(i)] = std::clamp(amplitude, h.free[i].lower, h.free[i].upper);
    }
  };
  for (int k = 0; k < of_a; ++k) set(a.start, a.columns[k], amplitudes[k]);
  for (int k = 0; k < of_b; ++k) set(b.start, b.columns[k], amplitudes[of_a + k]);
  return h;
}

}  // namespace

std::vector<PairContender> ScreenPairs(const JointProblem& problem, const Screening& screening,
                                       const SignalScales& scales, const WindowSet& chosen,
                                       int surrogates, uint64_t seed) {
  const std::vector<Member> members = BestSignatures(screening);
  if (members.size() < 2) return {};
  const int columns = members.back().first + members.back().count;
  Eigen::MatrixXd basis(screening.residual().size(), columns);
  for (const Member& member : members)
    basis.middleCols(member.first, member.count) = member.signature->basis;
  const Eigen::MatrixXd gram = basis.transpose() * basis;
  // A joint has an effect once, and is coupled to one other joint.
  const auto may_pair = [&](int a, int b) {
    const Candidate& one = screening.candidates()[members[a].signature->candidate];
    const Candidate& other = screening.candidates()[members[b].signature->candidate];
    const bool same_partner = one.partner < 0 || other.partner < 0 || one.partner == other.partner;
    return one.effect != other.effect && same_partner;
  };
  std::vector<Pair> pairs;
  for (int a = 0; a < static_cast<int>(members.size()); ++a) {
    for (int b = a + 1; b < static_cast<int>(members.size()); ++b)
      if (may_pair(a, b)) pairs.push_back(MakePair(members, a, b, gram));
  }
  const auto best = [&](const Eigen::VectorXd& r) {
    const double whole = std::max(r.squaredNorm(), 1e-300);
    const Eigen::VectorXd coefficients = basis.transpose() * r;
    double most = 0;
    for (const Pair& pair : pairs) most = std::max(most, Explained(members, pair, coefficients));
    return most / whole;
  };
  NullDistribution null;
  null.largest.assign(surrogates, 0);
  ForSurrogates(problem, screening, chosen, surrogates, seed,
                [&](int first, const Eigen::MatrixXd& drawn) {
                  for (int s = 0; s < drawn.cols(); ++s)
                    null.largest[first + s] = best(drawn.col(s));
                });
  const double whole = std::max(screening.residual().squaredNorm(), 1e-300);
  const Eigen::VectorXd coefficients = basis.transpose() * screening.residual();
  std::vector<PairContender> contenders;
  std::stable_sort(pairs.begin(), pairs.end(), [&](const Pair& a, const Pair& b) {
    return Explained(members, a, coefficients) > Explained(members, b, coefficients);
  });
  for (const Pair& pair : pairs) {
    const double gain = Explained(members, pair, coefficients) / whole;
    const double p = null.PValue(gain);
    if (p > kMaxPValue || contenders.size() == kPairs) break;
    const Signature &a = *members[pair.a].signature, &b = *members[pair.b].signature;
    contenders.push_back({{a.candidate, b.candidate}, StartOf(screening, scales, a, b), gain, p});
  }
  return contenders;
}

}  // namespace robostress::calibration
