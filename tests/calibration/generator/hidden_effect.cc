#include "tests/calibration/generator/hidden_effect.h"

#include <algorithm>
#include <cmath>

#include "common/check.h"

namespace robostress::generator {
namespace {

double SignOf(double x) { return (x > 0) - (x < 0); }

struct Stribeck : Action {
  explicit Stribeck(const HiddenEffect& e) : e(e) {}
  double Torque(const Instant& now) override { return -e["sigma_v"] * now.v; }
  void Rub(const Instant& now, double& forward, double& backward) override {
    const double fade = std::exp(-std::pow(now.v / e["vs"], 2));
    forward += e["Fc"] * (1 - fade) + e["Fs"] * fade;
    backward += e["Fc"] * (1 - fade) + e["Fs"] * fade;
  }
  HiddenEffect e;
};

// Dry friction that is a function of the instant, forwards and backwards.
struct Rubbing : Action {
  using Law = std::function<std::pair<double, double>(const Instant&)>;
  explicit Rubbing(Law law) : law(std::move(law)) {}
  void Rub(const Instant& now, double& forward, double& backward) override {
    const auto [f, b] = law(now);
    forward += f;
    backward += b;
  }
  Law law;
};

struct Pushing : Action {
  using Law = std::function<double(const Instant&)>;
  explicit Pushing(Law law) : law(std::move(law)) {}
  double Torque(const Instant& now) override { return law(now); }
  Law law;
};

struct Driving : Action {
  using Law = std::function<double(double, const Instant&)>;
  explicit Driving(Law law) : law(std::move(law)) {}
  double Motor(double torque, const Instant& now) override { return law(torque, now); }
  Law law;
};

struct Commanding : Action {
  using Given = std::function<double(double)>;
  using Law = std::function<double(double, double, const Given&)>;
  explicit Commanding(Law law) : law(std::move(law)) {}
  bool Commands() const override { return true; }
  double Command(double t, double h, const Given& given) override { return law(t, h, given); }
  Law law;
};

struct Reader : Action {
  explicit Reader(std::function<double(double)> law) : law(std::move(law)) {}
  double Reading(double link) override { return law(link); }
  std::function<double(double)> law;
};

struct LinkError : Action {
  using Law = std::function<double(const Instant&)>;
  explicit LinkError(Law law) : law(std::move(law)) {}
  double LinkMinusMotor(const Instant& now) override { return law(now); }
  Law law;
};

// Friction of a lubricant that warms, dry and viscous.
struct Warm : Action {
  explicit Warm(const HiddenEffect& e) : e(e) {}
  double Torque(const Instant& now) override { return -e["v"] * now.warmer * now.v; }
  void Rub(const Instant& now, double& forward, double& backward) override {
    forward += e["c"] * now.warmer;
    backward += e["c"] * now.warmer;
  }
  HiddenEffect e;
};

// A belt that another joint drives pulls at this one, and shakes its friction.
struct Crossed : Action {
  explicit Crossed(const HiddenEffect& e) : e(e) {}
  double Torque(const Instant& now) override {
    return -e["F"] * SignOf(now.other_v) - e["d"] * now.other_v;
  }
  void Rub(const Instant& now, double& forward, double& backward) override {
    forward += e["c"] * std::abs(now.other_v);
    backward += e["c"] * std::abs(now.other_v);
  }
  HiddenEffect e;
};

// A gear that turns with this joint plus n times another one: part F of its dry friction follows
// the faster of the two.
struct SharedGear : Action {
  explicit SharedGear(const HiddenEffect& e) : F(e["F"]), n(e["n"]) {}
  bool Dragged(const Instant& now) const { return std::abs(n * now.other_v) > std::abs(now.v); }
  double Torque(const Instant& now) override {
    return Dragged(now) ? -F * SignOf(n * now.other_v) : 0;
  }
  void Rub(const Instant& now, double& forward, double& backward) override {
    if (!Dragged(now)) return;
    forward -= F;
    backward -= F;
  }
  double F, n;
};

// Dahl's bristle: dz/dt = v / x_s (1 - z sgn v).
struct Bristle : Action {
  explicit Bristle(const HiddenEffect& e) : F(e["F"]), x_s(e["x_s"]) {}
  void Advance(const Instant& now) override {
    z = std::clamp(z + now.h * now.v / x_s * (1 - z * SignOf(now.v)), -1.0, 1.0);
  }
  double Torque(const Instant&) override { return -F * z; }
  double F, x_s, z = 0;
};

// Play: the link stays where it is while the motor is within B of it.
struct Play : Action {
  explicit Play(double B) : B(B) {}
  void Advance(const Instant& now) override {
    if (!started) link = now.q;
    started = true;
    link = std::clamp(link, now.q - B, now.q + B);
  }
  double LinkMinusMotor(const Instant& now) override { return link - now.q; }
  double B, link = 0;
  bool started = false;
};

// K x + D x' + m x'' = -motor torque, semi-implicit.
struct Springy : Action {
  Springy(double K, double frequency, double zeta)
      : K(K), w(2 * M_PI * frequency), D(2 * zeta * K / w), m(K / (w * w)) {}
  void Advance(const Instant& now) override {
    if (!started) x = -now.motor / K;
    started = true;
    rate += now.h * (-now.motor - K * x - D * rate) / m;
    x += now.h * rate;
  }
  double LinkMinusMotor(const Instant&) override { return x; }
  double K, w, D, m, x = 0, rate = 0;
  bool started = false;
};

// A second mass on a soft shaft, with its reaction on the first.
struct SecondMass : Action {
  SecondMass(double share, double frequency, double zeta)
      : share(share), w(2 * M_PI * frequency), zeta(zeta) {}
  void Advance(const Instant& now) override {
    shaft = w * w * x + 2 * zeta * w * rate;  // per inertia of the second mass
    rate += now.h * (-shaft - now.a);
    x += now.h * rate;
  }
  double Torque(const Instant& now) override { return share * now.inertia * (shaft + now.a); }
  double LinkMinusMotor(const Instant&) override { return x; }
  double share, w, zeta, shaft = 0, x = 0, rate = 0;
};

struct Lag : Action {
  explicit Lag(double tau) : tau(tau) {}
  bool Commands() const override { return true; }
  double Command(double t, double h, const std::function<double(double)>& given) override {
    if (!started) value = given(t);
    started = true;
    value += (given(t) - value) * h / (tau + h);
    return value;
  }
  double tau, value = 0;
  bool started = false;
};

struct Slew : Action {
  explicit Slew(double rate) : rate(rate) {}
  bool Commands() const override { return true; }
  double Command(double t, double h, const std::function<double(double)>& given) override {
    if (!started) value = given(t);
    started = true;
    const double gap = given(t) - value, most = rate * h;
    value += std::abs(gap) <= most ? gap : SignOf(gap) * most;
    return value;
  }
  double rate, value = 0;
  bool started = false;
};

// Sticks the more, the longer the joint has dwelt near a place.
struct HotSpot : Action {
  explicit HotSpot(const HiddenEffect& e) : e(e) {}
  void Advance(const Instant& now) override {
    near = std::exp(-std::pow((now.q - e["q"]) / e["width"], 2));
    age += now.h * (near * (1 - age) / e["growth_s"] - (1 - near) * age / e["decay_s"]);
  }
  void Rub(const Instant&, double& forward, double& backward) override {
    forward += e["F"] * near * age;
    backward += e["F"] * near * age;
  }
  HiddenEffect e;
  double near = 0, age = 0;
};

// Larger while speed grows than while it falls, by the sign of a smoothed acceleration.
struct SpeedingFriction : Action {
  SpeedingFriction(double F, double memory) : F(F), memory(memory) {}
  void Advance(const Instant& now) override { a += (now.a - a) * now.h / (memory + now.h); }
  void Rub(const Instant& now, double& forward, double& backward) override {
    const double gain = F * std::tanh(5 * a * SignOf(now.v) / (std::abs(now.v) + 0.05) * memory);
    forward += gain;
    backward += gain;
  }
  double F, memory, a = 0;
};

struct RandomWalk : Action {
  RandomWalk(double size, double memory, const RandomStream& random)
      : size(size), memory(memory), random(random) {}
  void Advance(const Instant& now) override {
    torque += -torque * now.h / memory + size * std::sqrt(2 * now.h / memory) * random.Normal();
  }
  double Torque(const Instant&) override { return torque; }
  double size, memory, torque = 0;
  RandomStream random;
};

// The link slips by a step when the motor pulls hard, at random.
struct Slipping : Action {
  Slipping(const HiddenEffect& e, const RandomStream& random) : e(e), random(random) {}
  void Advance(const Instant& now) override {
    if (now.t < 0 || std::abs(now.motor) < e["torque"]) return;
    if (random.Uniform() < e["per_second"] * now.h) offset -= SignOf(now.motor) * e["step"];
  }
  double LinkMinusMotor(const Instant&) override { return offset; }
  HiddenEffect e;
  RandomStream random;
  double offset = 0;
};

// Lubricant warmed by what friction burns: dry friction that falls exponentially.
struct Thermal : Action {
  explicit Thermal(const HiddenEffect& e) : e(e) {}
  void Advance(const Instant& now) override {
    warmth += now.h * (std::abs(now.v) / e["speed"] - warmth) / e["time_s"];
  }
  void Rub(const Instant&, double& forward, double& backward) override {
    forward += e["F"] * std::exp(-e["per_warmth"] * warmth);
    backward += e["F"] * std::exp(-e["per_warmth"] * warmth);
  }
  HiddenEffect e;
  double warmth = 0;
};

// A delay drawn anew for every sample.
struct Jitter : Action {
  Jitter(double mean, double spread, const RandomStream& random)
      : mean(mean), spread(spread), random(random) {}
  bool Commands() const override { return true; }
  double Command(double t, double h, const std::function<double(double)>& given) override {
    if (t >= next) {
      delay = std::max(0.0, mean + spread * (2 * random.Uniform() - 1));
      next = t + std::max(h, mean);
    }
    return given(t - delay);
  }
  double mean, spread, delay = 0, next = -1e9;
  RandomStream random;
};

double Wave(const HiddenEffect& e, double q) {
  const double phase = 2 * M_PI * q / e["wavelength"];
  return e["a"] * std::cos(phase) + e["b"] * std::sin(phase);
}

using Maker = std::function<std::unique_ptr<Action>(const HiddenEffect&, const RandomStream&)>;

template <class A, class Law>
Maker Simple(Law law) {
  return [law](const HiddenEffect& e, const RandomStream&) -> std::unique_ptr<Action> {
    return std::make_unique<A>(law(e));
  };
}

const std::map<std::string, Maker>& Makers() {
  using E = const HiddenEffect&;
  using I = const Instant&;
  using Given = Commanding::Given;
  static const auto& makers = *new std::map<std::string, Maker>{
      {"stribeck_friction", Simple<Stribeck>([](E e) { return e; })},
      {"asymmetric_coulomb",
       Simple<Rubbing>([](E e) { return [e](I) { return std::pair(e["dFc"], -e["dFc"]); }; })},
      {"asymmetric_viscous",
       Simple<Pushing>([](E e) { return [e](I now) { return -e["d_sigma"] * std::abs(now.v); }; })},
      {"load_dependent_friction", Simple<Rubbing>([](E e) {
         return [e](I now) {
           return std::pair(e["mu"] * std::abs(now.motor), e["mu"] * std::abs(now.motor));
         };
       })},
      {"gravity_dependent_friction", Simple<Rubbing>([](E e) {
         return [e](I now) {
           const double rub = e["mu"] * std::abs(now.holding);
           return std::pair(rub, rub);
         };
       })},
      {"temperature_friction", Simple<Warm>([](E e) { return e; })},
      {"cross_joint_friction", Simple<Crossed>([](E e) { return e; })},
      {"cross_joint_rubbing", Simple<SharedGear>([](E e) { return e; })},
      {"cross_joint_inertia",
       Simple<Pushing>([](E e) { return [e](I now) { return -e["J"] * now.other_a; }; })},
      {"quadratic_viscous_friction", Simple<Pushing>([](E e) {
         return [e](I now) { return -e["c2"] * now.v * std::abs(now.v); };
       })},
      {"time_drift_friction", Simple<Rubbing>([](E e) {
         return [e](I now) {
           const double grown = e["rate"] * std::max(0.0, now.t);
           return std::pair(grown, grown);
         };
       })},
      {"presliding_hysteresis", Simple<Bristle>([](E e) { return e; })},
      {"position_dependent_friction", Simple<Rubbing>([](E e) {
         return [e](I now) { return std::pair(Wave(e, now.q), Wave(e, now.q)); };
       })},
      {"gravity_error",
       Simple<Pushing>([](E e) { return [e](I now) { return e["beta"] * now.holding; }; })},
      {"position_periodic_torque",
       Simple<Pushing>([](E e) { return [e](I now) { return Wave(e, now.q); }; })},
      {"position_dependent_torque", Simple<Pushing>([](E e) {
         return [e](I now) {
           return e["c1"] * now.q + e["c2"] * now.q * now.q + e["c3"] * std::pow(now.q, 3);
         };
       })},
      {"cable_spring",
       Simple<Pushing>([](E e) { return [e](I now) { return e["k"] * (e["q0"] - now.q); }; })},
      {"cross_joint_coupling",
       Simple<Pushing>([](E e) { return [e](I now) { return -e["k"] * now.other_q; }; })},
      {"transmission_error",
       Simple<LinkError>([](E e) { return [e](I now) { return Wave(e, now.q); }; })},
      {"backlash", Simple<Play>([](E e) { return e["B"]; })},
      {"compliance",
       Simple<Springy>([](E e) { return Springy(e["K"], e["frequency"], e["zeta"]); })},
      {"encoder_gain", Simple<Reader>([](E e) {
         return [e](double link) { return (1 + e["gain_error"]) * link; };
       })},
      {"encoder_offset",
       Simple<Reader>([](E e) { return [e](double link) { return link + e["offset"]; }; })},
      {"encoder_eccentricity", Simple<Reader>([](E e) {
         return [e](double link) {
           return link + std::hypot(e["a"], e["b"]) * std::cos(link - std::atan2(e["b"], e["a"]));
         };
       })},
      {"transport_delay", Simple<Commanding>([](E e) {
         return [e](double t, double, const Given& given) { return given(t - e["delay_s"]); };
       })},
      {"servo_lag", Simple<Lag>([](E e) { return e["tau_s"]; })},
      {"rate_limit", Simple<Slew>([](E e) { return e["rate"]; })},
      {"torque_saturation", Simple<Driving>([](E e) {
         return [e](double torque, I) {
           return std::abs(torque) <= e["limit"] ? torque : SignOf(torque) * e["limit"];
         };
       })},
      {"deadzone", Simple<Driving>([](E e) {
         return [e](double torque, I) {
           return std::abs(torque) <= e["width"] ? 0 : torque - SignOf(torque) * e["width"];
         };
       })},
      {"motor_gain", Simple<Driving>([](E e) {
         return [e](double torque, I) { return torque + e["gain_error"] * torque; };
       })},
      {"time_varying_gain", Simple<Driving>([](E e) {
         return
             [e](double torque, I now) { return torque * (1 + e["rate"] * std::max(0.0, now.t)); };
       })},
      // Outside the library.
      {"dwell_hot_spot", Simple<HotSpot>([](E e) { return e; })},
      {"speeding_friction",
       [](E e, const RandomStream&) {
         return std::make_unique<SpeedingFriction>(e["F"], e["memory_s"]);
       }},
      {"current_ripple", Simple<Driving>([](E e) {
         return [e](double torque, I now) { return torque * (1 + Wave(e, now.q)); };
       })},
      {"second_mass",
       [](E e, const RandomStream&) {
         return std::make_unique<SecondMass>(e["share"], e["frequency"], e["zeta"]);
       }},
      {"random_walk_torque",
       [](E e, const RandomStream& random) {
         return std::make_unique<RandomWalk>(e["size"], e["memory_s"], random);
       }},
      {"quantised_command", Simple<Commanding>([](E e) {
         return [e](double t, double, const Given& given) {
           return e["step"] * std::round(given(t) / e["step"]);
         };
       })},
      {"intermittent_slip",
       [](E e, const RandomStream& random) { return std::make_unique<Slipping>(e, random); }},
      {"thermal_friction", Simple<Thermal>([](E e) { return e; })},
      {"delay_jitter",
       [](E e,
          const RandomStream&
              random) { return std::make_unique<Jitter>(e["mean_s"], e["spread_s"], random); }},
  };
  return makers;
}

}  // namespace

const std::vector<std::string>& LibraryEffects() {
  static const auto& names = *new std::vector<std::string>{"stribeck_friction",
                                                           "asymmetric_coulomb",
                                                           "asymmetric_viscous",
                                                           "load_dependent_friction",
                                                           "gravity_dependent_friction",
                                                           "quadratic_viscous_friction",
                                                           "time_drift_friction",
                                                           "temperature_friction",
                                                           "presliding_hysteresis",
                                                           "position_dependent_friction",
                                                           "gravity_error",
                                                           "payload",
                                                           "position_periodic_torque",
                                                           "position_dependent_torque",
                                                           "cable_spring",
                                                           "transmission_error",
                                                           "backlash",
                                                           "compliance",
                                                           "encoder_gain",
                                                           "encoder_offset",
                                                           "encoder_eccentricity",
                                                           "transport_delay",
                                                           "servo_lag",
                                                           "rate_limit",
                                                           "torque_saturation",
                                                           "deadzone",
                                                           "cross_joint_coupling",
                                                           "cross_joint_friction",
                                                           "cross_joint_rubbing",
                                                           "cross_joint_inertia",
                                                           "base_tilt",
                                                           "time_varying_gain",
                                                           "motor_gain"};
  return names;
}

const std::vector<std::string>& OutsideEffects() {
  static const auto& names =
      *new std::vector<std::string>{"dwell_hot_spot",    "speeding_friction",  "current_ripple",
                                    "second_mass",       "random_walk_torque", "quantised_command",
                                    "intermittent_slip", "thermal_friction",   "delay_jitter"};
  return names;
}

std::vector<std::string> NearEffects(const std::string& outside) {
  if (outside == "second_mass") return {"compliance"};
  if (outside == "thermal_friction") return {"time_drift_friction"};
  if (outside == "delay_jitter") return {"transport_delay", "servo_lag"};
  return {};
}

std::unique_ptr<Action> MakeAction(const HiddenEffect& effect, const RandomStream& random) {
  if (effect.type == "payload" || effect.type == "base_tilt") return nullptr;
  const auto found = Makers().find(effect.type);
  RS_CHECK(found != Makers().end());
  return found->second(effect, random);
}

}  // namespace robostress::generator
