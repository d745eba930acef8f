#include "calibration/model/unit_check.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/data/log_units.h"
#include "calibration/model/joint_model.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kBeyondStops = 2;        // times the travel between them
constexpr double kRatioTolerance = 0.06;  // of asked torque over logged torque
constexpr double kCorrelated = 0.95;      // asked and logged torque
constexpr double kFollows = 0.8;          // correlation of that torque and the model's
constexpr double kOtherWay = 0.5;         // -torque over what the model asks for the motion
constexpr double kShare = 0.25;           // of the torque's squares: not friction's
constexpr double kFarTooMuch = 100;       // torque over the same
constexpr double kEnergy = 8;             // kinetic energy over the work that made it
constexpr double kSpan_s = 0.1;           // over which they are compared
constexpr int kFewestSpans = 20;
constexpr double kTurning = 300;        // [m/s^2] towards the axis, 30 g
constexpr double kSliding = 20;         // [m/s]
constexpr double kTurns = 4 * M_PI;     // [rad] less is not looked at for degrees by gravity
constexpr double kClearlyBetter = 0.2;  // residual as degrees over residual as radians
constexpr double kDegree = M_PI / 180;  // [rad]

// Of one joint over its logs: products of the drive's torque and what the model asks, and the
// squares of the drive's torque about its mean, [Nm^2] times a factor.
struct DriveSums {
  double both = 0, driven = 0, asked = 0, varying = 0;
  int logs = 0;

  // A torque that counts the other way, or has another unit; empty: neither. Where friction is most
  // of the torque, what the model leaves out decides the rest.
  std::string Impossible() const {
    if (!(std::abs(both) > kFollows * std::sqrt(driven * asked)) || driven < kShare * varying)
      return "";
    const double gain = both / asked;
    if (gain > -kOtherWay && gain < kFarTooMuch) return "";
    return absl::StrFormat(
        "over %d log%s its torque is %.4g times what its motion asks of the model's masses and "
        "gravity; %s, or the model's %s wrong",
        logs, logs == 1 ? "" : "s", gain,
        gain < 0 ? "if it counts the other way multiply it by -1"
                 : "if its numbers are thousandths multiply them by 0.001",
        gain < 0 ? "axis is" : "masses are");
  }
};

// One joint in one log.
class Units {
 public:
  // `mass_is_free`: the rig fits it.
  Units(const Plant& plant, const MeasuredLog& log, int index, JointModel model, bool mass_is_free)
      : plant_(plant),
        log_(log),
        index_(index),
        model_(std::move(model)),
        mass_is_free_(mass_is_free) {}

  // What is impossible in it; empty: nothing is.
  std::string Impossible() const {
    for (const auto find : {&Units::BeyondStops, &Units::TorqueLogged, &Units::Energy,
                            &Units::Speed, &Units::Gravity}) {
      if (std::string found = (this->*find)(); !found.empty()) return found;
    }
    return "";
  }

  // Adds the drive's torque and what the model asks for the motion, both without what dry friction,
  // damping and an offset explain; means over a span, for an acceleration is noise from row to row.
  void AddDrive(DriveSums& sums) const {
    const JointRecord& r = record();
    const int span = std::max(1, static_cast<int>(std::lround(kSpan_s / log_.dt)));
    const int spans = log_.rows / span;
    if (drive().empty() || mass_is_free_ || model_.mass_scale != 1 || spans < kFewestSpans) return;
    const std::vector<PlantRow> rows = plant_.Rows(index_, log_);
    const double slow = std::max(2 * r.start_noise_dq, 1e-9);
    Eigen::MatrixXd terms = Eigen::MatrixXd::Zero(spans, 3);
    Eigen::MatrixXd torques = Eigen::MatrixXd::Zero(spans, 2);
    for (int k = 0; k < spans * span; ++k) {
      const PlantRow& row = At(rows, k);
      terms.row(k / span) += Eigen::RowVector3d(r.dq[k], std::tanh(r.dq[k] / slow), 1);
      torques.row(k / span) +=
          Eigen::RowVector2d(model_.torque_gain * drive()[k],
                             row.inertia * r.ddq[k] + GravityAt(row, r.q_smooth[k]) + row.coupling);
    }
    const Eigen::MatrixXd left = torques - terms * terms.colPivHouseholderQr().solve(torques);
    const Eigen::VectorXd varying = torques.col(0).array() - torques.col(0).mean();
    sums.both += left.col(0).dot(left.col(1));
    sums.driven += left.col(0).squaredNorm();
    sums.asked += left.col(1).squaredNorm();
    sums.varying += varying.squaredNorm();
    ++sums.logs;
  }

 private:
  const JointRecord& record() const { return log_.joints[index_]; }
  std::string Mend() const {
    return plant_.hinge(index_)
               ? absl::StrFormat(
                     "positions in degrees are mended by %.6g, others by the radians "
                     "of one unit",
                     kDegree)
               : std::string(
                     "positions in millimetres are mended by 0.001, others by the metres "
                     "of one unit");
  }
  const char* unit() const { return plant_.hinge(index_) ? "rad" : "m"; }

  std::string BeyondStops() const {
    const double travel = plant_.travel(index_), range = RangeOf(record().q_smooth);
    if (travel <= 0 || range < kBeyondStops * travel) return "";
    return absl::StrFormat(
        "it moves over %.4g %s, and its stops in the model are %.4g %s apart; %s", range, unit(),
        travel, unit(), Mend());
  }

  // The servo's torque at a row, whatever its limit.
  double Asked(int k) const {
    const JointRecord& r = record();
    return model_.servo.kp * (r.command[k] - r.q_smooth[k]) - model_.servo.kd * r.dq[k];
  }

  std::string TorqueLogged() const {
    const JointRecord& r = record();
    if (model_.input != JointInput::kPositionTarget || r.tau.empty() ||
        model_.servo.type != Servo::Type::kPd)
      return "";
    double both = 0, logged = 0, asked = 0;
    for (int k = 0; k < log_.rows; ++k) {
      if (std::abs(r.tau[k]) > 0.95 * model_.servo.torque_limit) continue;
      both += Asked(k) * r.tau[k];
      logged += r.tau[k] * r.tau[k];
      asked += Asked(k) * Asked(k);
    }
    if (both < kCorrelated * std::sqrt(logged * asked) || logged == 0) return "";
    const std::string found = UnitOfRatio(both / logged, kRatioTolerance);
    if (found.empty()) return "";
    return absl::StrFormat(
        "its servo asks for %.4g times the torque that is logged; if that is in %s, the positions "
        "are %s",
        both / logged, plant_.hinge(index_) ? "Nm" : "N", found);
  }

  // Torque of the drive that a log holds [Nm]; empty: none does.
  const std::vector<double>& drive() const { return record().tau; }

  std::string Energy() const {
    const JointRecord& r = record();
    if (drive().empty() || mass_is_free_ || model_.mass_scale != 1) return "";
    const std::vector<PlantRow> rows = plant_.Rows(index_, log_);
    const int span = std::max(1, static_cast<int>(std::lround(kSpan_s / log_.dt)));
    double gained = 0, given = 0;
    for (int first = 0; first + span < log_.rows; first += span) {
      const double before = Kinetic(rows, first), after = Kinetic(rows, first + span);
      gained += std::max(0.0, after - before);
      for (int k = first; k < first + span; ++k) {
        const PlantRow& row = At(rows, k);
        const double net =
            model_.torque_gain * drive()[k] - GravityAt(row, r.q_smooth[k]) - row.coupling;
        given += std::abs(net * r.dq[k]) * log_.dt;
      }
    }
    if (gained < kEnergy * given || given == 0) return "";
    return absl::StrFormat(
        "its link gains %.3g J while drive and gravity give it %.3g J: positions are not in %s, or "
        "the model's masses are far too large; %s",
        gained, given, unit(), Mend());
  }

  std::string Speed() const {
    std::vector<double> speeds;
    for (const double dq : record().dq) speeds.push_back(std::abs(dq));
    const auto at = speeds.begin() + static_cast<int>(0.99 * static_cast<double>(speeds.size()));
    std::nth_element(speeds.begin(), at, speeds.end());
    if (!plant_.hinge(index_)) {
      if (*at < kSliding) return "";
      return absl::StrFormat("it slides at %.4g m/s, which no robot does; %s", *at, Mend());
    }
    const std::vector<PlantRow> rows = plant_.Rows(index_, log_);
    double reach = 0, gravity = 0;
    for (const PlantRow& row : rows) {
      reach = std::max(reach, std::sqrt(row.payload_inertia));
      gravity = std::max(
          {gravity, std::abs(row.gravity.a), std::abs(row.gravity.b), std::abs(row.gravity.c)});
    }
    if (gravity == 0 || reach * *at * *at < kTurning) return "";
    return absl::StrFormat(
        "at %.4g rad/s its end, %.3g m from the axis, has %.4g m/s^2 towards it, which no robot "
        "has; %s",
        *at, reach, reach * *at * *at, Mend());
  }

  // Torque against inertia, damping, dry friction and an offset, all free, beside the model's
  // gravity: what they leave, as a share. `factor`: radians of one unit of the positions.
  double Left(double factor) const {
    MeasuredLog log = log_;
    for (JointRecord& joint : log.joints)
      for (auto* channel : {&joint.q_smooth, &joint.dq, &joint.ddq, &joint.motion.q,
                            &joint.motion.dq, &joint.motion.ddq})
        for (double& value : *channel) value *= factor;
    const std::vector<PlantRow> rows = plant_.Rows(index_, log);
    const JointRecord& r = log.joints[index_];
    const bool servo = model_.input == JointInput::kPositionTarget;
    Eigen::MatrixXd terms(log.rows, 4);
    Eigen::VectorXd torque(log.rows);
    const double slow = std::max(2 * record().start_noise_dq * factor, 1e-9);
    double whole = 0;
    for (int k = 0; k < log.rows; ++k) {
      const double tau = servo ? factor * Asked(k) : r.tau[k];
      const PlantRow& row = At(rows, k);
      torque[k] = tau - GravityAt(row, r.q_smooth[k]) - row.coupling;
      terms.row(k) << r.ddq[k], r.dq[k], std::tanh(r.dq[k] / slow), 1;
      whole += tau * tau;
    }
    const Eigen::VectorXd found = terms.colPivHouseholderQr().solve(torque);
    return whole > 0 ? (torque - terms * found).norm() / std::sqrt(whole) : 0;
  }

  std::string Gravity() const {
    const bool servo =
        model_.input == JointInput::kPositionTarget && model_.servo.type == Servo::Type::kPd;
    if (!plant_.hinge(index_) || RangeOf(record().q_smooth) < kTurns ||
        !(servo || !drive().empty()))
      return "";
    const double as_radians = Left(1), as_degrees = Left(kDegree);
    if (as_degrees > kClearlyBetter * as_radians) return "";
    return absl::StrFormat(
        "gravity leaves %.3g of its torque unexplained, and %.3g with positions taken as degrees; "
        "%s",
        as_radians, as_degrees, Mend());
  }

  static double RangeOf(const std::vector<double>& values) {
    const auto [low, high] = std::minmax_element(values.begin(), values.end());
    return *high - *low;
  }
  const PlantRow& At(const std::vector<PlantRow>& rows, int k) const {
    return rows[plant_.single() ? 0 : k];
  }
  double GravityAt(const PlantRow& row, double q) const {
    return Evaluate(row.gravity, plant_.single(), std::cos(q), std::sin(q), q, row.q_ref);
  }
  double Kinetic(const std::vector<PlantRow>& rows, int k) const {
    return 0.5 * At(rows, k).inertia * record().dq[k] * record().dq[k];
  }

  const Plant& plant_;
  const MeasuredLog& log_;
  const int index_;
  const JointModel model_;
  const bool mass_is_free_;
};

// The log with the positions of one joint in another unit.
MeasuredLog InUnitsOf(MeasuredLog log, int index, double factor) {
  JointRecord& joint = log.joints[index];
  for (auto* channel : {&joint.q, &joint.command, &joint.q_smooth, &joint.dq, &joint.ddq,
                        &joint.motion.q, &joint.motion.dq, &joint.motion.ddq, &joint.motion.rise})
    for (double& value : *channel) value *= factor;
  joint.start_noise_dq *= factor;
  return log;
}

}  // namespace

absl::StatusOr<std::vector<std::string>> CheckUnits(const Rig& rig, const Plant& plant,
                                                    const std::vector<MeasuredLog>& logs) {
  std::vector<std::string> unchecked;
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    const RigJoint& joint = rig.joints[i];
    RS_ASSIGN_OR_RETURN(const JointModel declared, DeclaredModel(rig, plant, i));
    bool checked = false;
    DriveSums sums;
    for (const MeasuredLog& log : logs) {
      absl::StatusOr<JointModel> model = WithOverrides(declared, joint.name, log.overrides);
      if (!model.ok())
        return absl::InvalidArgumentError(
            absl::StrCat(rig.file, ": log ", log.file, ": ", model.status().message()));
      if (joint.input == JointInput::kTransmission) continue;
      const bool free = std::count(joint.fit.begin(), joint.fit.end(), "mass_scale") > 0;
      const Units units(plant, log, i, *model, free);
      if (const std::string found = units.Impossible(); !found.empty())
        return absl::InvalidArgumentError(
            absl::StrCat(log.file, ": joint '", joint.name, "': ", found));
      units.AddDrive(sums);
      if (checked) continue;
      const MeasuredLog other = InUnitsOf(log, i, plant.hinge(i) ? 1 / kDegree : 1000);
      checked = !Units(plant, other, i, *std::move(model), free).Impossible().empty();
    }
    if (const std::string found = sums.Impossible(); !found.empty()) {
      return absl::InvalidArgumentError(
          absl::StrCat(rig.file, ": joint '", joint.name, "': ", found));
    }
    if (!checked) unchecked.push_back(joint.name);
  }
  return unchecked;
}

}  // namespace robostress::calibration
