#include "robot_client/motion/excitation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/random.h"
#include "common/robot_description.h"

namespace robostress {
namespace {

constexpr double kRow_s = 0.02;
constexpr double kLeastSwing = 0.05;  // [rad]
constexpr double kMargin = 0.05;      // [rad] kept from the joints' limits
struct Pass {
  double swing, speed;  // shares of the most
};
constexpr Pass kPasses[] = {{0.2, 1.0 / 8}, {0.5, 1.0 / 2}, {1, 1}};
constexpr int kHarmonics = 5;
constexpr double kFade_s = 2;
// [1/s] Harmonics of a joint are multiples of these: no two joints share one for long.
constexpr int kJoints = static_cast<int>(std::size(kPiperJoints));
constexpr double kBase_hz[kJoints] = {0.050, 0.043, 0.047, 0.059, 0.053, 0.061};

double SmoothStep(double s) {
  s = std::clamp(s, 0.0, 1.0);
  return s * s * s * (10 - 15 * s + 6 * s * s);
}

class Designer {
 public:
  Designer(const ExcitationOptions& options, const ArmLimits& limits, const ArmModel* model)
      : options_(options), limits_(limits), model_(model) {
    motion_.source = absl::StrCat("designed, seed ", options.seed);
    motion_.t = {0};
    motion_.poses = {options.centre};
    std::fill_n(motion_.moves.begin(), kJoints, true);
  }

  absl::StatusOr<Motion> Design() {
    for (int j = 0; j < kJoints; ++j) {
      const double c = options_.centre[j];
      if (!(c >= limits_.lower[j] && c <= limits_.upper[j]))
        return absl::FailedPreconditionError(absl::StrFormat(
            "the motion's centre has %s at %.3f rad, the arm allows %.3f to %.3f; correct home",
            motion_.axes.name(j), c, limits_.lower[j], limits_.upper[j]));
      const double up = Room(j, 1), down = Room(j, -1);
      if (up + down < kLeastSwing) {
        return absl::FailedPreconditionError(absl::StrFormat(
            "%s can swing by %.3f rad only around the motion's centre%s; move home away from it",
            motion_.axes.name(j), up + down,
            blocked_by_.empty() ? "" : absl::StrCat(" (", blocked_by_, ")")));
      }
      swing_[j] = {c - down, c + up};
    }
    // Pass by pass, so that every part of a recording has every joint's motion in it.
    for (const Pass& pass : kPasses) {
      for (int j = 0; j < kJoints; ++j) AddSwing(j, pass);
    }
    if (!AddTogether())
      return absl::FailedPreconditionError(absl::StrCat("joints that are free one by one meet ",
                                                        blocked_by_, " where they move together"));
    return std::move(motion_);
  }

 private:
  // Whether the arm may be there.
  bool Free(const ArmVector& pose) {
    if (model_ == nullptr) return true;
    const ArmModel::Clearance clearance = model_->ClearanceAt(pose);
    for (int b = 0; b < ArmModel::kBounds; ++b) {
      if (clearance[b] < options_.clearance) {
        blocked_by_ = BoundName(static_cast<ArmModel::Bound>(b));
        return false;
      }
    }
    return true;
  }

  // How far a joint may go from the centre in a direction [rad].
  double Room(int joint, int direction) {
    const double limit = direction > 0 ? limits_.upper[joint] : limits_.lower[joint];
    const double most =
        std::min(options_.most_swing, std::abs(limit - options_.centre[joint]) - kMargin);
    ArmVector pose = options_.centre;
    double free = 0;
    for (double way = 0; way <= most; way += 0.01) {
      pose[joint] = options_.centre[joint] + direction * way;
      if (!Free(pose)) break;
      free = way;
    }
    return free;
  }

  void Add(const ArmVector& pose) {
    motion_.t.push_back(motion_.t.back() + kRow_s);
    motion_.poses.push_back(pose);
  }

  // The centre, one end, the other, the centre: each way with the quintic of least jerk.
  void AddSwing(int joint, const Pass& pass) {
    const double centre = options_.centre[joint], peak = pass.speed * options_.joint_velocity;
    double from = centre;
    for (const double to : {centre + pass.swing * (swing_[joint].second - centre),
                            centre + pass.swing * (swing_[joint].first - centre), centre}) {
      const double way = std::abs(to - from);
      const double seconds = std::max(
          {1.875 * way / peak, std::sqrt(5.774 * way / options_.joint_acceleration), kRow_s});
      const int rows = static_cast<int>(std::ceil(seconds / kRow_s));
      ArmVector pose = options_.centre;
      for (int i = 1; i <= rows; ++i) {
        pose[joint] = from + SmoothStep(static_cast<double>(i) / rows) * (to - from);
        Add(pose);
      }
      for (int i = 0; i < static_cast<int>(0.2 / kRow_s); ++i) Add(pose);
      from = to;
    }
  }

  // Poses of all joints at once, swings scaled by `share`.
  std::vector<ArmVector> Together(double share) const {
    RandomStream random(StreamKey("excitation").With(static_cast<int64_t>(options_.seed)));
    std::array<std::array<double, kHarmonics>, kJoints> phase, weight;
    for (int j = 0; j < kJoints; ++j) {
      for (int k = 0; k < kHarmonics; ++k) {
        phase[j][k] = random.Uniform(0, 2 * M_PI);
        weight[j][k] = random.Uniform(0.3, 1);
      }
    }
    const int rows = static_cast<int>(options_.together_s / kRow_s);
    std::vector<ArmVector> poses(static_cast<size_t>(rows), options_.centre);
    for (int j = 0; j < kJoints; ++j) {
      std::vector<double> wave(static_cast<size_t>(rows));
      for (int i = 0; i < rows; ++i) {
        const double t = i * kRow_s;
        double value = 0;
        for (int k = 0; k < kHarmonics; ++k)
          value +=
              weight[j][k] / (k + 1) * std::sin(2 * M_PI * kBase_hz[j] * (k + 1) * t + phase[j][k]);
        const double fade =
            SmoothStep(t / kFade_s) * SmoothStep((options_.together_s - kRow_s - t) / kFade_s);
        wave[static_cast<size_t>(i)] = value * fade;
      }
      // The largest scale at which the swing, the speed and the acceleration fit.
      double scale = 1e9;
      for (int i = 1; i + 1 < rows; ++i) {
        const double before = wave[static_cast<size_t>(i - 1)], now = wave[static_cast<size_t>(i)],
                     after = wave[static_cast<size_t>(i) + 1];
        const double room =
            now > 0 ? swing_[j].second - options_.centre[j] : options_.centre[j] - swing_[j].first;
        const auto fit = [&](double most, double value) {
          if (std::abs(value) > 1e-12) scale = std::min(scale, most / std::abs(value));
        };
        fit(room, now);
        fit(options_.joint_velocity, (after - before) / (2 * kRow_s));
        fit(options_.joint_acceleration, (after - 2 * now + before) / (kRow_s * kRow_s));
      }
      for (int i = 0; i < rows; ++i)
        poses[static_cast<size_t>(i)][j] += share * scale * wave[static_cast<size_t>(i)];
    }
    return poses;
  }

  // Joints that are free one by one may meet where they move together.
  bool AddTogether() {
    for (double share = 1; share > 0.1; share *= 0.8) {
      const std::vector<ArmVector> poses = Together(share);
      if (!std::all_of(poses.begin(), poses.end(), [&](const ArmVector& p) { return Free(p); }))
        continue;
      for (const ArmVector& pose : poses) Add(pose);
      return true;
    }
    return false;
  }

  const ExcitationOptions options_;
  const ArmLimits limits_;
  const ArmModel* const model_;
  Motion motion_;
  std::array<std::pair<double, double>, kJoints> swing_{};  // lower and upper end [rad]
  std::string blocked_by_;
};

}  // namespace

absl::StatusOr<Motion> DesignExcitation(const ExcitationOptions& options, const ArmLimits& limits,
                                        const ArmModel* model) {
  return Designer(options, limits, model).Design();
}

}  // namespace robostress
