#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/random.h"

namespace robostress::generator {

// An effect that a machine has. Whether a rig declares it is not its business.
struct HiddenEffect {
  std::string type;
  int joint = 0;
  std::map<std::string, double> parameters;
  double operator[](const std::string& name) const { return parameters.at(name); }
};

// What an effect sees of its joint at an instant; of a slide m, N, kg.
struct Instant {
  double t = 0, h = 0;         // [s] time, step of the integrator
  double q = 0, v = 0, a = 0;  // motor side [rad, rad/s, rad/s^2], a of the step before
  double motor = 0;            // torque of the motor [Nm]
  double holding = 0;          // torque that would hold the joint still [Nm]
  double inertia = 0;          // [kg m^2]
  double other_q = 0, other_v = 0, other_a = 0;  // of the other joint [rad, rad/s, rad/s^2]
  double warmer = 0;                             // than it was cold [K]
};

// How an effect acts. Advance is called once per step, the others as often as the integrator asks.
class Action {
 public:
  virtual ~Action() = default;
  virtual void Advance(const Instant&) {}
  // Whether it changes commands.
  virtual bool Commands() const { return false; }
  // The command that arrives at t; `given` is the one that was sent at a time.
  virtual double Command(double t, double h, const std::function<double(double)>& given) {
    (void)h;
    return given(t);
  }
  virtual double Motor(double torque, const Instant&) { return torque; }
  virtual double Torque(const Instant&) { return 0; }
  // Adds to dry friction forwards and backwards [Nm].
  virtual void Rub(const Instant&, double&, double&) {}
  virtual double LinkMinusMotor(const Instant&) { return 0; }
  virtual double Reading(double link) { return link; }
};

// Effects that RoboStress knows by name, and effects that it does not.
const std::vector<std::string>& LibraryEffects();
const std::vector<std::string>& OutsideEffects();
// Names of the library under which an outside effect may be reported without being wrong: its
// leading term is that effect.
std::vector<std::string> NearEffects(const std::string& outside);

// payload and base_tilt change the body (see Machine) and have no action: null.
std::unique_ptr<Action> MakeAction(const HiddenEffect& effect, const RandomStream& random);

// Typical sizes of the machine's signals without the effect, from which sizes are drawn.
struct Signals {
  double torque = 1, peak_torque = 1;              // rms and largest [Nm]
  double range = 1;                                // half of the way travelled [rad]
  double speed = 1;                                // rms [rad/s]
  double peak_command_speed = 1;                   // [rad/s]
  double holding = 0;                              // largest [Nm]
  double duration = 10;                            // of a log [s]
  double dt = 0.005;                               // of a row [s]
  double mass = 1;                                 // of the last link [kg]
  double base_friction = 0;                        // smallest dry friction [Nm]
  double viscous = 0;                              // of the drive [Nm s/rad]
  double warming = 1;                              // at the end of a log [K]
  double warmest = 1;                              // of all logs [K]
  double other_speed = 1, other_acceleration = 1;  // of the other joint, rms [rad/s, rad/s^2]
};

enum class Size { kSmall, kMedium, kLarge };

HiddenEffect DrawEffect(const std::string& type, Size size, const Signals& signals,
                        RandomStream& random);

}  // namespace robostress::generator
