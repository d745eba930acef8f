#pragma once

// The inside of PandaSim, shared by its sources: panda_sim.cc (an episode and what is asked of it),
// panda_sub_step.cc (time), panda_torques.cc (what the joint errors make of a torque).

#include <array>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "common/joint_errors/joint_chain.h"
#include "sim_worker/near_geoms.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

struct DataDeleter {
  void operator()(mjData* data) const { mj_deleteData(data); }
};
using DataPtr = std::unique_ptr<mjData, DataDeleter>;

// Not OK after warnings that leave a state which is not that of the task any more.
absl::Status CheckWarnings(const mjData& data);

using JointMoments = std::array<JointMoment, 7>;

// The state of an episode beside mjData: everything that a continuation depends on.
struct EpisodeState {
  EpisodeState(const SimOptions& options)
      : controller(options.goal_reference, options.SinglePrecisionRotation(),
                   options.controller_kp),
        chain(7, options.joint_errors) {}

  OscController controller;
  JointChain chain;
  ArmState arm;                      // what the controller saw last
  Vector7d bias = Vector7d::Zero();  // its model of Coriolis, centrifugal and gravity torque [Nm]
  double clock = 0;                  // [s] since Reset
  std::array<double, 2> gripper{};   // integrated gripper command in +-1, per finger
  int steps = 0;                     // control steps since Reset, settling excluded
  bool first_sub_step = true;        // see Reset
};

struct PandaSim::Snapshot {
  EpisodeState episode;
  double time;
  std::vector<double> qpos, qvel, act, ctrl, warmstart, mocap_pos, mocap_quat;
  std::vector<double> late_pose_qpos, late_qpos, late_qvel;
};

struct PandaSim::Impl {
  Impl(SharedModel shared, const SimOptions& o, const PandaModel& p)
      : model(std::move(shared)),
        data(mj_makeData(model.get())),
        options(o),
        panda(p),
        episode(o),
        near_geoms(*model) {
    if (options.LateObservation()) late.data.reset(mj_makeData(model.get()));
  }

  bool parity() const { return options.stepping == Stepping::kParity; }
  // mj_step1 without its callback and timers, with contacts asked for among near geoms alone.
  void Step1();
  // The forward passes of a sub-step, and the arm as the controller then sees it.
  void LookAtArm();
  // The arm of the joint readings and the bias that the controller compensates; the truth without
  // sensor effects. Believe brings its kinematics up to date.
  void Believe();
  const mjData& Believed() const { return believed == nullptr ? *data : *believed; }
  Vector7d Readings() const;
  Vector7d ReadingRates() const;
  void SubStep();
  const mjData& Observed();
  absl::Status ControlStep(const Vector7d& command, int progress_steps);
  Vector7d Saturated(const Vector7d& torque) const;
  template <bool kEffects>
  struct ChainPlant;
  Vector7d LoadTorque(const Vector7d& asked, JointMoments& moments);
  JointMoments DescribeJoints() const;
  Vector7d NetTorque(const Vector7d& applied) const;
  Vector7d OffsetChange(const Vector7d& tau_load, JointMoments& moments);
  double ContactForce() const;
  void DriveGripper(double direction);
  void Integrate(const Vector7d& offset_change);
  // Root body with a free joint that `pad` touches in a contact, or -1.
  int FreeBodyTouching(int contact_index, int pad) const;
  int HeldBody() const;

  const SharedModel model;
  const DataPtr data;
  const SimOptions options;
  const PandaModel panda;
  EpisodeState episode;
  NearGeoms near_geoms;
  bool position_stage_stale = false;  // somebody may have written to data since the last mj_step1
  std::function<void()> on_sub_step, on_integrated;
  std::function<void(const JointSample&)> on_sample;
  bool last_sub_step = false;  // of a control step
  double contact_N = 0;        // of this sub-step, while somebody listens
  DataPtr believed;            // kinematics of the readings; null without sensor effects

  // An observation that is older than the end of the control step: kinematics of the positions from
  // which its sub-step started, positions and velocities of its end.
  struct LateObservation {
    DataPtr data;  // null: observations are of data
    std::vector<double> pose_qpos, qpos, qvel;
    bool keep = false;    // this sub-step's
    bool current = true;  // data holds it
  } late;
};

}  // namespace robostress
