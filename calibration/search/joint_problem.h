#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calibration/model/hypothesis.h"
#include "calibration/model/joint_simulation.h"

namespace robostress::calibration {

// A free run: some rows of a track. Of inputs that are no motion to be simulated a block of rows.
struct Window {
  size_t track = 0;
  int first = 0, rows = 0;
};

// Which windows of a problem take part, one flag each.
using WindowSet = std::vector<char>;

// Predictions and residuals of one joint over its logs.
//
// A residual vector holds predicted minus measured, window by window, every stride-th row of the
// windows chosen. A free run starts from a measured state, whose error it carries along; residuals
// that serve decisions are therefore *projected*: of every window what a change of its initial
// position and velocity explains is taken out, as far as the noise of the measured state allows
// for.
class JointProblem {
 public:
  // window [rows]; 0: a window is a whole track. Keeps `tracks`.
  JointProblem(std::string joint, std::vector<JointTrack> tracks, int window);

  const std::string& joint() const { return joint_; }
  const std::vector<JointTrack>& tracks() const { return tracks_; }
  const std::vector<Window>& windows() const { return windows_; }
  int window() const { return window_; }  // [rows]
  WindowSet All() const { return WindowSet(windows_.size(), 1); }
  WindowSet OfRole(LogRole role) const;
  int stride() const { return stride_; }
  int Rows(const Window& window) const { return (window.rows + stride_ - 1) / stride_; }
  int Rows(const WindowSet& chosen) const;

  // Predicted minus measured along a track, all rows; of a transmission without its mean, since an
  // encoder's zero belongs to a session.
  std::vector<double> TrackResidual(const JointModel& model, size_t track) const;
  Eigen::VectorXd Residuals(const JointModel& model, const WindowSet& chosen) const;
  // RMS of the residuals as they are.
  double Rms(const JointModel& model, const WindowSet& chosen) const;

  // Lets the sensitivities to initial states be those of `model`.
  void LinearizeStarts(const JointModel& model);
  // Takes them out of the columns of `m` [Rows(chosen), any].
  void Project(const WindowSet& chosen, Eigen::Ref<Eigen::MatrixXd> m) const;
  Eigen::VectorXd Projected(const JointModel& model, const WindowSet& chosen) const;

  // What noise of the readings alone leaves of projected residuals, and of residuals as they are
  // (which carry the noise of their initial states); root mean squares. Of an arm's joint kArmFloor
  // times as much: the other joints' motions, which push it, come of readings as well.
  double ProjectedFloor(const WindowSet& chosen) const;
  double Floor(const WindowSet& chosen) const;

  // d Projected / d x by forward differences.
  Eigen::MatrixXd Jacobian(const Hypothesis& h, const Eigen::VectorXd& x,
                           const Eigen::VectorXd& at_x, const WindowSet& chosen) const;

 private:
  void Predict(const JointModel& model, size_t track, const std::vector<char>& chosen,
               JointSimulation::StartOffset offset, std::vector<double>& residual) const;
  Eigen::VectorXd Gather(const JointModel& model, const WindowSet& chosen,
                         JointSimulation::StartOffset offset) const;
  const JointRecord& Record(const Window& window) const { return tracks_[window.track].record(); }
  // Share of a window's rows that say something.
  double Heard(const Window& window) const;
  double NoiseVariance(const Window& window) const {
    return Record(window).NoiseVariance(window.first, window.rows);
  }

  std::string joint_;
  std::vector<JointTrack> tracks_;
  std::vector<Window> windows_;
  std::vector<std::vector<char>> silent_;  // [tracks][rows] 1: says nothing; empty: every row does
  std::vector<size_t> first_window_;       // of every track, and one past the end
  int window_ = 0, stride_ = 1;
  double floor_scale_ = 1;
  Eigen::Matrix<double, Eigen::Dynamic, 2> starts_;  // [all rows] sensitivities; empty: none
};

}  // namespace robostress::calibration
