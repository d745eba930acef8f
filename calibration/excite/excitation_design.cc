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

constexpr int kEnds = 64;             // postures in which a load must be held
constexpr double kStopMargin = 0.05;  // of a joint's way, kept from its stops
constexpr double kLeastSwing = 0.02;  // [rad, m]
constexpr double kFinest = 250;       // [Hz] of rows that sensitivities are measured at
constexpr double kShrink = 0.85;      // of swings or speeds, at each try
constexpr double kCheckEvery = 0.02;  // [s]
constexpr int kTries = 20;
constexpr double kLoadShare = 0.3;     // of the largest moment of inertia, that a known mass adds
constexpr double kWorthAChange = 0.5;  // of utility: 1.3 times as far apart
constexpr int kExchanges = 3;          // rounds over the pieces of a joint
constexpr double kFrame = 0.1;         // [s] of a film

double Of(const std::map<std::string, double>& of_joint, const std::string& name,
          double otherwise) {
  const auto found = of_joint.find(name);
  return found == of_joint.end() ? otherwise : found->second;
}

class Designer {
 public:
  Designer(const Rig& rig, const DesignOptions& options) : rig_(rig), options_(options) {
    design_.dt = 1 / rig.rate_hz;
    piece_s_ = options.piece_s > 0 ? options.piece_s : std::clamp(options.seconds / 12, 1.5, 5.0);
    count_ = std::max(1, static_cast<int>(std::lround(options.seconds / piece_s_)));
    piece_s_ = options.seconds / count_;
  }

  absl::StatusOr<ExcitationDesign> Design() {
    RS_RETURN_IF_ERROR(CheckNames());
    RS_ASSIGN_OR_RETURN(space_, ArmSpace::Load(rig_, options_.space));
    RS_ASSIGN_OR_RETURN(plant_, Plant::Load(rig_));
    FindTorqueLimits();
    if (space_->shapes() == 0 && !options_.without_shapes)
      return absl::FailedPreconditionError(absl::StrCat(
          rig_.model, ": has no shapes that collide",
          space_->why_without_shapes().empty()
              ? ""
              : absl::StrCat(" (", space_->why_without_shapes(), ")"),
          ", so nobody can say whether the arm meets itself; give a model with shapes, or "
          "--without-shapes where nothing can be met"));
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
    NoteUncheckedTorques();
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

  // The rig's, or else the model's, as calibrate takes them.
  void FindTorqueLimits() {
    for (size_t j = 0; j < rig_.joints.size(); ++j) {
      const double declared = rig_.joints[j].servo.torque_limit;
      torque_limits_.push_back(std::isfinite(declared) ? declared
                                                       : plant_->effort_limit(static_cast<int>(j)));
    }
  }
  void NoteUncheckedTorques() {
    std::vector<std::string> unchecked;
    for (size_t j = 0; j < rig_.joints.size(); ++j)
      if (!std::isfinite(torque_limits_[j])) unchecked.push_back(rig_.joints[j].name);
    if (!unchecked.empty())
      design_.notes.push_back(absl::StrCat("torques of ", absl::StrJoin(unchecked, ", "),
                                           " were not checked: neither servo.torque_limit of the "
                                           "rig nor the model's effort says what they may be"));
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

  int Rows(double dt) const { return static_cast<int>(std::lround(piece_s_ / dt)); }
  // [s] of rows that sensitivities are measured at.
  double CoarseRow() const { return std::max(design_.dt, 1 / kFinest); }

  // How the arm may differ while the motion is played.
  struct Change {
    std::string words;
    double gain = 1, mass = 0;
  };
  std::map<std::string, double> OverridesOf(const Change& change) const {
    std::map<std::string, double> overrides;
    for (const RigJoint& joint : rig_.joints) {
      if (change.gain != 1 && joint.input == JointInput::kPositionTarget) {
        overrides[absl::StrCat(joint.name, ".servo.kp")] = change.gain * joint.servo.kp;
        overrides[absl::StrCat(joint.name, ".servo.kd")] = std::sqrt(change.gain) * joint.servo.kd;
      }
      if (change.mass > 0) overrides[absl::StrCat(joint.name, ".", kKnownMass)] = change.mass;
    }
    return overrides;
  }
  static Change Load(double mass) {
    return mass > 0 ? Change{.words = absl::StrFormat("with a known %.3g kg at the tip", mass),
                             .mass = mass}
                    : Change();
  }
  // The centre, and ends of the joints' ways.
  std::vector<std::vector<double>> SomePostures() const {
    std::vector<std::vector<double>> postures = {centre_};
    RandomStream random(StreamKey("postures of a load"));
    for (int k = 0; k < kEnds; ++k) {
      std::vector<double> posture;
      for (const ExcitationDesign::Joint& joint : design_.joints)
        posture.push_back(random.UniformInt(2) == 0 ? joint.room.lower : joint.room.upper);
      postures.push_back(std::move(posture));
    }
    return postures;
  }
  std::vector<Change> Changes() const {
    std::vector<Change> changes = {{}};
    if (options_.asked.empty()) return changes;
    const double mass =
        space_->LoadOf(kLoadShare, options_.torque_share, torque_limits_, SomePostures());
    if (mass > 0) changes.push_back(Load(mass));
    const bool servo = std::any_of(
        rig_.joints.begin(), rig_.joints.end(),
        [](const RigJoint& joint) { return joint.input == JointInput::kPositionTarget; });
    if (!servo) return changes;
    changes.push_back({.words = "at half the servos' gains", .gain = 0.5});
    changes.push_back({.words = "at twice the servos' gains", .gain = 2});
    return changes;
  }

  absl::Status ReadPlayed() {
    if (options_.asked.empty()) return absl::OkStatus();
    const auto step = static_cast<size_t>(std::max(1.0, std::round(CoarseRow() / design_.dt)));
    for (const RigLog& log : rig_.logs) {
      if (log.role != LogRole::kFit) continue;
      RS_ASSIGN_OR_RETURN(const MeasuredLog measured, ReadMeasuredLog(rig_, log));
      std::vector<std::vector<double>> q;
      for (const JointRecord& record : measured.joints) {
        const std::vector<double>& whole =
            record.command.empty() ? record.q_smooth : record.command;
        q.emplace_back();
        for (size_t row = 0; row < whole.size(); row += step) q.back().push_back(whole[row]);
      }
      played_.push_back({std::move(q), log.overrides});
    }
    return absl::OkStatus();
  }

  // Pieces of every joint, and under which change they tell most.
  absl::Status ChoosePieces() {
    RS_RETURN_IF_ERROR(ReadPlayed());
    const std::vector<JointPiece> pool = PiecePool(options_.fastest);
    const double dt = CoarseRow();
    chosen_.resize(rig_.joints.size());
    if (options_.sweep) return absl::OkStatus();
    const std::vector<Change> changes = Changes();
    std::vector<std::vector<std::vector<JointPiece>>> chosen(changes.size(), chosen_);
    std::vector<double> utility(changes.size(), 0);
    for (size_t j = 0; j < rig_.joints.size(); ++j) {
      std::vector<JointMotionAsked> motions;
      for (const Change& change : changes)
        for (const JointPiece& piece : pool)
          motions.push_back(
              {SamplePiece(piece, design_.joints[j].room, dt, Rows(dt)), OverridesOf(change)});
      RS_ASSIGN_OR_RETURN(const JointSensitivities sensitivities, Measure(j, motions));
      const auto& products = sensitivities.products();
      const Eigen::MatrixXd before = Before(products);
      for (size_t c = 0; c < changes.size(); ++c) {
        const absl::Span<const Eigen::MatrixXd> own =
            absl::MakeSpan(products).subspan(c * pool.size(), pool.size());
        Eigen::MatrixXd sum = before;
        chosen[c][j] = Choose(pool, own, sensitivities, sum);
        if (IsAsked(j)) utility[c] += sensitivities.Utility(sum);
      }
    }
    size_t best = 0;
    for (size_t c = 1; c < changes.size(); ++c)
      if (utility[c] > utility[best] + (best == 0 ? kWorthAChange : 0)) best = c;
    chosen_ = std::move(chosen[best]);
    design_.change = changes[best].words;
    design_.gain = changes[best].gain, design_.mass = changes[best].mass;
    design_.overrides = OverridesOf(changes[best]);
    space_->SetLoad(design_.mass);
    // Two joints do not move alike.
    for (size_t j = 0; j < chosen_.size(); ++j) {
      RandomStream random(StreamKey("order of pieces")
                              .With(static_cast<int64_t>(options_.seed))
                              .With(static_cast<int64_t>(j)));
      for (size_t i = chosen_[j].size(); i > 1; --i)
        std::swap(chosen_[j][i - 1], chosen_[j][random.UniformInt(static_cast<int>(i))]);
    }
    return absl::OkStatus();
  }

  bool IsAsked(size_t j) const {
    return options_.asked.empty() || options_.asked.count(rig_.joints[j].name) > 0;
  }

  // Of motions, and of what the logs hold behind them.
  absl::StatusOr<JointSensitivities> Measure(size_t j,
                                             std::vector<JointMotionAsked> motions) const {
    for (const Played& log : played_) motions.push_back({log.q[j], log.overrides});
    const auto asked = options_.asked.find(rig_.joints[j].name);
    JointSensitivities::Setup setup{
        .dt = CoarseRow(), .noise = options_.noise, .centre = centre_, .effects = options_.effects};
    if (asked != options_.asked.end()) {
      setup.effects = asked->second.effects;
      setup.found = asked->second.found;
    }
    return JointSensitivities::Measure(rig_, *plant_, static_cast<int>(j), setup, motions);
  }
  // Of the logs.
  Eigen::MatrixXd Before(const std::vector<Eigen::MatrixXd>& products) const {
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(products[0].rows(), products[0].cols());
    for (size_t i = 0; i < played_.size(); ++i) sum += products[products.size() - 1 - i];
    return sum;
  }

  // Takes the best piece until the time is used, then exchanges pieces as long as that helps.
  // `sum`: the product that there is before, and then with the pieces.
  std::vector<JointPiece> Choose(const std::vector<JointPiece>& pool,
                                 absl::Span<const Eigen::MatrixXd> products,
                                 const JointSensitivities& sensitivities,
                                 Eigen::MatrixXd& sum) const {
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
        const double limit = torque_limits_[j];
        if (!std::isfinite(limit)) continue;
        const double share = std::abs(torques[j]) / limit;
        if (share <= design_.torque_used) continue;
        design_.torque_used = share;
        const std::vector<double> still(n, 0);
        by_holding =
            std::abs(space_->TorquesAt(now, still, still)[j]) > options_.torque_share * limit;
        loaded = absl::StrFormat("joint '%s' is asked for %.3g of %.3g %s", rig_.joints[j].name,
                                 std::abs(torques[j]), limit, space_->TorqueUnit(j));
      }
    }
    if (design_.torque_used <= options_.torque_share) return true;
    if (by_holding && design_.mass > 0) {  // somewhere on the way it is too heavy
      design_.mass = ArmSpace::RoundLoad(0.7 * design_.mass);
      const Change lighter = Load(design_.mass);
      design_.change = lighter.words;
      design_.overrides = OverridesOf(lighter);
      space_->SetLoad(design_.mass);
      return false;
    }
    if (last || by_holding)
      return absl::FailedPreconditionError(absl::StrFormat(
          "%s%s; the motion may ask for %.3g of it: give another --centre, a smaller --swing, or "
          "correct the model's masses, its effort or servo.torque_limit",
          loaded,
          absl::StrCat(by_holding ? " to hold still" : "",
                       design_.mass > 0 ? " " + design_.change : ""),
          options_.torque_share));
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
      RS_ASSIGN_OR_RETURN(const JointSensitivities sensitivities,
                          Measure(j, {{std::move(motion), design_.overrides}}));
      joint.asked = IsAsked(j);
      joint.effects = sensitivities.effects();
      joint.sights =
          sensitivities.SightsIn(sensitivities.products()[0] + Before(sensitivities.products()));
      for (const JointPiece& piece : chosen_[j]) joint.pieces.push_back(piece.Name());
      if (options_.sweep)
        joint.pieces = {absl::StrFormat("a sweep up to %.2g Hz", options_.fastest)};
    }
    return absl::OkStatus();
  }

  struct Played {
    std::vector<std::vector<double>> q;  // [joint][row]
    std::map<std::string, double> overrides;
  };

  const Rig& rig_;
  const DesignOptions& options_;
  std::vector<Played> played_;  // the rig's logs
  double piece_s_ = 0;          // [s] of a piece
  int count_ = 0;               // of pieces of a joint
  std::unique_ptr<ArmSpace> space_;
  std::unique_ptr<Plant> plant_;
  std::vector<double> centre_;
  std::vector<double> torque_limits_;            // [Nm] per joint; infinite: nobody says
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
