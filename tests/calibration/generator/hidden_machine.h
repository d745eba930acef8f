#pragma once

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "tests/calibration/generator/generated_motion.h"
#include "tests/calibration/generator/hidden_effect.h"

namespace robostress::generator {

inline constexpr double kGravity = 9.81;  // [m/s^2]

// A rigid link that turns about y (or, of a slide, moves along its axis).
struct Link {
  double mass = 1;      // [kg]
  double com = 0.2;     // [m] from the joint to the centre of mass
  double inertia = 0;   // [kg m^2] about the centre of mass
  double length = 0.3;  // [m] to the next joint, or to the tip
};

// A pendulum, a slide, or a planar arm of two links, that hangs down at q = -phase.
struct Body {
  bool slide = false;
  double rise = 0;   // of a slide: share of gravity along its axis
  double phase = 0;  // [rad] of a hinge: from straight down, at q = 0
  std::vector<Link> links;
};

// One driven joint as it really is.
struct Drive {
  double armature = 0;              // [kg m^2]
  double viscous = 0;               // [Nm s/rad]
  double Fc = 0, Fs = 0, vs = 0.1;  // dry friction: kinetic, static [Nm], Stribeck speed
  double kp = 0, kd = 0;            // servo [Nm/rad, Nm s/rad]
  double limit = std::numeric_limits<double>::infinity();  // [Nm]
  bool reads_motor = false;  // side of the transmission that the servo reads
};

struct Machine {
  Body body;
  std::vector<Drive> drives;
  std::vector<HiddenEffect> effects;
  double tip_mass = 0;  // [kg] added at the tip: a payload
  double tilt = 0;      // [rad] of the base about y
};

// How a machine is moved and read.
struct Experiment {
  double dt = 0.005;     // [s] of rows
  double duration = 10;  // [s]
  bool held = true;      // commands hold over a row; else the servo sees them continuously
  bool by_torque =
      false;         // the servo is software that runs once a row, and its torque is the command
  double noise = 0;  // [rad] of readings, standard deviation
  double step = 0;   // [rad] of an encoder; 0: none
  double torque_noise = 0;
  // A joint that moves at v goes towards `warming` |v| over cold with time constant warming_s.
  double warming = 0, warming_s = 1, warm_start = 0;  // [K s/rad, s, K]
  std::vector<Excitation> references;                 // per joint
  double jitter = 0;  // [s] of the moments at which rows are read, standard deviation; not logged
  int command_rows = 1;         // rows over which a held command stays
  bool ramped_command = false;  // the log draws lines between the commands that were held
};

// Rows of a log; clean: q without noise.
struct JointChannels {
  std::vector<double> command, q, motor, torque, clean, warmer;
};
struct Recording {
  std::vector<double> t;
  std::vector<JointChannels> joints;
};

// Explicit midpoint steps of at most 50 us. A joint that comes to rest within a step stays there
// while static friction holds it. Begins at rest one second before the log.
Recording Run(const Machine& machine, const Experiment& experiment, const RandomStream& random);

// The other way round, for a rig with two encoders: the motor follows its reference exactly, torque
// is what that takes, and the link is where the transmission leaves it.
Recording RunTransmission(const Machine& machine, const Experiment& experiment,
                          const RandomStream& random);

}  // namespace robostress::generator
