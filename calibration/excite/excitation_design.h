#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "calibration/excite/arm_space.h"
#include "calibration/excite/joint_way.h"
#include "calibration/excite/sensitivities.h"

namespace robostress::calibration {

struct DesignOptions {
  double seconds = 60;      // of the motion
  double piece_s = 0;       // of one piece of it; 0: a twelfth of it all, 1.5 to 5
  double swing = 0.5;       // [rad, m] of a joint each way, at most
  double velocity = 0.8;    // [rad/s, m/s]
  double acceleration = 3;  // [rad/s^2, m/s^2]
  std::map<std::string, double> swings, velocities, accelerations;  // of single joints
  std::map<std::string, double> centre;  // of joints; others: ArmSpace::home()
  double fastest = 2;                    // [Hz] of sines
  double noise = 1e-4;                   // [rad, m] of a reading; of input inverse [Nm, N]
  double torque_share = 0.8;             // of a motor's limit that the motion may ask
  std::vector<std::string> effects;      // to be told; empty: all that a joint can show
  // What a verdict left open of a joint.
  struct Question {
    std::vector<std::string> effects;  // that it could not tell apart; empty: all
    std::map<std::string, std::map<std::string, double>> found;  // of those that it named
  };
  // Of joints by name; empty: there is no verdict yet. Joints without a question only move along.
  // What the rig's logs show counts, and a known mass at the tip or other servo gains are taken
  // where they tell more than a motion alone.
  std::map<std::string, Question> asked;
  uint64_t seed = 1;   // of the order of pieces
  bool sweep = false;  // no design: what SampleSweep plays, to compare with
  ArmSpace::Options space;
  bool without_shapes = false;  // a model without shapes is let pass
};

struct ExcitationDesign {
  struct Joint {
    std::string name;
    JointRoom room;
    std::vector<std::string> pieces;  // in order, of the motion
    std::vector<std::string> effects;
    std::vector<JointSensitivities::Sight> sights;  // of effects, alone and without coupling
    bool asked = true;                              // something is open of it
  };
  double dt = 0;                       // [s]
  std::vector<std::vector<double>> q;  // [joint][row] commands [rad, m]
  std::vector<Joint> joints;
  // What must differ from the rig while it is played, as in RigLog::overrides, and in words; empty:
  // nothing.
  std::map<std::string, double> overrides;
  std::string change;
  double gain = 1, mass = 0;  // of it: times the servos' kp (kd by its root), and [kg] at the tip
  double torque_used = 0;     // largest share of a motor's limit that is asked; 0: none has a limit
  std::vector<std::string> notes;
};

// A motion of all joints at once that makes the effects of the library, or those wanted, as well
// told from each other as its time allows. Every joint has its own sequence of pieces, each from
// the centre and back: of a pool (joint_way) those are taken one by one that raise the joint's
// utility (sensitivities) most. Swings shrink until nothing meets along the whole motion, and
// speeds until no motor is asked for more than its share. With `asked` the sights are those of the
// motion beside the rig's logs.
//
// Errors name joint, limit and remedy: no room, a way that meets something at any size, torque that
// holding alone exceeds, a model without shapes.
absl::StatusOr<ExcitationDesign> DesignExcitation(const Rig& rig, const DesignOptions& options);

// An animated WebP of the motion in real time, from outside the model.
absl::Status FilmExcitation(const Rig& rig, const DesignOptions& options,
                            const ExcitationDesign& design, const std::string& file);

// t, and q_cmd_<joint> of every joint; a row per dt.
std::string ExcitationCsv(const ExcitationDesign& design);

}  // namespace robostress::calibration
