#include "calibration/excite/excitation_design.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/model/plant.h"
#include "calibration/search/parallel.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kStopMargin = 0.05;  // of a joint's way, kept from its stops
constexpr double kLeastSwing = 0.02;  // [rad, m]
constexpr double kFinest = 250;       // [Hz] of rows that sensitivities are measured at
constexpr double kShrink = 0.85;      // of swings or speeds, at each try
constexpr double kCheckEvery = 0.02;  // [s]
constexpr int kTries = 20;
constexpr int kExchanges = 3;   // rounds over the pieces of a joint
constexpr double kFrame = 0.1;  // [s] of a film

double Of(const std::map<std::string, double>& of_joint, const std::string& name,
          double otherwise) {
  const auto found = of_joint.find(name);
  return found == of_joint.end() ? otherwise : found->second;
}

class Designer {
 public:
  Designer(const Rig& rig, const DesignOptions& options) : rig_(rig), options_(options) {
    design_.dt = 1 / rig.rate_hz;
    count_ = std::max(1, static_cast<int>(std::lround(options.seconds / options.piece_s)));
  }

  absl::StatusOr<ExcitationDesign> Design() {
    RS_RETURN_IF_ERROR(CheckNames());
    RS_ASSIGN_OR_RETURN(space_, ArmSpace::Load(rig_, options_.space));
    RS_ASSIGN_OR_RETURN(plant_, Plant::Load(rig_));
    if (space_->shapes() == 0 && !options_.without_shapes)
      return absl::FailedPreconditionError(absl::StrCat(
          rig_.model,
          ": has no shapes that collide, so nobody can say whether the arm meets itself; give a "
          "model with shapes, or --without-shapes where nothing can be met"));
    RS_RETURN_IF_ERROR(FindRooms());
    RS_RETURN_IF_ERROR(space_->WatchFrom(centre_));
    RS_RETURN_IF_ERROR(ChoosePieces());
    for (int attempt = 0;; ++attempt) {
      Sample();
      RS_ASSIGN_OR_RETURN(const bool fits, Fits(attempt + 1 == kTries));
      if (fits) break;
    }
    RS_RETURN_IF_ERROR(Describe());
    design_.notes.insert(design_.notes.end(), space_->notes().begin(), space_->notes().end());
    return std::move(design_);
  }

 private:
  absl::Status CheckNames() const {
    for (const auto* map :
         {&options_.swings, &options_.velocities, &options_.accelerations, &options_.centre}) {
      for (const auto& [name, value] : *map) {
        const bool known = std::any_of(rig_.joints.begin(), rig_.joints.end(),
                                       [&](const RigJoint& joint) { return joint.name == name; });
        if (!known)
          return absl::InvalidArgumentError(
              absl::StrCat(rig_.file, ": has no joint '", name, "' of which a limit was given"));
      }
    }
    return absl::OkStatus();
  }

  absl::Status FindRooms() {
    for (size_t j = 0; j < rig_.joints.size(); ++j) {
      const std::string& name = rig_.joints[j].name;
      if (rig_.joints[j].input == JointInput::kTransmission)
        return absl::InvalidArgumentError(
            absl::StrCat(rig_.file, ": joint '", name,
                         "' has input transmission, whose two encoders see any motion; play one of "
                         "another joint"));
      JointRoom room;
      room.centre = Of(options_.centre, name, space_->home()[j]);
      const double swing = Of(options_.swings, name, options_.swing);
      room.lower = room.centre - swing, room.upper = room.centre + swing;
      if (const auto& stops = space_->stops()[j]) {
        const double margin = kStopMargin * (stops->upper - stops->lower);
        room.lower = std::max(room.lower, stops->lower + margin);
        room.upper = std::min(room.upper, stops->upper - margin);
        if (room.upper - room.lower < kLeastSwing || room.centre < stops->lower ||
            room.centre > stops->upper) {
          return absl::FailedPreconditionError(absl::StrFormat(
              "joint '%s' has no room around %.3f between its stops %.3f and %.3f; give another "
              "--centre %s=...",
              name, room.centre, stops->lower, stops->upper, name));
        }
        room.centre = std::clamp(room.centre, room.lower, room.upper);
      }
      room.velocity = Of(options_.velocities, name, options_.velocity);
      room.acceleration = Of(options_.accelerations, name, options_.acceleration);
      design_.joints.push_back({.name = name, .room = room});
      centre_.push_back(room.centre);
    }
    return absl::OkStatus();
  }

  int Rows(double dt) const { return static_cast<int>(std::lround(options_.piece_s / dt)); }
  // [s] of rows that sensitivities are measured at.
  double CoarseRow() const { return std::max(design_.dt, 1 / kFinest); }

  // Pieces of every joint, the best first.
  absl::Status ChoosePieces() {
    const std::vector<JointPiece> pool = PiecePool(options_.fastest);
    const double dt = CoarseRow();
    chosen_.resize(rig_.joints.size());
    std::vector<absl::Status> failed(rig_.joints.size());
    for (size_t j = 0; j < rig_.joints.size(); ++j) {
      if (options_.sweep) continue;
      std::vector<std::vector<double>> motions;
      for (const JointPiece& piece : pool)
        motions.push_back(SamplePiece(piece, design_.joints[j].room, dt, Rows(dt)));
      RS_ASSIGN_OR_RETURN(const JointSensitivities sensitivities, Measure(j, motions));
      chosen_[j] = Choose(pool, sensitivities);
      // Two joints do not move alike.
      RandomStream random(StreamKey("order of pieces")
                              .With(static_cast<int64_t>(options_.seed))
                              .With(static_cast<int64_t>(j)));
      for (size_t i = chosen_[j].size(); i > 1; --i)
        std::swap(chosen_[j][i - 1], chosen_[j][random.UniformInt(static_cast<int>(i))]);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<JointSensitivities> Measure(
      size_t j, const std::vector<std::vector<double>>& motions) const {
    return JointSensitivities::Measure(rig_, *plant_, static_cast<int>(j),
                                       {.dt = CoarseRow(),
                                        .noise = options_.noise,
                                        .centre = centre_,
                                        .effects = options_.effects},
                                       motions);
  }

  // Takes the best piece until the time is used, then exchanges pieces as long as that helps.
  std::vector<JointPiece> Choose(const std::vector<JointPiece>& pool,
                                 const JointSensitivities& sensitivities) const {
    const auto& products = sensitivities.products();
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(products[0].rows(), products[0].cols());
    const auto best_beside = [&](const Eigen::MatrixXd& others) {
      std::vector<double> utility(pool.size());
      ParallelFor(static_cast<int>(pool.size()),
                  [&](int i) { utility[i] = sensitivities.Utility(others + products[i]); });
      return static_cast<size_t>(std::max_element(utility.begin(), utility.end()) -
                                 utility.begin());
    };
    std::vector<size_t> chosen;
    while (static_cast<int>(chosen.size()) < count_) {
      chosen.push_back(best_beside(sum));
      sum += products[chosen.back()];
    }
    for (int round = 0, kept = 0; kept < count_ && round < kExchanges * count_; ++round) {
      size_t& piece = chosen[round % count_];
      const Eigen::MatrixXd others = sum - products[piece];
      const size_t better = best_beside(others);
      kept = better == piece ? kept + 1 : 0;
      piece = better;
      sum = others + products[piece];
    }
    std::vector<JointPiece> pieces;
    for (const size_t i : chosen) pieces.push_back(pool[i]);
    return pieces;
  }

  void Sample() {
    design_.q.clear();
    const int rows = Rows(design_.dt);
    for (size_t j = 0; j < chosen_.size(); ++j) {
      const JointRoom& room = design_.joints[j].room;
      std::vector<double> q;
      if (options_.sweep) {
        q = SampleSweep(room, options_.fastest, 2 * M_PI * static_cast<double>(j) / 7, design_.dt,
                        rows * count_);
      }
      for (const JointPiece& piece : chosen_[j]) {
        const std::vector<double> part = SamplePiece(piece, room, design_.dt, rows);
        q.insert(q.end(), part.begin(), part.end());
      }
      design_.q.push_back(std::move(q));
    }
  }

  // Whether nothing meets and no motor is asked for too much; else makes the motion smaller or
  // slower.
  absl::StatusOr<bool> Fits(bool last) {
    const size_t n = design_.q.size(), rows = design_.q[0].size();
    const auto every =
        static_cast<size_t>(std::max(1.0, std::floor(kCheckEvery / design_.dt + 1e-9)));
    std::vector<double> now(n), speed(n), rise(n);
    std::string met;
    for (size_t row = 0; row < rows && met.empty(); row += every) {
      for (size_t j = 0; j < n; ++j) now[j] = design_.q[j][row];
      met = space_->MetAt(now);
    }
    if (!met.empty()) {
      if (last)
        return absl::FailedPreconditionError(
            absl::StrCat("at any size of the motion ", met,
                         " meet; give another --centre, or a smaller --swing"));
      for (ExcitationDesign::Joint& joint : design_.joints) {
        joint.room.lower = joint.room.centre + kShrink * (joint.room.lower - joint.room.centre);
        joint.room.upper = joint.room.centre + kShrink * (joint.room.upper - joint.room.centre);
      }
      design_.notes = {absl::StrCat("swings are smaller, because ", met, " would meet")};
      return false;
    }
    design_.torque_used = 0;
    std::string loaded;
    bool by_holding = false;
    for (size_t row = every; row + every < rows; row += every) {
      for (size_t j = 0; j < n; ++j) {
        const double h = static_cast<double>(every) * design_.dt;
        const double before = design_.q[j][row - every], after = design_.q[j][row + every];
        now[j] = design_.q[j][row];
        speed[j] = (after - before) / (2 * h);
        rise[j] = (after - 2 * now[j] + before) / (h * h);
      }
      const std::vector<double> torques = space_->TorquesAt(now, speed, rise);
      for (size_t j = 0; j < n; ++j) {
        const double limit = rig_.joints[j].servo.torque_limit;
        if (!std::isfinite(limit) || limit <= 0) continue;
        const double share = std::abs(torques[j]) / limit;
        if (share <= design_.torque_used) continue;
        design_.torque_used = share;
        const std::vector<double> still(n, 0);
        by_holding =
            std::abs(space_->TorquesAt(now, still, still)[j]) > options_.torque_share * limit;
        loaded = absl::StrFormat("joint '%s' is asked for %.3g of %.3g Nm", rig_.joints[j].name,
                                 std::abs(torques[j]), limit);
      }
    }
    if (design_.torque_used <= options_.torque_share) return true;
    if (last || by_holding)
      return absl::FailedPreconditionError(absl::StrFormat(
          "%s%s; the motion may ask for %.3g of it: give another --centre, a smaller --swing, or "
          "correct the model's masses and servo.torque_limit",
          loaded, by_holding ? " to hold still" : "", options_.torque_share));
    for (ExcitationDesign::Joint& joint : design_.joints) {
      joint.room.acceleration *= kShrink;
      joint.room.velocity *= kShrink;
    }
    return false;
  }

  // What the motion as it came out shows, each joint alone.
  absl::Status Describe() {
    const auto step = static_cast<size_t>(std::max(1.0, std::round(CoarseRow() / design_.dt)));
    for (size_t j = 0; j < design_.joints.size(); ++j) {
      ExcitationDesign::Joint& joint = design_.joints[j];
      std::vector<double> motion;
      for (size_t row = 0; row < design_.q[j].size(); row += step)
        motion.push_back(design_.q[j][row]);
      RS_ASSIGN_OR_RETURN(const JointSensitivities sensitivities, Measure(j, {motion}));
      joint.effects = sensitivities.effects();
      joint.sights = sensitivities.SightsIn(sensitivities.products()[0]);
      for (const JointPiece& piece : chosen_[j]) joint.pieces.push_back(piece.Name());
      if (options_.sweep)
        joint.pieces = {absl::StrFormat("a sweep up to %.2g Hz", options_.fastest)};
    }
    return absl::OkStatus();
  }

  const Rig& rig_;
  const DesignOptions& options_;
  int count_ = 0;  // of pieces of a joint
  std::unique_ptr<ArmSpace> space_;
  std::unique_ptr<Plant> plant_;
  std::vector<double> centre_;
  std::vector<std::vector<JointPiece>> chosen_;  // per joint
  ExcitationDesign design_;
};

}  // namespace

absl::StatusOr<ExcitationDesign> DesignExcitation(const Rig& rig, const DesignOptions& options) {
  return Designer(rig, options).Design();
}

absl::Status FilmExcitation(const Rig& rig, const DesignOptions& options,
                            const ExcitationDesign& design, const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ArmSpace> space, ArmSpace::Load(rig, options.space));
  const int every = std::max(1, static_cast<int>(std::lround(kFrame / design.dt)));
  return space->Film(design.q, every, every * design.dt, file);
}

std::string ExcitationCsv(const ExcitationDesign& design) {
  std::string text = "t";
  for (const ExcitationDesign::Joint& joint : design.joints)
    absl::StrAppend(&text, ",q_cmd_", joint.name);
  text += "\n";
  for (size_t row = 0; row < design.q[0].size(); ++row) {
    absl::StrAppendFormat(&text, "%.6f", static_cast<double>(row) * design.dt);
    for (const std::vector<double>& q : design.q) absl::StrAppendFormat(&text, ",%.9f", q[row]);
    text += "\n";
  }
  return text;
}

}  // namespace robostress::calibration
