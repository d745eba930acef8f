#include "tests/calibration/generator/hidden_machine.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace robostress::generator {
namespace {

constexpr double kStep = 5e-5;  // [s]
constexpr double kLead = 1.0;   // [s] before the log

using Pair = std::array<double, 2>;

double SignOf(double x) { return (x > 0) - (x < 0); }

// M a + bias = torque, of one or two joints.
struct Equations {
  double m11 = 0, m12 = 0, m22 = 0;
  Pair bias{}, holding{};
};

Equations EquationsOf(const Machine& m, const Pair& q, const Pair& v) {
  Equations e;
  const Link& a = m.body.links[0];
  if (m.body.slide) {
    e.m11 = a.mass + m.tip_mass + m.drives[0].armature;
    e.holding[0] = a.mass * kGravity * m.body.rise;
    e.bias[0] = (a.mass + m.tip_mass) * kGravity * m.body.rise;
    return e;
  }
  const double down = q[0] + m.body.phase;
  if (m.drives.size() == 1) {
    e.m11 = a.inertia + a.mass * a.com * a.com + m.tip_mass * a.length * a.length +
            m.drives[0].armature;
    e.holding[0] = a.mass * a.com * kGravity * std::sin(down);
    e.bias[0] = (a.mass * a.com + m.tip_mass * a.length) * kGravity * std::sin(down + m.tilt);
    return e;
  }
  const Link& b = m.body.links[1];
  const double both = down + q[1];
  // First moment and inertia of the second link with the payload, about its joint.
  const double s2 = b.mass * b.com + m.tip_mass * b.length;
  const double i2 = b.inertia + b.mass * b.com * b.com + m.tip_mass * b.length * b.length;
  const double carried = b.mass + m.tip_mass, reach = s2 * a.length * std::cos(q[1]);
  e.m11 = a.inertia + a.mass * a.com * a.com + carried * a.length * a.length + i2 + 2 * reach +
          m.drives[0].armature;
  e.m12 = i2 + reach;
  e.m22 = i2 + m.drives[1].armature;
  const double c = -s2 * a.length * std::sin(q[1]);
  e.bias[0] = c * v[1] * (2 * v[0] + v[1]) +
              kGravity * ((a.mass * a.com + carried * a.length) * std::sin(down + m.tilt) +
                          s2 * std::sin(both + m.tilt));
  e.bias[1] = -c * v[0] * v[0] + kGravity * s2 * std::sin(both + m.tilt);
  e.holding[0] = kGravity * ((a.mass * a.com + b.mass * a.length) * std::sin(down) +
                             b.mass * b.com * std::sin(both));
  e.holding[1] = kGravity * b.mass * b.com * std::sin(both);
  return e;
}

// Effects on a command, one behind the other; each sees what the one before let through, now and
// earlier.
class CommandWay {
 public:
  using Sent = std::function<double(double)>;
  double Arrives(const std::vector<std::unique_ptr<Action>>& actions, double t, double h,
                 const Sent& sent) {
    if (past_.empty()) first_ = t;
    past_.resize(actions.size());
    Sent given = sent;
    double command = sent(t);
    for (size_t i = 0; i < actions.size(); ++i) {
      if (!actions[i]->Commands()) continue;
      command = actions[i]->Command(t, h, given);
      past_[i].push_back(command);
      given = [this, i, h](double at) {
        const auto k = static_cast<int64_t>(std::floor((at - first_) / h + 1e-6));
        return past_[i][std::clamp<int64_t>(k, 0, static_cast<int64_t>(past_[i].size()) - 1)];
      };
    }
    return command;
  }

 private:
  double first_ = 0;
  std::vector<std::vector<double>> past_;
};

// The machine in motion.
class Runner {
 public:
  Runner(const Machine& machine, const Experiment& experiment, const RandomStream& random)
      : m_(machine), x_(experiment), n_(static_cast<int>(machine.drives.size())) {
    RandomStream seeds = random;
    for (const HiddenEffect& effect : machine.effects) {
      const RandomStream own(StreamKey("effect").With(seeds.NextUint32()));
      if (auto action = MakeAction(effect, own))
        actions_[effect.joint].push_back(std::move(action));
    }
    for (int i = 0; i < n_; ++i) {
      q_[i] = x_.references[i].At(0);
      sent_[i] = x_.references[i].At(0);
    }
    if (x_.by_torque) sent_ = {0, 0};
    warmer_ = {x_.warm_start, x_.warm_start};
  }

  // What was sent at time t: a position, or a torque.
  double Sent(int i, double t) const {
    if (x_.by_torque) {
      const auto& rows = torque_rows_[i];
      const auto row = static_cast<long>(std::floor((t + kLead) / x_.dt + 1e-9));
      if (rows.empty()) return sent_[i];
      return rows[std::clamp<long>(row, 0, static_cast<long>(rows.size()) - 1)];
    }
    const double period = x_.dt * x_.command_rows;
    const double at = x_.held ? std::floor(t / period + 1e-9) * period : t;
    return x_.references[i].At(at);
  }

  void BeginRow(double t) {
    if (!x_.by_torque) return;
    for (int i = 0; i < n_; ++i) {
      const Drive& d = m_.drives[i];
      const double torque = d.kp * (x_.references[i].At(t) - ReadingOf(i)) - d.kd * v_[i];
      torque_rows_[i].push_back(std::clamp(torque, -d.limit, d.limit));
    }
  }

  void Step(double t, double h) {
    std::array<Instant, 2> now;
    for (int i = 0; i < n_; ++i) {
      arrived_[i] =
          ways_[i].Arrives(actions_[i], t, h, [this, i](double at) { return Sent(i, at); });
    }
    const Equations here = EquationsOf(m_, q_, v_);
    for (int i = 0; i < n_; ++i) {
      now[i] = {t,
                h,
                q_[i],
                v_[i],
                a_[i],
                MotorTorque(i, t, h, q_[i], v_[i]),
                here.holding[i],
                i == 0 ? here.m11 : here.m22,
                n_ == 2 ? q_[1 - i] : 0,
                n_ == 2 ? v_[1 - i] : 0,
                n_ == 2 ? a_[1 - i] : 0,
                warmer_[i]};
      warmer_[i] += h * (x_.warming * std::abs(v_[i]) - warmer_[i]) / x_.warming_s;
      for (auto& action : actions_[i]) action->Advance(now[i]);
      link_error_[i] = 0;
      for (auto& action : actions_[i]) link_error_[i] += action->LinkMinusMotor(now[i]);
    }
    const Pair first = Accelerations(t, h, q_, v_);
    Pair middle_q = q_, middle_v = v_;
    for (int i = 0; i < n_; ++i) {
      middle_q[i] += 0.5 * h * v_[i];
      middle_v[i] += 0.5 * h * first[i];
      if (middle_v[i] * v_[i] < 0) middle_v[i] = 0;
    }
    a_ = Accelerations(t, h, middle_q, middle_v);
    Pair stopped = v_;
    for (int i = 0; i < n_; ++i) {
      if ((v_[i] + h * a_[i]) * v_[i] < 0) stopped[i] = 0;
    }
    // What a joint does after it has come to rest within the step: stays, or turns.
    const Pair onward = stopped == v_ ? a_ : Accelerations(t, h, middle_q, stopped);
    for (int i = 0; i < n_; ++i) {
      if (stopped[i] == v_[i]) {
        q_[i] += h * middle_v[i];
        v_[i] += h * a_[i];
        continue;
      }
      const double stop = -v_[i] / a_[i], rest = h - stop;
      q_[i] += 0.5 * v_[i] * stop + 0.5 * onward[i] * rest * rest;
      v_[i] = onward[i] * rest;
    }
  }

  double warmer(int i) const { return warmer_[i]; }
  double ReadingOf(int i) const { return Read(i, q_[i] + link_error_[i]); }
  double velocity(int i) const { return v_[i]; }
  double asked(int i) const { return asked_[i]; }
  double sent_torque(int i) const { return torque_rows_[i].back(); }

 private:
  double Read(int i, double link) const {
    for (const auto& action : actions_[i]) link = action->Reading(link);
    return link;
  }

  double MotorTorque(int i, double t, double h, double q, double v) {
    const Drive& d = m_.drives[i];
    double torque = arrived_[i];
    if (!x_.by_torque) {
      const double seen = Read(i, d.reads_motor ? q : q + link_error_[i]);
      torque = std::clamp(d.kp * (arrived_[i] - seen) - d.kd * v, -d.limit, d.limit);
    }
    asked_[i] = torque;
    Instant now;
    now.t = t, now.h = h, now.q = q, now.v = v;
    for (auto& action : actions_[i]) torque = action->Motor(torque, now);
    return torque;
  }

  Pair Accelerations(double t, double h, const Pair& q, const Pair& v) {
    const Equations e = EquationsOf(m_, q, v);
    Pair push{}, forward{}, backward{};
    for (int i = 0; i < n_; ++i) {
      const Drive& d = m_.drives[i];
      Instant now = {t,
                     h,
                     q[i],
                     v[i],
                     a_[i],
                     MotorTorque(i, t, h, q[i], v[i]),
                     e.holding[i],
                     i == 0 ? e.m11 : e.m22,
                     n_ == 2 ? q[1 - i] : 0,
                     n_ == 2 ? v[1 - i] : 0,
                     n_ == 2 ? a_[1 - i] : 0,
                     warmer_[i]};
      push[i] = now.motor - e.bias[i] - d.viscous * v[i];
      const double fade = d.vs > 0 ? std::exp(-(v[i] / d.vs) * (v[i] / d.vs)) : 0;
      forward[i] = backward[i] = d.Fc + (std::max(d.Fs, d.Fc) - d.Fc) * fade;
      for (auto& action : actions_[i]) {
        push[i] += action->Torque(now);
        action->Rub(now, forward[i], backward[i]);
      }
      forward[i] = std::max(0.0, forward[i]);
      backward[i] = std::max(0.0, backward[i]);
    }
    // A joint at rest is held, or breaks away; the other one may change which.
    std::array<bool, 2> held{};
    Pair rub{};
    for (int i = 0; i < n_; ++i) {
      held[i] = v[i] == 0;
      rub[i] = v[i] > 0 ? -forward[i] : backward[i];
    }
    while (true) {
      Pair a{}, load = push;
      for (int i = 0; i < n_; ++i) {
        if (!held[i]) load[i] += rub[i];
      }
      if (n_ == 1) {
        a[0] = held[0] ? 0 : load[0] / e.m11;
      } else if (held[0] != held[1]) {
        a[0] = held[0] ? 0 : load[0] / e.m11;
        a[1] = held[1] ? 0 : load[1] / e.m22;
      } else if (!held[0]) {
        const double det = e.m11 * e.m22 - e.m12 * e.m12;
        a[0] = (e.m22 * load[0] - e.m12 * load[1]) / det;
        a[1] = (e.m11 * load[1] - e.m12 * load[0]) / det;
      }
      bool settled = true;
      for (int i = 0; i < n_ && settled; ++i) {
        if (!held[i]) continue;
        // What friction would have to give.
        const double needed = (n_ == 2 ? e.m12 * a[1 - i] : 0) - push[i];
        if (needed < -forward[i] || needed > backward[i]) {
          held[i] = false;
          rub[i] = needed < 0 ? -forward[i] : backward[i];
          settled = false;
        }
      }
      if (settled) return a;
    }
  }

  const Machine& m_;
  const Experiment& x_;
  int n_;
  std::vector<std::unique_ptr<Action>> actions_[2];
  CommandWay ways_[2];
  Pair q_{}, v_{}, a_{}, sent_{}, arrived_{}, link_error_{}, asked_{}, warmer_{};
  std::vector<double> torque_rows_[2];
};

// What a log says of the command of a row.
double LoggedCommand(const Experiment& x, int joint, double t) {
  const double period = x.dt * x.command_rows;
  if (x.command_rows == 1) return x.references[joint].At(t);
  const double at = std::floor(t / period + 1e-9) * period, share = (t - at) / period;
  const double now = x.references[joint].At(at);
  return x.ramped_command ? now + share * (x.references[joint].At(at + period) - now) : now;
}

double Measured(double value, const Experiment& x, RandomStream& random) {
  const double noisy = value + x.noise * random.Normal();
  return x.step > 0 ? x.step * std::round(noisy / x.step) : noisy;
}

}  // namespace

Recording Run(const Machine& machine, const Experiment& x, const RandomStream& random) {
  RandomStream noise = random;
  Runner runner(machine, x, random);
  const int rows = static_cast<int>(std::lround(x.duration / x.dt)),
            before = static_cast<int>(std::lround(kLead / x.dt)),
            steps = std::max(1, static_cast<int>(std::ceil(x.dt / kStep)));
  Recording log;
  log.joints.resize(machine.drives.size());
  for (int row = -before; row < rows; ++row) {
    const double t = row * x.dt;
    runner.BeginRow(t);
    for (size_t i = 0; i < machine.drives.size() && row >= 0; ++i) {
      JointChannels& joint = log.joints[i];
      const double reading = runner.ReadingOf(static_cast<int>(i));
      joint.command.push_back(LoggedCommand(x, static_cast<int>(i), t));
      const double moved =
          x.jitter > 0 ? runner.velocity(static_cast<int>(i)) * x.jitter * noise.Normal() : 0;
      joint.q.push_back(Measured(reading + moved, x, noise));
      const double torque =
          x.by_torque ? runner.sent_torque(static_cast<int>(i)) : runner.asked(static_cast<int>(i));
      joint.torque.push_back(torque + x.torque_noise * noise.Normal());
      joint.clean.push_back(reading);
      joint.warmer.push_back(runner.warmer(static_cast<int>(i)));
    }
    if (row >= 0) log.t.push_back(t);
    for (int k = 0; k < steps; ++k) runner.Step(t + k * x.dt / steps, x.dt / steps);
  }
  return log;
}

Recording RunTransmission(const Machine& machine, const Experiment& x, const RandomStream& random) {
  RandomStream noise = random;
  std::vector<std::unique_ptr<Action>> actions;
  for (const HiddenEffect& effect : machine.effects)
    actions.push_back(MakeAction(effect, RandomStream(StreamKey("transmission"))));
  const int rows = static_cast<int>(std::lround(x.duration / x.dt)),
            before = static_cast<int>(std::lround(kLead / x.dt)),
            steps = std::max(1, static_cast<int>(std::ceil(x.dt / kStep)));
  const double h = x.dt / steps;
  const Drive& d = machine.drives[0];
  Recording log;
  log.joints.resize(1);
  const std::function<double(double)> reference = [&](double at) { return x.references[0].At(at); };
  CommandWay way;
  for (long k = -static_cast<long>(before) * steps; k < static_cast<long>(rows) * steps; ++k) {
    const double t = static_cast<double>(k) * h, e = 1e-3;
    // Commands act on the way to the link's encoder.
    const double seen = way.Arrives(actions, t, h, reference);
    const double q = reference(t), v = (reference(t + e) - reference(t - e)) / (2 * e);
    const double a = (reference(t + e) - 2 * q + reference(t - e)) / (e * e);
    const Equations eq = EquationsOf(machine, {q, 0}, {v, 0});
    Instant now = {t, h, seen, v, a, 0, eq.holding[0], eq.m11, 0};
    now.motor = eq.m11 * a + eq.bias[0] + d.viscous * v + d.Fc * SignOf(v);
    double link = seen;
    for (auto& action : actions) {
      action->Advance(now);
      link += action->LinkMinusMotor(now);
    }
    for (auto& action : actions) link = action->Reading(link);
    if (k < 0 || k % steps != 0) continue;
    JointChannels& joint = log.joints[0];
    log.t.push_back(t);
    joint.clean.push_back(link);
    joint.command.push_back(q);
    joint.motor.push_back(Measured(q, x, noise));
    joint.q.push_back(Measured(link, x, noise));
    joint.torque.push_back(now.motor + x.torque_noise * noise.Normal());
  }
  return log;
}

}  // namespace robostress::generator
