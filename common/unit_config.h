#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/deferred.h"
#include "common/joint_errors/options.h"
#include "common/latency_options.h"
#include "common/remote_options.h"

namespace robostress {

struct MethodOptions;  // adapter/method_options.h

enum class GoalReference { kAchieved, kDesired };
enum class Stepping { kFast, kReference, kParity };
enum class Switch { kAuto, kOn, kOff };

// Behaviours of robosuite 1.4.0 and LIBERO that a clean implementation would not have; trajectories
// equal theirs only with all of them (docs/results/stepping-and-controller.md). The fifth, the
// forward passes of a sub-step and what they leave as the solver's warm start, is stepping: parity.
struct RobosuiteOptions {
  bool stale_reset_pose = true;
  bool home_goal = true;
  Switch single_precision_rotation = Switch::kAuto;
  Switch late_observation = Switch::kAuto;

  template <class V>
  void Visit(V& v) {
    const auto add = [&v](const char* name, Switch& field, const char* help) {
      v.Choice(name, field, {{"auto", Switch::kAuto}, {"on", Switch::kOn}, {"off", Switch::kOff}},
               help);
    };
    v.Field("stale_reset_pose", stale_reset_pose,
            "the first sub-step and the first goal act on pose, Jacobian and masses of the home "
            "posture");
    v.Field("home_goal", home_goal,
            "the orientation's goal and the null-space posture are those of home, not of the "
            "initial state");
    add("single_precision_rotation", single_precision_rotation,
        "a commanded rotation becomes a matrix in single precision; auto: on with stepping parity");
    add("late_observation", late_observation,
        "measurements and views are of sub-step 24 of 25, poses from its start; auto: on with "
        "stepping parity");
  }
};

enum class Encoders { kLink, kMotor };

// What the arm knows of its own motion, and so what residuals and compensation see. What the policy
// observes and what the controller acts on stay as they are.
struct SensingOptions {
  Encoders encoders = Encoders::kLink;
  double noise = 0;  // standard deviation of each joint's angle [rad]
  int delay = 0;     // [control steps]

  bool used() const { return encoders != Encoders::kLink || noise != 0 || delay != 0; }

  template <class V>
  void Visit(V& v) {
    v.Choice("encoders", encoders, {{"link", Encoders::kLink}, {"motor", Encoders::kMotor}},
             "link: the joints' true angles; motor: without backlash and compliance, which motor "
             "encoders do not see");
    v.Field("noise", noise, "standard deviation of each joint's angle [rad]");
    v.Field("delay", delay, "control steps after which the arm's state is known");
  }
};

// Stiffness of robosuite's OSC_POSE per unit of inertia, damping ratio 1 [1/s^2].
inline constexpr double kControllerKp = 150;

// The simulator's options.
struct SimOptions {
  GoalReference goal_reference = GoalReference::kAchieved;
  Stepping stepping = Stepping::kFast;
  int settle_steps = 10;
  JointErrorOptions joint_errors;
  RobosuiteOptions robosuite;
  SensingOptions sensing;
  double controller_kp = kControllerKp;
  // How LIBERO's views are drawn: kOriginalPictures, or kPlainPictures: at twice the size that the
  // policy asks for, without multisampling and mirrors, with fewer triangles.
  std::string pictures = kOriginalPictures;

  static constexpr char kOriginalPictures[] = "original", kPlainPictures[] = "plain";
  bool SinglePrecisionRotation() const { return IsOn(robosuite.single_precision_rotation); }
  bool LateObservation() const { return IsOn(robosuite.late_observation); }

  template <class V>
  void Visit(V& v) {
    v.Choice(
        "goal_reference", goal_reference,
        {{"achieved", GoalReference::kAchieved}, {"desired", GoalReference::kDesired}},
        "goal of the delta command: achieved pose + delta (robosuite) or previous goal + delta");
    v.Choice("stepping", stepping,
             {{"fast", Stepping::kFast},
              {"reference", Stepping::kReference},
              {"parity", Stepping::kParity}},
             "fast: one forward per sub-step; reference: the paper's order with a forward after "
             "the offset; "
             "parity: robosuite's three forwards");
    v.Field("settle_steps", settle_steps, "control steps with a zero command before the episode");
    v.Section("joint_errors", joint_errors, "discretisation of the error laws");
    v.Section("robosuite", robosuite, "behaviours of the originals");
    v.LateSection("sensing", sensing, sensing.used(), "what the arm knows of its own motion");
    v.Late("controller_kp", controller_kp, kControllerKp,
           "stiffness of the operational-space controller, 1 to 2000, critically damped [1/s^2]");
    v.Late("pictures", pictures, std::string(kOriginalPictures),
           "LIBERO's views: original; plain: quick ones for policies of small views");
  }

 private:
  bool IsOn(Switch s) const {
    return s == Switch::kOn || (s == Switch::kAuto && stepping == Stepping::kParity);
  }
};

// How a robot of robot_client plays a unit.
struct ClientOptions {
  double episode_s = 15;  // of RUN until an episode has failed [s]
  int latency_ticks = 0;  // control steps from an observation to its chunk
  // [rad] steps that limiter or cross-fade moved by more are masked in feedback. The paper's client
  // had no limiter, and ours allows what the arm's own planner does; a real arm's bound is tighter.
  double moved_bound = 0.1;
  // The programs of a real arm as processes over UDP, one second for a second.
  bool real_time = false;
  int udp_port = 43120;  // of the emulated arm's bus in real time; decides nothing
  // The joints' impedance controllers take targets as they are: faster, weaker, and without the
  // planner and the integral part of the arm's own servos.
  bool direct = false;

  template <class V>
  void Visit(V& v) {
    v.Field("episode_s", episode_s, "until an episode has failed [s]");
    v.Field("latency_ticks", latency_ticks, "control steps from an observation to its chunk");
    v.Field("moved_bound", moved_bound,
            "steps that limiter or cross-fade moved by more are masked in feedback [rad]");
    v.Field("real_time", real_time, "play with piper_emulator and robot_client over UDP");
    v.Field("udp_port", udp_port, "of the emulated arm's bus in real time");
    v.Late("direct", direct, false,
           "targets go to the joints' impedance controllers as they are: no planner, no integral "
           "part; not in real time");
  }
};

// One unit of a sweep: sequential episodes of one session. This struct is units/ID/config.yaml.
// Who reads or writes one as YAML, or looks at its method, includes adapter/method_options.h.
struct UnitConfig {
  std::string suite = "tabletop_spatial";
  std::string scenario = "clean";
  int severity = 5;             // level 1..5
  std::string policy = "nano";  // nano, expert, replay, or another model the server holds
  int64_t seed = 0;             // sampling noise; changes nothing else
  std::vector<int> tasks;       // indices in order; empty: all
  int episodes = 20;            // consecutive episodes per task
  int first_initial_state = 0;  // 0: reporting split, 40: dev split
  int videos = 0;               // first N episodes of each task are filmed
  std::string replay_file;      // policy replay: safetensors with actions [T, 7]
  std::string libero_root, robosuite_root;
  std::string libero_fixtures = "centred";  // ParseLiberoFixtures reads it
  SimOptions sim;
  Deferred<MethodOptions> method;
  std::string robot = "panda";  // of the suite; its program runs the unit (common/unit/robots.h)
  ClientOptions client;         // of robots other than the simulated Panda
  RemotePolicyOptions remote;   // used: `policy` is a label of what another server holds
  int horizon = 0;              // control steps of an episode at most; 0: the suite's
  LatencyOptions latency;       // of answers, in simulated time
  std::string libero_tasks;     // folder of the suite's BDDL files, where it is none of ours

  template <class V>
  void Visit(V& v) {
    v.Field("suite", suite, "see `robostress suites`");
    v.Field("scenario", scenario, "see `robostress scenarios`");
    v.Field("severity", severity, "level 1 (mild) to 5 (the paper's tables)");
    v.Field("policy", policy, "nano, expert, replay");
    v.Field("seed", seed, "of the policy's sampling noise");
    v.Field("tasks", tasks, "task indices; empty: all ten");
    v.Field("episodes", episodes, "consecutive episodes per task");
    v.Field("first_initial_state", first_initial_state, "0-19 reporting, 40-49 dev");
    v.Field("videos", videos, "film the first N episodes of each task");
    v.Field("replay_file", replay_file, "actions for policy replay");
    v.Field("libero_root", libero_root, "LIBERO checkout");
    v.Field("robosuite_root", robosuite_root, "robosuite checkout");
    v.Field("libero_fixtures", libero_fixtures,
            "where fixtures stand per episode: centred, sampled, numpy[:SEED] or a table's file");
    v.Section("sim", sim, "simulator");
    v.Section("method", method, "method");
    v.Late("robot", robot, std::string("panda"), "whose program runs the unit");
    v.LateSection("client", client, robot != "panda", "how robot_client plays it");
    v.LateSection("remote", remote, remote.used(), "how a policy of another server is asked");
    v.Late("horizon", horizon, 0, "control steps of an episode at most; 0: the suite's");
    v.LateSection("latency", latency, latency.used(), "answers that take time");
    v.Late("libero_tasks", libero_tasks, std::string(), "folder of the suite's BDDL files");
  }
};

}  // namespace robostress
