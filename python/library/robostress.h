/* The joint errors of RoboStress for any simulator, and what takes them off, in C.

   A simulator of an arm asks an object of these errors, in every sub-step of its physics, what
   becomes of the torques that its controller asks for, and how far the transmissions moved.
   Everything is deterministic.

     begin_control_step   once per command: the severity follows the episode and the grasp
       torque             each sub-step: the torques that the joints get
       offset_change      each sub-step, after it: what to add to the joint positions
       reading            where a sensor effect acts: what the controller sees

   A compensator stands between a policy and the controller: it gets the commands of the policy and
   what the arm did with those before, and says what to send.

   Units: rad, rad/s, Nm, kg m^2, s; of a slide m, m/s, N, kg. Arrays have an entry per joint unless
   said otherwise. Structures begin with `size`, sizeof of what the caller knows: fields may be
   added behind, none is ever removed. Threads: nothing is global. One object is used by one thread
   at a time, different ones by different threads at once. Failures: a function that can fail
   returns a code and writes a sentence that says value, limit and remedy to error[0 .. error_size -
   1], cut where it is too long, always terminated; error may be NULL. What failed changed nothing.
   No C++ exception leaves the library. */
#ifndef ROBOSTRESS_H_
#define ROBOSTRESS_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef __GNUC__
#pragma GCC visibility push(default)
#endif

/* Raised when a function is added; functions stay as they are within a symbol version
 * (ROBOSTRESS_1). */
#define ROBOSTRESS_INTERFACE 7

typedef enum robostress_code {
  ROBOSTRESS_OK = 0,
  ROBOSTRESS_INVALID_ARGUMENT = 3, /* a value that the message names */
  ROBOSTRESS_NOT_FOUND = 5,        /* a name; the message lists the known ones */
  ROBOSTRESS_WRONG_ORDER = 9,      /* a call that must follow another one */
  ROBOSTRESS_INTERNAL = 13,        /* a fault of this library */
  ROBOSTRESS_STORAGE = 14          /* a disk that is full, a file that cannot be written or read */
} robostress_code;

const char* robostress_version(void); /* "0.2.0" */
int robostress_interface(void);       /* ROBOSTRESS_INTERFACE of the library */

/* ---- Scenarios: index from 0 to robostress_scenario_count() - 1; NULL and 0 beyond. ---- */
size_t robostress_scenario_count(void);
const char* robostress_scenario_name(size_t index);  /* "heavy_payload" */
const char* robostress_scenario_title(size_t index); /* "Heavy Payload" */
int robostress_scenario_deployed(size_t index); /* whether it is one of the seven of the paper */

/* ---- Joint errors ---- */
typedef struct robostress_errors robostress_errors;

typedef struct robostress_options {
  size_t size;
  int severity; /* 1 (mild) to 5 (full, the default) */
  int horizon;  /* [control steps] over which severities that grow with an episode do so; 300 */
  const char* friction_law; /* "sgn" (the paper's, the default), "tanh", "stick" */
  double tanh_width;        /* [rad/s], of "tanh"; 0.01 */
  const char*
      offset_start; /* "zero" (default) or "equilibrium": compliance at an episode's start */
  const char* gravity_sign; /* "literal" (default: lifts the arm) or "payload" (lets it sag) */
  /* [joints][9] Fc, Fs [Nm], vs [rad/s], sigma_v [Nm s/rad], B [rad], M_eff [kg m^2], D [Nm s/rad],
     K [Nm/rad], beta [1] of each joint in its nominal state; NULL: of a Panda. */
  const double* nominal;
} robostress_options;

void robostress_options_default(
    robostress_options* options); /* sets every field that options->size covers */

/* scenario: a name, or the path of a scenario file (.yaml). Built-in scenarios other than "clean"
   have values for the seven joints of a Panda. An arm with other joints brings options.nominal,
   where a scenario wears every joint alike, or begins with "clean" and gets effects. Files are a
   Panda's. options: NULL for the defaults. */
robostress_code robostress_errors_new(const char* scenario, int joints,
                                      const robostress_options* options,
                                      robostress_errors** created, char* error, size_t error_size);
/* An effect of the library at a joint, behind those that are there; from the next reset on. type:
   as `robostress scenarios --effects` prints it; values in the order of its parameters. coupled:
   the other joint that a cross_joint effect reads, one for all effects of a joint; else -1. */
robostress_code robostress_errors_add_effect(robostress_errors* errors, int joint, const char* type,
                                             const double* values, size_t count, int coupled,
                                             char* error, size_t error_size);
void robostress_errors_free(robostress_errors* errors); /* NULL is allowed */

/* The whole state, hidden states included. A copy goes on as the original would. */
robostress_code robostress_errors_copy(const robostress_errors* from, robostress_errors** created,
                                       char* error, size_t error_size);
/* Makes `to` what `from` is: one that robostress_errors_copy made of it, or the other way round. */
robostress_code robostress_errors_restore(robostress_errors* to, const robostress_errors* from,
                                          char* error, size_t error_size);

int robostress_errors_joints(const robostress_errors* errors);

/* Which optional fields of a moment may be read, and must be given. */
enum {
  ROBOSTRESS_READS_GRAVITY = 1,
  ROBOSTRESS_READS_PAYLOAD = 2, /* payload_gravity and payload_inertia */
  ROBOSTRESS_READS_TILT = 4,
  ROBOSTRESS_READS_MASSES = 8, /* mass_matrix, other_torque: friction that brings joints to rest */
  ROBOSTRESS_READS_ACCELERATION = 16, /* ddq */
  ROBOSTRESS_READS_GRASP = 32         /* `held` of begin_control_step */
};
unsigned robostress_errors_reads(const robostress_errors* errors);

/* The arm at the start of a sub-step. */
typedef struct robostress_moment {
  size_t size;
  double time;     /* [s] since the episode began */
  double step;     /* [s] length of the sub-step, above 0 */
  const double* q; /* joint coordinates, with every offset that was ever added to them */
  const double* dq;
  const double* gravity;         /* torque that holds each joint against gravity; or NULL */
  const double* payload_gravity; /* the same of 1 kg at the payload's place [Nm/kg]; or NULL */
  const double* payload_inertia; /* [kg m^2/kg]; or NULL */
  const double* tilt_gravity;    /* [joints][2]: change of gravity as the base tilts about x, y
                                    [Nm/rad]; or NULL */
  const double* mass_matrix;     /* [joints][joints]; or NULL */
  /* Torques beside the motors': passive - bias + constraints; or NULL. */
  const double* other_torque;
  const double* torque_low; /* limits of the motors; or NULL for none */
  const double* torque_high;
  const double* ddq;         /* accelerations, of the sub-step before; or NULL */
  const double* temperature; /* [deg C]; or NULL: nobody measures it */
} robostress_moment;

/* An episode begins at rest at this moment. holding: the motors' torques that hold the arm, or NULL
 * for zero. */
robostress_code robostress_errors_reset(robostress_errors* errors, const robostress_moment* moment,
                                        const double* holding, char* error, size_t error_size);
/* steps_done: control steps of the episode before this one, 0 while it settles. held: whether the
   gripper holds an object. */
void robostress_errors_begin_control_step(robostress_errors* errors, int steps_done, int held);
/* asked: what the controller asks for. applied: what the joints get, within the limits; may be
 * `asked` itself. */
robostress_code robostress_errors_torque(robostress_errors* errors, const robostress_moment* moment,
                                         const double* asked, double* applied, char* error,
                                         size_t error_size);
/* After torque() of the same sub-step. applied: torques that the joints really got. change: what to
   add to the joint positions: at once, or over the sub-step as a velocity. */
robostress_code robostress_errors_offset_change(robostress_errors* errors, const double* applied,
                                                double* change, char* error, size_t error_size);
/* torque(), and offset_change() of what it applied, in one call. */
robostress_code robostress_errors_sub_step(robostress_errors* errors,
                                           const robostress_moment* moment, const double* asked,
                                           double* applied, double* change, char* error,
                                           size_t error_size);
/* A simulator's own arrays, laid out as MuJoCo's mjData and mjModel. An index has an entry per
   joint of the arm. */
typedef struct robostress_arrays {
  size_t size;
  double* qpos;
  const double* qvel;
  double* ctrl;
  const double* xaxis;       /* [joints of the simulator][3] */
  const double* xanchor;     /* the same */
  const double* subtree_com; /* [bodies][3] */
  const double* subtree_mass;
  const int* qpos_index;
  const int* dof_index;
  const int* ctrl_index;
  const int* joint_index;
  const int* body_index;
  double field[3];             /* [m/s^2] of gravity */
  const double* tool;          /* [3] where a payload sits; or NULL: payload_* are of the moment */
  const double* gear;          /* torque of each motor per unit of ctrl; or NULL for 1 */
  const unsigned char* slides; /* not 0: the joint slides along its axis; or NULL: all turn */
} robostress_arrays;
/* sub_step() with q, dq, gravity, payload_* and tilt_gravity of these arrays, whose ctrl gets what
   is applied and whose qpos the change: between a controller and the simulator's step. moment: what
   else is read. applied: [joints], or NULL. */
robostress_code robostress_errors_act(robostress_errors* errors, const robostress_moment* moment,
                                      const robostress_arrays* arrays, const double* asked,
                                      double* applied, char* error, size_t error_size);
/* For act_attached(), which is act() with less in the way of a simulator's sub-step. All that is
   given must live as long. asked: [joints], read at each call. record: [rows][2][joints] gets what
   was asked for and applied in the first `rows` sub-steps since begin_control_step; or NULL. Time
   is that of its calls since reset_attached. A copy is attached to nothing. */
robostress_code robostress_errors_attach(robostress_errors* errors, const robostress_moment* moment,
                                         const robostress_arrays* arrays, const double* asked,
                                         double* record, size_t rows, char* error,
                                         size_t error_size);
/* How many sub-steps since begin_control_step are in `record`. */
size_t robostress_errors_recorded(const robostress_errors* errors);
/* reset() where the attached arrays are, at rest, the motors holding the arm against gravity. */
robostress_code robostress_errors_reset_attached(robostress_errors* errors, char* error,
                                                 size_t error_size);
robostress_code robostress_errors_act_attached(robostress_errors* errors, char* error,
                                               size_t error_size);
/* Link angle minus motor angle of every joint now. */
void robostress_errors_offset(const robostress_errors* errors, double* offset);
/* What the controller reads of joints at q, dq; reading and rate may be q and dq themselves, or
 * NULL. */
void robostress_errors_reading(const robostress_errors* errors, const double* q, const double* dq,
                               double* reading, double* rate);

/* ---- Compensation of commands, without a policy's weights ---- */
typedef struct robostress_compensator robostress_compensator;

/* How commands are meant. Those of an end effector have 7 entries: displacements in x, y, z and
   rotations about them in units of the scales, and a gripper. Those of joints are absolute targets
   [rad] and a gripper. */
typedef struct robostress_control {
  size_t size;
  const char* space;          /* "end_effector" (default) or "joint" */
  int action_dim;             /* entries of a command, the gripper's included; 7 */
  double control_period;      /* [s] between commands; 0.05 */
  double translation_scale;   /* [m]; 0.05 */
  double rotation_scale;      /* [rad]; 0.5 */
  const char* goal_reference; /* of the controller: "achieved" (robosuite's, default), "desired" */
  const float* action_low;    /* [action_dim] what a policy's actions lie in; both, or NULL */
  const float* action_high;
} robostress_control;

void robostress_control_default(robostress_control* control);

/* What an arm did with commands that followed each other. */
typedef struct robostress_executed {
  size_t size;
  size_t steps;                /* 1 to 1024 */
  const double* position;      /* [steps + 1][3] of the end effector, before, between, after [m] */
  const double* orientation;   /* [steps + 1][4] unit quaternions w, x, y, z */
  const double* q;             /* [steps + 1][action_dim - 1]; of joint commands */
  const float* policy_command; /* [steps][action_dim] the policy's own */
  const float* sent_command;   /* [steps][action_dim] what the controller got */
  const unsigned char* masked; /* [steps] not 0: says nothing about the arm; or NULL */
} robostress_executed;

/* method: "base", "gain", "smooth", "direct", "ours_integral", "ours_following",
   "ours_following_step", "ours_following_smooth". overrides: "key=value" of its options, as
   `robostress sweep --set` takes them; NULL: none. control: NULL for the defaults. Begins an
   episode. */
robostress_code robostress_compensator_new(const char* method, const char* const* overrides,
                                           size_t override_count, const robostress_control* control,
                                           robostress_compensator** created, char* error,
                                           size_t error_size);
void robostress_compensator_free(robostress_compensator* compensator); /* NULL is allowed */
robostress_code robostress_compensator_copy(const robostress_compensator* from,
                                            robostress_compensator** created, char* error,
                                            size_t error_size);
robostress_code robostress_compensator_restore(robostress_compensator* to,
                                               const robostress_compensator* from, char* error,
                                               size_t error_size);
int robostress_compensator_action_dim(const robostress_compensator* compensator);
/* 1: next() corrects every command anew, and smooths it where the method does; 0: correct() says it
   all. */
int robostress_compensator_every_step(const robostress_compensator* compensator);

void robostress_compensator_start_episode(robostress_compensator* compensator);
/* actions: [rows][action_dim], the policy's next chunk. corrected: what to send; may be `actions`
   itself. */
robostress_code robostress_compensator_correct(robostress_compensator* compensator,
                                               const float* actions, size_t rows, float* corrected,
                                               char* error, size_t error_size);
/* The next command [action_dim] of the chunk that correct() got last. newest: what was executed of
   it since the last call, or NULL at its first row. Methods without every_step give the rows of
   correct(). */
robostress_code robostress_compensator_next(robostress_compensator* compensator,
                                            const robostress_executed* newest, float* command,
                                            char* error, size_t error_size);
/* Once for every chunk, when it is over: all steps of it that were executed. */
robostress_code robostress_compensator_executed(robostress_compensator* compensator,
                                                const robostress_executed* executed, char* error,
                                                size_t error_size);
/* [action_dim - 1] what is added to each command of the next chunk. */
void robostress_compensator_correction(const robostress_compensator* compensator,
                                       double* correction);
/* [steps][action_dim] achieved minus commanded, as the method's options say (paper, Eq. 1); of the
   gripper 0. Changes nothing. */
robostress_code robostress_compensator_residual(const robostress_compensator* compensator,
                                                const robostress_executed* executed,
                                                double* residual, char* error, size_t error_size);

/* ---- Random streams: a draw depends on the parts of its key and on its index alone ---- */
typedef struct robostress_stream robostress_stream;

robostress_code robostress_stream_new(const char* purpose, robostress_stream** created, char* error,
                                      size_t error_size);
void robostress_stream_free(robostress_stream* stream); /* NULL is allowed */
/* One more part of the key; the stream begins anew. */
void robostress_stream_add_text(robostress_stream* stream, const char* part);
void robostress_stream_add_number(robostress_stream* stream, int64_t part);
void robostress_stream_uniform(robostress_stream* stream, double* values,
                               size_t count); /* [0, 1) */
void robostress_stream_normal(robostress_stream* stream, double* values, size_t count);
/* 0 to n - 1; of n below 1 zeros. */
void robostress_stream_integers(robostress_stream* stream, int n, int* values, size_t count);

/* ---- Episodes as a data set of LeRobot v3.0: pictures in Parquet, no video ---- */
typedef struct robostress_dataset robostress_dataset;

typedef struct robostress_schema {
  size_t size;
  const char* robot;                    /* what info.json says of it */
  double rate;                          /* [1/s] of steps, whole */
  size_t vectors;                       /* features of numbers */
  const char* const* vector_names;      /* "observation.state", "action", ... */
  const size_t* axis_counts;            /* [vectors] entries of each */
  const char* const* const* axis_names; /* [vectors][axis_counts] */
  size_t cameras;
  const char* const* camera_names; /* "image": the feature is observation.images.image */
} robostress_schema;

typedef struct robostress_frames {
  size_t size;
  const char* instruction;
  int success;
  size_t steps;
  const float* const* vectors;        /* [vectors][steps][axis_counts] */
  const unsigned char* const* pixels; /* [cameras][steps][height][width][3] */
  const int* width;                   /* [cameras] */
  const int* height;
  const unsigned char* const* pictures; /* [cameras] the same as PNG files, one behind the other */
  const size_t* const* picture_ends;    /* [cameras][steps] where each ends */
} robostress_frames;

/* Makes the set, or goes on with the one in `folder` that has the same schema. One recorder a
   folder: ROBOSTRESS_WRONG_ORDER while another one has it open. */
robostress_code robostress_dataset_open(const char* folder, const robostress_schema* schema,
                                        robostress_dataset** opened, char* error,
                                        size_t error_size);
/* A whole episode; on failure, or when the process dies, the set is as it was. */
robostress_code robostress_dataset_append(robostress_dataset* dataset,
                                          const robostress_frames* frames, char* error,
                                          size_t error_size);
size_t robostress_dataset_episodes(const robostress_dataset* dataset);
size_t robostress_dataset_steps(const robostress_dataset* dataset);
void robostress_dataset_free(robostress_dataset* dataset); /* NULL is allowed */

/* ---- Of the wheel ---- */
/* A PyMethodDef whose function is bound as python/library/cpython.cc says; NULL where no CPython
   has loaded the library. */
void* robostress_cpython_sub_step(void);

#ifdef __GNUC__
#pragma GCC visibility pop
#endif

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* ROBOSTRESS_H_ */
