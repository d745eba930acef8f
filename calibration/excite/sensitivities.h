#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "calibration/model/plant.h"

namespace robostress::calibration {

// What a joint is asked for, and what differs from the rig meanwhile, as in RigLog::overrides.
struct JointMotionAsked {
  std::vector<double> q;  // [rad, m] per row
  std::map<std::string, double> overrides;
};

// What readings of one joint would say about the effects of the library: inner products of the
// readings' sensitivities over the noise [-]. Those of motions that follow each other add up,
// because free runs restart (JointProblem).
class JointSensitivities {
 public:
  struct Setup {
    double dt = 0;                     // [s] of rows
    double noise = 0;                  // [rad; of input inverse Nm] of a reading
    std::vector<double> centre;        // [joints of the rig] where the others stay
    std::vector<std::string> effects;  // wanted; empty: all that the input can show
    // Of those that a fit has found, the values of their parameters; only their sights count for
    // Utility then.
    std::map<std::string, std::map<std::string, double>> found;
  };
  // An effect that was found is as large as that; others are as large as where fits of them begin,
  // relative to the signals of `motions`, and their sensitivities those of a tenth of it, times
  // ten: two that are one to first order shall not look apart because they are large. Errors: an
  // effect that is unknown or that this input cannot show.
  static absl::StatusOr<JointSensitivities> Measure(const Rig& rig, const Plant& plant, int joint,
                                                    const Setup& setup,
                                                    const std::vector<JointMotionAsked>& motions);

  // One per motion; zero where a prediction diverged.
  const std::vector<Eigen::MatrixXd>& products() const { return products_; }
  const std::vector<std::string>& effects() const { return effects_; }

  // How well each effect is told from the declared model's free parameters and from its nearest
  // rival.
  struct Sight {
    double times_noise = 0;  // root of the sum of squares that nothing else explains
    int rival = -1;          // that explains most of it; -1: there is no other
  };
  std::vector<Sight> SightsIn(const Eigen::MatrixXd& product) const;
  // Mean of log(1 + times_noise^2), of at most 100 each: what a design makes large.
  double Utility(const Eigen::MatrixXd& product) const;

 private:
  struct Columns {
    int first = 0, count = 0;  // one per start
  };
  int free_ = 0;    // columns of the declared model's parameters, which come first
  int shift_ = -1;  // that of command_shift, if it is one
  std::vector<std::string> effects_;
  std::vector<char> counts_;      // for Utility, of effects_
  std::vector<Columns> columns_;  // of effects_
  std::vector<Eigen::MatrixXd> products_;
};

}  // namespace robostress::calibration
