#include "calibration/search/aided_motion.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "calibration/data/local_polynomial.h"
#include "calibration/search/joint_fit.h"
#include "calibration/search/parallel.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kPasses = 4;  // each joint's terms hold the others' motions
constexpr int kFitIterations = 8;
constexpr double kFitTolerance = 1e-4;

// First rows of free runs, and the number of rows.
std::vector<int> RunStarts(int rows, int window, int shift) {
  std::vector<int> starts = {0};
  for (int start = shift > 0 ? shift : window; start < rows; start += window)
    starts.push_back(start);
  starts.push_back(rows);
  return starts;
}

// With runs that begin at row `shift` and every window after it.
JointMotion MotionOfRuns(const JointTrack& track, const JointModel& model, int window, int shift) {
  const JointRecord& record = track.record();
  const double dt = track.log->dt;
  const int rows = track.log->rows;
  const double dq = std::max(record.noise, 1e-9), dv = 0.1 * dq / dt;
  const auto predict = [&](JointSimulation::StartOffset offset) {
    JointMotion run{std::vector<double>(rows), std::vector<double>(rows), {}, {}};
    JointSimulation(track).PredictMotion(
        model, window, shift, offset,
        {.readings = absl::MakeSpan(run.q), .velocities = absl::MakeSpan(run.dq)});
    return run;
  };
  JointMotion run = predict({});
  const JointMotion moved = predict({dq, 0}), pushed = predict({0, dv});
  const std::vector<int> starts = RunStarts(rows, window, shift);
  for (size_t i = 0; i + 1 < starts.size(); ++i) {
    const int first = starts[i], count = starts[i + 1] - first;
    Eigen::MatrixX2d S(count, 2);
    Eigen::VectorXd left(count);
    for (int k = 0; k < count; ++k) {
      S(k, 0) = (moved.q[first + k] - run.q[first + k]) / dq;
      S(k, 1) = (pushed.q[first + k] - run.q[first + k]) / dv;
      left[k] = record.q[first + k] - run.q[first + k];
    }
    const Eigen::Vector2d start = S.completeOrthogonalDecomposition().solve(left);
    for (int k = first; k < first + count; ++k) {
      run.q[k] += S.row(k - first) * start;
      run.dq[k] +=
          (moved.dq[k] - run.dq[k]) / dq * start[0] + (pushed.dq[k] - run.dq[k]) / dv * start[1];
    }
  }
  std::vector<double> rest(rows);
  for (int k = 0; k < rows; ++k) rest[k] = record.q[k] - run.q[k];
  const SmoothSignal beyond = SmoothMotion(rest, dt, window / 2, starts);
  run.ddq = UntilNextRow(beyond.second);
  run.rise.resize(rows);
  for (int k = 0; k < rows; ++k) {
    // A run's last row has no next one.
    const bool last = std::binary_search(starts.begin(), starts.end(), k + 1);
    const int from = last ? std::max(0, k - 1) : k;
    run.ddq[k] += (run.dq[from + 1] - run.dq[from]) / dt;
    // Of an acceleration a + r (s - 1/2) over 0 <= s <= 1 the way is the mean velocity's less
    // r dt^2 / 12.
    run.rise[k] = 12 / (dt * dt) *
                  (0.5 * (run.dq[from] + run.dq[from + 1]) * dt - (run.q[from + 1] - run.q[from]));
  }
  for (int k = 0; k < rows; ++k) run.q[k] += beyond.value[k], run.dq[k] += beyond.first[k];
  return run;
}

}  // namespace

JointMotion AidedMotion(const JointTrack& track, const JointModel& model) {
  const int rows = track.log->rows;
  const int window = std::clamp(static_cast<int>(kAidedRun / track.log->dt), 8, std::max(8, rows));
  const int half = window / 2;
  JointMotion motion = MotionOfRuns(track, model, window, 0);
  if (rows <= window) return motion;
  const JointMotion between = MotionOfRuns(track, model, window, half);
  // Of two runs that hold a row the one whose ends are farther.
  for (int k = half / 2; k < rows; ++k) {
    const int within = k % window;
    if (within >= half / 2 && within < window - half / 2) continue;
    motion.q[k] = between.q[k];
    motion.dq[k] = between.dq[k];
    motion.ddq[k] = between.ddq[k];
    motion.rise[k] = between.rise[k];
  }
  return motion;
}

absl::Status AidArmMotions(const Rig& rig, const Plant& plant, std::vector<MeasuredLog>& logs) {
  const int joints = static_cast<int>(rig.joints.size());
  for (int pass = 0; pass < kPasses; ++pass) {
    std::vector<absl::Status> done(joints, absl::OkStatus());
    std::vector<std::vector<JointMotion>> motions(joints);
    std::vector<std::vector<JointTrack>> all_tracks;
    for (int i = 0; i < joints; ++i) all_tracks.push_back(MakeTracks(plant, logs, i));
    ParallelFor(joints, [&](int i) {
      const RigJoint& joint = rig.joints[i];
      if (joint.input != JointInput::kPositionTarget && joint.input != JointInput::kTorque) return;
      if (std::all_of(logs.begin(), logs.end(),
                      [&](const MeasuredLog& log) { return log.joints[i].velocity_logged; }))
        return;
      const std::vector<JointTrack>& tracks = all_tracks[i];
      done[i] = [&]() -> absl::Status {
        RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig, plant, i));
        const SignalScales scales = MeasureScales(joint, tracks);
        RS_ASSIGN_OR_RETURN(const Hypothesis declared,
                            DeclaredHypothesis(joint, model, scales, MeanInertia(tracks)));
        const int window = static_cast<int>(std::round(kAidedRun / logs.front().dt));
        JointProblem problem(joint.name, tracks, window);
        problem.LinearizeStarts(model);
        const JointFit fit = Minimise(problem, declared, problem.OfRole(LogRole::kFit),
                                      kFitIterations, kFitTolerance);
        for (const JointTrack& track : tracks) {
          RS_ASSIGN_OR_RETURN(
              const JointModel own,
              WithOverrides(ModelAt(fit.best, fit.best.x), joint.name, track.log->overrides));
          motions[i].push_back(AidedMotion(track, own));
        }
        return absl::OkStatus();
      }();
    });
    for (int i = 0; i < joints; ++i) {
      RS_RETURN_IF_ERROR(done[i]);
      for (size_t log = 0; log < motions[i].size(); ++log) {
        JointRecord& record = logs[log].joints[i];
        if (!record.velocity_logged) record.motion = std::move(motions[i][log]);
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::calibration
