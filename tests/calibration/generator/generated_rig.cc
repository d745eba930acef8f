#include "tests/calibration/generator/generated_rig.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"
#include "tests/calibration/generator/log_hardship.h"

namespace robostress::generator {
namespace {

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

constexpr double kLongestRun = 20;  // [s] of a run that was proposed
// Effects that take from dry friction what must be there.
bool NeedsFriction(const std::string& effect) {
  return Contains({"asymmetric_coulomb", "position_dependent_friction", "time_drift_friction",
                   "temperature_friction", "cross_joint_rubbing", "speeding_friction"},
                  effect);
}

double LogUniform(RandomStream& random, double low, double high) {
  return low * std::pow(high / low, random.Uniform());
}

// Everything of a rig but its hidden effects.
class Drawer {
 public:
  Drawer(const RigOptions& options, Family family)
      : options_(options),
        family_(family),
        random_(StreamKey("generated rig")
                    .With(absl::StrJoin(options.effects, "+"))
                    .With(static_cast<int64_t>(options.size))
                    .With(static_cast<int64_t>(options.seed))
                    .With(static_cast<int64_t>(family))),
        hardship_(options.hardship),
        rich_(options.richness == Richness::kRich ||
              (options.richness == Richness::kAny && random_.Uniform() < 0.6)) {}

  GeneratedRig Draw() {
    rig_.family = family_;
    DrawBody();
    DrawExperiments();
    DrawFriction();
    rig_.declared = rig_.truth;
    MeasureSignals();
    DrawWarming();
    if (rig_.logs_temperature) {
      MeasureWarmest();
      MeasureSignals();
    }
    Hide();
    Declare();
    if (options_.proposed) Propose(*options_.proposed);
    if (!options_.played.empty()) Play(options_.played);
    Record();
    return std::move(rig_);
  }

 private:
  bool arm() const { return family_ == Family::kArm; }
  int joints() const { return arm() ? 2 : 1; }

  void DrawBody() {
    Body& body = rig_.truth.body;
    body.slide = family_ == Family::kSlide;
    if (body.slide) {
      rig_.joint_names[0] = "slide";
      body.rise = random_.Uniform() < 0.5 ? 0 : 1;
      for (const std::string& effect : options_.effects) {
        if (Contains({"gravity_error", "encoder_offset", "encoder_gain", "motor_gain"}, effect))
          body.rise = 1;
      }
    }
    if (arm()) rig_.joint_names[0] = "shoulder";
    body.phase = body.slide || random_.Uniform() < 0.4 ? 0 : random_.Uniform(-2, 2);
    for (int i = 0; i < joints(); ++i) {
      Link link;
      link.mass = LogUniform(random_, 0.15, 6);
      link.com = random_.Uniform(0.06, 0.3);
      if (i == 1) link.mass = rig_.truth.body.links[0].mass * random_.Uniform(0.3, 0.8);
      link.length = link.com * random_.Uniform(1.3, 2);
      link.inertia = link.mass * link.com * link.com * random_.Uniform(0.05, 0.4);
      body.links.push_back(link);
    }
    for (int i = 0; i < joints(); ++i) {
      const Link& link = body.links[i];
      double inertia = body.slide ? link.mass : link.mass * link.com * link.com + link.inertia;
      if (arm() && i == 0)
        inertia += body.links[1].mass * std::pow(link.length + body.links[1].com, 2);
      Drive drive;
      drive.armature = inertia * random_.Uniform(0.05, 0.6);
      inertia += drive.armature;
      const double omega = 2 * M_PI * random_.Uniform(2.5, arm() ? 6 : 8);
      drive.kp = inertia * omega * omega;
      drive.kd = 2 * random_.Uniform(0.4, 0.9) * inertia * omega;
      drive.viscous = inertia * omega * random_.Uniform(0.01, 0.08);
      drive.reads_motor = random_.Uniform() < 0.3;
      rig_.truth.drives.push_back(drive);
      fastest_ = std::min(fastest_, omega / (2 * M_PI) / 2.5);
    }
  }

  void DrawExperiments() {
    constexpr double kRates[] = {100, 125, 200, 250, 500, 1000};
    rig_.rate_hz = kRates[random_.UniformInt(6)];
    if (rich_) rig_.rate_hz = std::max(200.0, rig_.rate_hz);
    const bool brief = options_.richness == Richness::kBrief;
    if (brief) rig_.rate_hz = 200;
    if (hardship_ == Hardship::kSlow) rig_.rate_hz = 50;
    rig_.logs_torque = hardship_ != Hardship::kNoTorque || family_ == Family::kTorque ||
                       family_ == Family::kInverse;
    const Body& body = rig_.truth.body;
    amplitude_ = body.slide ? random_.Uniform(0.05, 0.3) : random_.Uniform(0.4, 1.2);
    if (arm()) amplitude_ = std::min(amplitude_, 0.8);
    const double quiet = amplitude_ * LogUniform(random_, 1e-5, 2e-4);
    const double step = random_.Uniform() < 0.5 ? 0 : amplitude_ * LogUniform(random_, 2e-5, 4e-4);
    const int fit = brief ? 2 : rich_ ? 3 + random_.UniformInt(2) : 2 + random_.UniformInt(2);
    const int held_out = brief ? 1 : 1 + random_.UniformInt(2);
    const bool transfer = !brief && random_.Uniform() < 0.4;
    const Motion poor = static_cast<Motion>(random_.UniformInt(4));
    const bool by_torque = family_ == Family::kTorque;
    // Mostly as a controller does that runs with the log; else the servo sees a smooth command. A
    // torque that steps with the command cannot be compared with a motion row by row.
    const bool steps = hardship_ == Hardship::kRamped || hardship_ == Hardship::kResampled;
    const bool held =
        by_torque || (family_ != Family::kInverse && (random_.Uniform() < 0.75 || steps));
    rig_.commands_hold = held;
    for (int i = 0; i < fit + held_out + (transfer ? 1 : 0); ++i) {
      Experiment x;
      x.dt = 1 / rig_.rate_hz;
      x.duration = brief ? 8 : rich_ ? random_.Uniform(10, 16) : random_.Uniform(6, 10);
      x.noise = quiet;
      x.step = step;
      x.held = held;
      x.by_torque = by_torque;
      if (hardship_ == Hardship::kJitter) x.jitter = 3e-4;
      x.command_rows = steps && held ? 4 : 1;
      x.ramped_command = hardship_ == Hardship::kRamped;
      const bool other = i == fit + held_out;
      Motion motion = rich_ ? static_cast<Motion>((i + random_.UniformInt(2) * 4) % 5) : poor;
      if (brief) motion = family_ == Family::kTransmission ? Motion::kMultiSine : Motion::kMixed;
      if (family_ == Family::kTransmission && motion == Motion::kRamps) motion = Motion::kMoves;
      if (family_ == Family::kTransmission && motion == Motion::kMixed) motion = Motion::kChirp;
      for (int j = 0; j < joints(); ++j) {
        const double centre = other && !body.slide ? random_.Uniform(-0.5, 0.5) * amplitude_ : 0;
        x.references.push_back(Excitation::Draw(motion, amplitude_ * (other ? 0.6 : 1), centre,
                                                fastest_ * (other ? 0.7 : 1), x.duration, random_));
      }
      experiments_.push_back(std::move(x));
      rig_.logs.push_back({other ? "transfer" : i < fit ? "fit" : "held_out", "", {}});
    }
  }

  // Whether the joints' temperatures are logged: drawn apart, so that the rest of a rig is the same
  // with and without them. Each run begins the warmer the later it is.
  void DrawWarming() {
    RandomStream random(StreamKey("warming").With(static_cast<int64_t>(options_.seed)));
    const bool needed = Contains(options_.effects, "temperature_friction");
    if (family_ == Family::kTransmission || !(needed || random.Uniform() < 0.3)) return;
    rig_.logs_temperature = true;
    const double rise = random.Uniform(8, 25), share = random.Uniform(0.3, 0.6);
    for (size_t i = 0; i < experiments_.size(); ++i) {
      Experiment& x = experiments_[i];
      x.warming = rise / signals_[0].speed;
      x.warming_s = x.duration * random.Uniform(0.4, 0.8);
      x.warm_start = rise * (1 - std::pow(1 - share, static_cast<double>(i)));
    }
  }

  void MeasureWarmest() {
    for (size_t i = 0; i < experiments_.size(); ++i) {
      const Recording log = Perform(rig_.truth, experiments_[i], static_cast<int>(i));
      for (const JointChannels& joint : log.joints)
        warmest_ = std::max(warmest_, *std::max_element(joint.warmer.begin(), joint.warmer.end()));
    }
  }

  // Dry friction of the true machine; how it is declared comes later.
  void DrawFriction() {
    MeasureSignals();
    if (family_ == Family::kTransmission) return;
    bool dry = random_.Uniform() < 0.7;
    for (const std::string& effect : options_.effects) {
      if (NeedsFriction(effect)) dry = true;
      if (effect == "stribeck_friction" || effect == "presliding_hysteresis" ||
          effect == "thermal_friction")
        dry = false;
    }
    if (hardship_ == Hardship::kFrictionless) dry = false;
    if (!dry) return;
    for (int j = 0; j < joints(); ++j) {
      Drive& drive = rig_.truth.drives[j];
      drive.Fc = signals_[j].torque * random_.Uniform(0.06, 0.2);
      drive.Fs = drive.Fc * (random_.Uniform() < 0.5 ? 1 : random_.Uniform(1.1, 1.6));
      drive.vs = signals_[j].speed * random_.Uniform(0.05, 0.2);
    }
  }

  Recording Perform(const Machine& machine, const Experiment& x, int index) const {
    const RandomStream own(StreamKey("generated log")
                               .With(static_cast<int64_t>(options_.seed))
                               .With(static_cast<int64_t>(index)));
    return family_ == Family::kTransmission ? RunTransmission(machine, x, own)
                                            : Run(machine, x, own);
  }

  // Of the machine without hidden effects.
  void MeasureSignals() {
    Experiment quiet = experiments_[0];
    quiet.noise = quiet.step = 0;
    const Recording log = Perform(rig_.truth, quiet, 0);
    for (int j = 0; j < joints(); ++j) {
      const JointChannels& c = log.joints[j];
      Signals s;
      double torque2 = 0, speed2 = 0;
      s.peak_torque = s.peak_command_speed = 1e-12;
      for (size_t k = 1; k < c.q.size(); ++k) {
        torque2 += c.torque[k] * c.torque[k];
        s.peak_torque = std::max(s.peak_torque, std::abs(c.torque[k]));
        const double v = (c.q[k] - c.q[k - 1]) / quiet.dt;
        speed2 += v * v;
        s.peak_command_speed =
            std::max(s.peak_command_speed, std::abs(c.command[k] - c.command[k - 1]) / quiet.dt);
      }
      s.torque = std::sqrt(torque2 / static_cast<double>(c.q.size()));
      s.speed = std::sqrt(speed2 / static_cast<double>(c.q.size()));
      const auto [low, high] = std::minmax_element(c.q.begin(), c.q.end());
      s.range = (*high - *low) / 2;
      const Body& body = rig_.truth.body;
      s.holding = kGravity * body.links[j].mass * (body.slide ? body.rise : body.links[j].com);
      s.duration = quiet.duration;
      s.dt = quiet.dt;
      s.mass = body.links.back().mass;
      s.base_friction = rig_.truth.drives[j].Fc;
      s.viscous = rig_.truth.drives[j].viscous;
      s.warming = std::max(1.0, c.warmer.empty() ? 0 : c.warmer.back());
      s.warmest = std::max(s.warming, warmest_);
      signals_[j] = s;
    }
    for (int j = 0; j < 2 && arm(); ++j) {
      const std::vector<double>& q = log.joints[1 - j].clean;
      double acceleration2 = 0;
      for (size_t k = 1; k + 1 < q.size(); ++k)
        acceleration2 += std::pow((q[k + 1] - 2 * q[k] + q[k - 1]) / (quiet.dt * quiet.dt), 2);
      signals_[j].other_speed = signals_[1 - j].speed;
      signals_[j].other_acceleration = std::sqrt(acceleration2 / static_cast<double>(q.size()));
    }
  }

  void Hide() {
    const int first = arm() ? random_.UniformInt(2) : 0;
    for (const std::string& type : options_.effects) {
      const int joint = options_.apart && !rig_.truth.effects.empty() ? 1 - first : first;
      HiddenEffect effect = DrawEffect(type, options_.size, SignalsFor(type, joint), random_);
      effect.joint = joint;
      Harden(effect, signals_[joint]);
      if (type == "payload") {
        effect.joint = joints() - 1;
        rig_.truth.tip_mass = effect["mass"];
      }
      if (type == "base_tilt") rig_.truth.tilt = effect["y"];
      rig_.truth.effects.push_back(std::move(effect));
    }
  }

  // Effects that take friction away share what there is: together they leave some as well.
  Signals SignalsFor(const std::string& type, int joint) const {
    const auto takes = [](const std::string& effect) {
      return Contains({"asymmetric_coulomb", "asymmetric_viscous", "position_dependent_friction",
                       "time_drift_friction", "temperature_friction"},
                      effect);
    };
    Signals signals = signals_[joint];
    const auto all = std::count_if(options_.effects.begin(), options_.effects.end(), takes);
    if (takes(type) && all > 1 && !options_.apart) {
      signals.base_friction /= static_cast<double>(all);
      signals.viscous /= static_cast<double>(all);
    }
    return signals;
  }

  void Harden(HiddenEffect& effect, const Signals& signals) {
    auto& p = effect.parameters;
    if (hardship_ == Hardship::kLongWave && p.count("wavelength") > 0)
      p["wavelength"] = random_.Uniform(2.6, 5) * signals.range;
    if (hardship_ == Hardship::kCoulomb && p.count("Fs") > 0) p["Fs"] = p["Fc"];
    if (hardship_ == Hardship::kHarsh && p.count("rate") > 0) p["rate"] *= 0.4;
  }

  // What the rig says: true, or off by what its `fit` may move.
  void Declare() {
    Machine& told = rig_.declared;
    const bool stribeck_hidden = Contains(options_.effects, "stribeck_friction");
    bool curved = false;
    for (const Drive& drive : rig_.truth.drives) curved |= drive.Fs > drive.Fc;
    rig_.declares_dry_friction = rig_.truth.drives[0].Fc > 0 && (curved || random_.Uniform() < 0.5);
    rig_.friction_fit.resize(joints());
    for (int j = 0; j < joints(); ++j) {
      const Drive& is = rig_.truth.drives[j];
      Drive& said = told.drives[j];
      std::vector<std::string> fit;
      if (family_ != Family::kTransmission) {
        if (random_.Uniform() < 0.6) {
          fit.push_back("armature");
          said.armature *= random_.Uniform(0.6, 1.5);
        }
        if (rig_.declares_dry_friction) {
          std::vector<std::string> friction =
              random_.Uniform() < 0.7 ? std::vector<std::string>{"Fc", "Fs", "vs", "sigma_v"}
                                      : std::vector<std::string>{"Fc", "sigma_v"};
          if (!curved) friction = {"Fc", "Fs", "sigma_v"};
          for (const std::string& name : friction) {
            double& value = name == "Fc"   ? said.Fc
                            : name == "Fs" ? said.Fs
                            : name == "vs" ? said.vs
                                           : said.viscous;
            value *= random_.Uniform(0.7, 1.4);
          }
          if (said.Fs < said.Fc && !Contains(friction, "Fs")) friction.push_back("Fs");
          rig_.friction_fit[j] = std::move(friction);
          said.Fs = std::max(said.Fs, said.Fc);
        } else {
          if (is.Fc > 0) {
            fit.push_back("frictionloss");
            said.Fc *= random_.Uniform(0.7, 1.4);
          }
          if (stribeck_hidden || random_.Uniform() < 0.6) {
            fit.push_back("damping");
            said.viscous *= random_.Uniform(0.7, 1.4);
          }
        }
      }
      if (hardship_ == Hardship::kHarsh) {
        for (const char* name : {"damping", "torque_offset", "torque_gain", "servo.kd"})
          if (!Contains(fit, name) &&
              (name != std::string("damping") || !rig_.declares_dry_friction))
            fit.push_back(name);
      }
      rig_.fit.push_back(std::move(fit));
    }
    told.effects.clear();
    told.tip_mass = told.tilt = 0;
  }

  void Propose(const ProposedRun& run) {
    const auto log = static_cast<size_t>(run.log);
    Experiment x = experiments_[log];
    const int samples = 1000;
    for (Excitation& reference : x.references) {
      double middle = 0;
      for (int i = 0; i < samples; ++i) middle += reference.At(x.duration * i / samples) / samples;
      reference = reference.Changed(run.speed, run.size, middle);
    }
    x.duration = std::min(kLongestRun, x.duration / run.speed);
    experiments_.push_back(std::move(x));
    rig_.logs.push_back({"fit", OverridesOf(run.gain, run.mass), {}});
    changes_.resize(experiments_.size());
    changes_.back() = {run.gain, run.mass};
  }

  // Given motions for all that is fitted; what it is judged by stays.
  void Play(const std::vector<PlayedRun>& runs) {
    std::vector<Experiment> kept;
    std::vector<GeneratedRig::Log> logs;
    for (const PlayedRun& run : runs) {
      Experiment x = experiments_[0];
      x.references.clear();
      for (const std::vector<double>& q : run.q)
        x.references.push_back(Excitation::OfRows(q, x.dt));
      x.duration = static_cast<double>(run.q[0].size()) * x.dt;
      kept.push_back(std::move(x));
      logs.push_back({"fit", OverridesOf(run.gain, run.mass), {}});
      changes_.push_back({run.gain, run.mass});
    }
    for (size_t i = 0; i < experiments_.size(); ++i) {
      if (rig_.logs[i].role == "fit") continue;
      kept.push_back(experiments_[i]);
      logs.push_back(rig_.logs[i]);
    }
    experiments_ = std::move(kept);
    rig_.logs = std::move(logs);
  }

  std::string OverridesOf(double gain, double mass) const {
    std::vector<std::string> overrides;
    for (int j = 0; j < joints(); ++j) {
      const Drive& told = rig_.declared.drives[j];
      const std::string& name = rig_.joint_names[j];
      if (gain != 1 && family_ != Family::kTorque)
        overrides.push_back(absl::StrFormat("%s.servo.kp: %.10g, %s.servo.kd: %.10g", name,
                                            gain * told.kp, name, std::sqrt(gain) * told.kd));
      if (mass > 0) overrides.push_back(absl::StrFormat("%s.known_mass: %.10g", name, mass));
    }
    return absl::StrJoin(overrides, ", ");
  }

  // The machine as it is in a log.
  Machine MachineIn(size_t log) const {
    Machine machine = rig_.truth;
    if (log >= changes_.size()) return machine;
    for (Drive& drive : machine.drives) {
      drive.kp *= changes_[log].gain;
      drive.kd *= std::sqrt(changes_[log].gain);
    }
    machine.tip_mass += changes_[log].mass;
    return machine;
  }

  void Record() {
    for (size_t i = 0; i < experiments_.size(); ++i) {
      Experiment& x = experiments_[i];
      if (family_ == Family::kInverse || family_ == Family::kTransmission)
        x.torque_noise = 0.005 * signals_[0].torque;
      const RandomStream own(StreamKey("spoiled log")
                                 .With(static_cast<int64_t>(options_.seed))
                                 .With(static_cast<int64_t>(i)));
      rig_.logs[i].recording = Spoil(Perform(MachineIn(i), x, static_cast<int>(i)), hardship_, own);
    }
    MeasureVisibility();
    rig_.rate_hz = LoggedRate(hardship_, rig_.rate_hz);
  }

  void MeasureVisibility() {
    if (options_.effects.empty()) return;
    const Recording with = Perform(rig_.truth, experiments_[0], 0);
    Machine bare = rig_.truth;
    bare.effects.clear();
    bare.tip_mass = bare.tilt = 0;
    rig_.visibility = VisibilityBeside(bare, with);
    for (size_t i = 0; i < rig_.truth.effects.size(); ++i) {
      Machine less = rig_.truth;
      const HiddenEffect gone = less.effects[i];
      less.effects.erase(less.effects.begin() + static_cast<std::ptrdiff_t>(i));
      if (gone.type == "payload") less.tip_mass = 0;
      if (gone.type == "base_tilt") less.tilt = 0;
      rig_.visibility_of.push_back(VisibilityBeside(less, with));
    }
  }

  // Of what `less` lacks.
  double VisibilityBeside(const Machine& less, const Recording& with) const {
    double visibility = 0;
    const Recording without = Perform(less, experiments_[0], 0);
    const double noise = std::hypot(experiments_[0].noise, experiments_[0].step / std::sqrt(12.0));
    for (size_t j = 0; j < with.joints.size(); ++j) {
      const std::vector<double>&a = with.joints[j].clean, &b = without.joints[j].clean;
      double sum = 0;
      for (size_t k = 0; k < a.size(); ++k) sum += (a[k] - b[k]) * (a[k] - b[k]);
      visibility = std::max(visibility, std::sqrt(sum / static_cast<double>(a.size())) / noise);
    }
    return visibility;
  }

  const RigOptions& options_;
  Family family_;
  RandomStream random_;
  const Hardship hardship_;
  bool rich_;
  double fastest_ = 3, amplitude_ = 1;
  std::vector<Experiment> experiments_;
  Signals signals_[2];
  struct Change {
    double gain = 1, mass = 0;
  };
  std::vector<Change> changes_;  // of the first experiments
  double warmest_ = 0;           // [K] over cold, of all logs
  GeneratedRig rig_;
};

}  // namespace

absl::StatusOr<GeneratedRig> GenerateRig(const RigOptions& options) {
  std::vector<Family> families(std::begin(kFamilies), std::end(kFamilies));
  for (const std::string& effect : options.effects) {
    if (!Contains(LibraryEffects(), effect) && !Contains(OutsideEffects(), effect))
      return absl::NotFoundError(absl::StrCat(
          "effect '", effect, "' is unknown; known: ", absl::StrJoin(LibraryEffects(), ", "), ", ",
          absl::StrJoin(OutsideEffects(), ", ")));
    const std::vector<Family> own = FamiliesOf(effect);
    std::erase_if(families, [&](Family family) {
      return std::find(own.begin(), own.end(), family) == own.end();
    });
  }
  if (options.family != Family::kAny)
    std::erase_if(families, [&](Family family) { return family != options.family; });
  if (families.empty())
    return absl::InvalidArgumentError(absl::StrCat("no family shows ",
                                                   absl::StrJoin(options.effects, " and "), " in ",
                                                   FamilyName(options.family)));
  RandomStream choice(StreamKey("family")
                          .With(absl::StrJoin(options.effects, "+"))
                          .With(static_cast<int64_t>(options.seed)));
  // The plain servo is what most rigs are.
  const bool plain = choice.Uniform() < 0.4 && families.front() == Family::kServo;
  const Family family =
      plain ? Family::kServo : families[choice.UniformInt(static_cast<int>(families.size()))];
  return Drawer(options, family).Draw();
}

}  // namespace robostress::generator
