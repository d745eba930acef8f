#pragma once

#include <vector>

#include "calibration/search/joint_problem.h"

namespace robostress::calibration {

struct JointFit {
  Hypothesis best;             // x at the minimum
  double rms = 0;              // projected, over the windows fitted
  std::vector<char> at_bound;  // [free]
};

// Sets at_bound from best.
void MarkBounds(JointFit& fit);

// Bounded Levenberg-Marquardt (Ceres) on a pseudo-Huber loss of projected residuals, from h.x.
// Ends when an iteration gains less than `tolerance` of the loss.
JointFit Minimise(const JointProblem& problem, const Hypothesis& h, const WindowSet& chosen,
                  int max_iterations = 15, double tolerance = 1e-6);
// A few iterations from the two lowest starts, the lower end of them; `Settle` goes on from there,
// as exactly as a search needs.
JointFit Try(const JointProblem& problem, const std::vector<Hypothesis>& starts,
             const WindowSet& chosen);
JointFit Settle(const JointProblem& problem, const JointFit& trial, const WindowSet& chosen);
// For a fit that stays far above what its signature promised: least squares has got stuck, as where
// a whole run sticks or slips. Searches without a gradient, then goes on by least squares.
JointFit Unstick(const JointProblem& problem, const JointFit& fit, const WindowSet& chosen);
// Where a parameter of the fit's effects stands on a bound that is no absence, goes on with a range
// that reaches three times as far, up to twice, while that lowers the error by 2 %.
JointFit Widen(const JointProblem& problem, JointFit fit, const WindowSet& chosen);
// Goes on with the late parameters of the effects of these types free, from several of their
// values, where that lowers the error by 5 %.
JointFit Loosen(const JointProblem& problem, const JointFit& fit,
                const std::vector<std::string>& types, const WindowSet& chosen);
// With commands that go on smoothly from row to row where `fit` holds them, or the other way round,
// where that lowers the error by 3 %.
JointFit WithBetterCommands(const JointProblem& problem, const JointFit& fit,
                            const WindowSet& chosen);
// `less`: `fit` without some of its free parameters or effects. Begins where the others imitate
// what went as well as they can, to first order, if that is nearer than where they were.
JointFit MinimiseWithout(const JointProblem& problem, const JointFit& fit, const Hypothesis& less,
                         const WindowSet& chosen);
// Sizes of an effect that has several are 0 and no longer free where they move nothing, as friction
// that is negative and counts as none.
JointFit DropIdle(const JointProblem& problem, JointFit fit, const std::string& type,
                  const WindowSet& chosen);
// The same where the error is as low without it.
JointFit DropNeedless(const JointProblem& problem, JointFit fit, const std::string& type,
                      const WindowSet& chosen);
// Whether Stribeck's vs or Fs are free, whose fits may end in a neighbouring minimum.
bool HasFreeFriction(const Hypothesis& h);
// From h.x, and where HasFreeFriction also from several speeds with Fs above Fc,
// because nothing leads back from Fs below Fc.
JointFit MinimiseFriction(const JointProblem& problem, const Hypothesis& h,
                          const WindowSet& chosen);

// Rows that count as one observation, from a residual's autocorrelation.
double CorrelationRows(const Eigen::VectorXd& r);

// Standard deviations of the free parameters' values at a minimum: residual variance times the
// inverse Gauss-Newton matrix, widened by the residual's own correlation time; 0 for what
// stands on a bound.
std::vector<double> StandardDeviations(const JointProblem& problem, const JointFit& fit,
                                       const WindowSet& chosen);

}  // namespace robostress::calibration
