#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/measured_log.h"
#include "calibration/data/rig.h"
#include "common/models/model_table.h"

namespace robostress::calibration {

// A term of one joint's equation of motion as a function of its own position: exact for the only
// joint of a model, a cos q + b sin q + c; of an arm the value and slope at the measured posture.
struct PlantTerm {
  double a = 0, b = 0, c = 0;
};

// M ddq + bias = tau of one joint [kg m^2, Nm] at one row of a log.
struct PlantRow {
  double q_ref = 0;            // [rad] where the terms of an arm were taken
  double inertia = 0;          // without armature [kg m^2]
  double coupling = 0;         // Coriolis and what the other joints' accelerations ask for [Nm]
  double coupling_rise = 0;    // until the next row, of that and of gravity, as a line [Nm]
  PlantTerm gravity;           // [Nm]
  PlantTerm payload_gravity;   // [Nm/kg] of 1 kg at the payload's place
  double payload_inertia = 0;  // [kg m^2/kg]
  std::array<PlantTerm, 2> tilt_gravity;  // [Nm/rad] of a base that tilts about x, y
};

// Passive properties that the model gives a joint.
struct PlantPassive {
  double armature = 0;      // [kg m^2]
  double damping = 0;       // [Nm s/rad]
  double frictionloss = 0;  // [Nm]
  double stiffness = 0;     // [Nm/rad]
  double spring_rest = 0;   // [rad]
};

// Rigid-body terms of a rig's model, from MuJoCo. The payload's place is the site (of a URDF the
// link) named payload, tip, tool or end_effector, or else the centre of mass of the last body that
// the joint moves.
// A joint alone in its model has one row; in an arm the other joints move as measured, and there is
// a row per log row.
class Plant {
 public:
  // Errors name the file, the joint, and what MuJoCo said. A joint that moves less than 1e-9 kg m^2
  // (or kg) and has no armature is refused.
  static absl::StatusOr<std::unique_ptr<Plant>> Load(const Rig& rig);
  virtual ~Plant() = default;

  virtual bool single() const = 0;  // one row serves every moment
  virtual PlantPassive passive(int joint) const = 0;
  virtual bool hinge(int joint) const = 0;
  // [rad] between the joint's stops, 0: it has none.
  virtual double travel(int joint) const = 0;
  // What the model's file says that a joint's drive can do [Nm]; infinite: nothing.
  virtual double effort_limit(int joint) const = 0;
  // What was read of the model and what was assumed, of the whole and of every joint of the rig.
  virtual const std::vector<ModelFact>& facts() const = 0;
  // Rows of joint `joint` of the rig along a log. Of an arm they are taken where the arm is halfway
  // to the next row, because a row's torque acts until then; of input inverse at the row.
  virtual std::vector<PlantRow> Rows(int joint, const MeasuredLog& log) const = 0;
};

// Value of a term at q.
inline double Evaluate(const PlantTerm& term, bool single, double cos_q, double sin_q, double q,
                       double q_ref) {
  return single ? term.a * cos_q + term.b * sin_q + term.c : term.c + term.b * (q - q_ref);
}

}  // namespace robostress::calibration
