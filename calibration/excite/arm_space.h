#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"

namespace robostress::calibration {

// Where a rig's arm may be, and what its motors must do there, by its model in MuJoCo.
class ArmSpace {
 public:
  struct Options {
    double clearance = 0.03;        // [m] between parts of the arm, and from floor and box
    std::optional<double> floor_z;  // [m] in the model's frame; no part goes below
    // [m] corners of a box that the arm stays in; empty: none.
    std::vector<double> box_lower, box_upper;
  };
  // Errors name the model's file.
  static absl::StatusOr<std::unique_ptr<ArmSpace>> Load(const Rig& rig, const Options& options);
  ~ArmSpace();

  // Limits of a joint of the rig; none where it has no stops.
  struct Stops {
    double lower = 0, upper = 0;
  };
  const std::vector<std::optional<Stops>>& stops() const { return stops_; }
  // Where the model's keyframe "home", or else its first one, has the joints; without keyframes the
  // model's zero, moved to within the middle half of their ways.
  const std::vector<double>& home() const { return home_; }

  // Parts that are nearer than the clearance in this posture [joints] are neighbours by design and
  // are not watched; notes() names them. FailedPrecondition: a part is near floor or box there.
  absl::Status WatchFrom(const std::vector<double>& centre);
  // Parts that could meet; 0: the model has no shapes, and nothing is known of collisions.
  int shapes() const { return shapes_; }
  // What MuJoCo said of a model whose shapes could not be read; else empty.
  const std::string& why_without_shapes() const { return why_without_shapes_; }
  const std::vector<std::string>& notes() const { return notes_; }
  // What is nearer than the clearance in a posture ("link3 and link6", "hand and the floor");
  // empty: nothing.
  std::string MetAt(const std::vector<double>& posture);
  // Torques [Nm, or N of a slide] that the motion asks of the joints' motors: friction of the
  // model, what the rig's `parameters` say instead, coupled fingers and the load included.
  std::vector<double> TorquesAt(const std::vector<double>& posture,
                                const std::vector<double>& velocity,
                                const std::vector<double>& acceleration);
  // [kg] that the motors bear at the payload's place from now on.
  void SetLoad(double mass) { load_ = mass; }
  // Down to one digit [kg]; 0: too light to tell anything.
  static double RoundLoad(double mass);
  // "Nm", of a slide "N".
  const char* TorqueUnit(size_t joint) const;
  // [kg] at the tip that adds `share` of a joint's inertia where it adds most of it, one digit;
  // less where a motor would be asked for more than `torque_share` of its limit [Nm], if finite, to
  // hold it in one of the postures; inertia is that of the first. 0: the model has no site payload,
  // tip, tool or end_effector, or no motor may hold more.
  double LoadOf(double share, double torque_share, const std::vector<double>& limits,
                const std::vector<std::vector<double>>& postures);
  // Pictures of a motion, q[joint][row], one every `every` rows.
  absl::Status Film(const std::vector<std::vector<double>>& q, int every, double frame_s,
                    const std::string& file);

 private:
  ArmSpace() = default;
  void FindCouplings();
  void TakeParameters(const Rig& rig);
  void Place(const std::vector<double>& posture);
  void SetPosture(const std::vector<double>& posture);
  std::vector<std::pair<int, int>> NearPairs();
  bool KeepsItsHeight(int body) const;

  std::shared_ptr<mjModel> model_;
  mjData* data_ = nullptr;
  Options options_;
  // A joint that the rig does not list, held to another by the model: q - q0 is a polynomial of the
  // other's, or a constant. A leader stands before what follows it.
  struct Coupling {
    int q = 0, dof = 0, leader_q = -1, leader_dof = -1;
    double polynomial[5] = {};
    double Value(double x) const;
    double Slope(double x) const;
  };
  std::vector<int> qpos_, dof_;  // of the rig's joints
  std::vector<Coupling> couplings_;
  std::vector<double> mass_scale_, torque_gain_, torque_offset_;  // of the rig's joints
  int payload_site_ = -1;
  double load_ = 0;
  std::vector<std::optional<Stops>> stops_;
  std::vector<double> home_;
  std::vector<char> moves_;                      // bodies that the rig's joints move
  std::vector<std::pair<int, int>> neighbours_;  // bodies
  int shapes_ = 0;
  std::string why_without_shapes_;
  std::vector<std::string> notes_;
};

}  // namespace robostress::calibration
