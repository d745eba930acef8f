#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/status_macros.h"
#include "python/library/boundary.h"
#include "python/library/errors_object.h"
#include "python/library/mujoco_arrays.h"

// Errors that act in a simulator's own arrays.
namespace robostress {
namespace {

// What the errors read of arrays, beside what `moment` has of masses, accelerations and heat.
robostress_moment MomentIn(robostress_errors& errors, const robostress_arrays& arrays,
                           const robostress_moment& moment) {
  const int n = errors.chain.joints();
  double *q = errors.own.data(), *dq = q + n, *gravity = dq + n, *payload_gravity = gravity + n,
         *payload_inertia = payload_gravity + n, *tilt = payload_inertia + n;
  for (int i = 0; i < n; ++i) q[i] = arrays.qpos[arrays.qpos_index[i]];
  for (int i = 0; i < n; ++i) dq[i] = arrays.qvel[arrays.dof_index[i]];
  HoldAgainstGravity(arrays, n, gravity);
  robostress_moment at = moment;
  at.q = q;
  at.dq = dq;
  at.gravity = gravity;
  if ((errors.chain.reads() & kPayloadFields) && arrays.tool != nullptr) {
    PayloadAtTool(arrays, n, payload_gravity, payload_inertia);
    at.payload_gravity = payload_gravity;
    at.payload_inertia = payload_inertia;
  }
  if (errors.chain.reads() & kTiltField) {
    TiltGravity(arrays, n, tilt);
    at.tilt_gravity = tilt;
  }
  return at;
}

// A motor with a gear keeps its command, to the last bit, where that is what it shall give.
void SetMotors(const robostress_arrays& arrays, int joints, const double* asked,
               const double* torque) {
  for (int i = 0; i < joints; ++i) {
    double& ctrl = arrays.ctrl[arrays.ctrl_index[i]];
    if (arrays.gear == nullptr) {
      ctrl = torque[i];
    } else if (torque[i] != asked[i] || ctrl * arrays.gear[i] != asked[i]) {
      ctrl = torque[i] / arrays.gear[i];
    }
  }
}

void ActIn(const robostress_arrays& arrays, robostress_errors& errors, const robostress_moment& at,
           const double* asked) {
  const int n = errors.chain.joints();
  double *torque = errors.own.data() + 7 * n, *change = torque + n;
  ApplyErrors(errors, at, asked, torque);
  MoveOffsets(errors, torque, change);
  SetMotors(arrays, n, asked, torque);
  for (int i = 0; i < n; ++i) arrays.qpos[arrays.qpos_index[i]] += change[i];
}

absl::Status Act(robostress_errors* errors, const robostress_moment* moment,
                 const robostress_arrays* given, const double* asked, double* applied) {
  RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
  RS_RETURN_IF_ERROR(CheckHandle("asked", asked));
  RS_RETURN_IF_ERROR(CheckBegun(*errors));
  robostress_arrays arrays = {};
  RS_RETURN_IF_ERROR(ReadArrays(given, arrays));
  robostress_moment from = {};
  RS_RETURN_IF_ERROR(ReadStructure("moment", moment, from));
  const int n = errors->chain.joints();
  const robostress_moment at = MomentIn(*errors, arrays, from);
  RS_RETURN_IF_ERROR(CheckMoment(*errors, at));
  RS_RETURN_IF_ERROR(CheckArray("asked", asked, n, true));
  ActIn(arrays, *errors, at, asked);
  if (applied != nullptr) std::copy_n(errors->own.data() + 7 * n, n, applied);
  return absl::OkStatus();
}

absl::Status Attach(robostress_errors* errors, const robostress_moment* moment,
                    const robostress_arrays* given, const double* asked, double* record,
                    size_t rows) {
  RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
  RS_RETURN_IF_ERROR(CheckHandle("asked", asked));
  robostress_moment from = {};
  RS_RETURN_IF_ERROR(ReadStructure("moment", moment, from));
  Attachment attached = {moment, {}, asked, record, record == nullptr ? 0 : rows, 0};
  RS_RETURN_IF_ERROR(ReadArrays(given, attached.arrays));
  errors->attached = attached;
  return absl::OkStatus();
}

absl::Status CheckAttached(const robostress_errors* errors) {
  RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
  return errors->attached.moment != nullptr
             ? absl::OkStatus()
             : absl::FailedPreconditionError(
                   "no arrays are attached: call robostress_errors_attach first");
}

absl::Status ResetAttached(robostress_errors* errors) {
  RS_RETURN_IF_ERROR(CheckAttached(errors));
  robostress_moment from = {};
  RS_RETURN_IF_ERROR(ReadStructure("moment", errors->attached.moment, from));
  const robostress_moment at = MomentIn(*errors, errors->attached.arrays, from);
  const int joints = errors->chain.joints();
  std::fill_n(errors->own.begin() + joints, joints, 0.0);  // at rest
  RS_RETURN_IF_ERROR(Reset(*errors, at, at.gravity));
  errors->sub_steps = 0;
  return absl::OkStatus();
}

// A sum is finite where all of its parts are, but for sums that overflow: those are then looked at.
double Sum(const double* values, int count, double sum) {
  for (int i = 0; i < count; ++i) sum += values[i];
  return sum;
}

// Whether one of the values that act_attached() reads may be none.
bool Doubtful(const robostress_errors& errors, const robostress_moment& at, const double* asked) {
  constexpr unsigned kOwn = ROBOSTRESS_READS_GRAVITY | ROBOSTRESS_READS_PAYLOAD |
                            ROBOSTRESS_READS_TILT | ROBOSTRESS_READS_GRASP;
  const int n = errors.chain.joints();
  return !errors.begun || (Reads(errors) & ~kOwn) || at.temperature != nullptr ||
         !std::isfinite(Sum(asked, n, Sum(errors.own.data(), 7 * n, 0)));
}

absl::Status ActAttached(robostress_errors* errors) {
  RS_RETURN_IF_ERROR(CheckAttached(errors));
  Attachment& attached = errors->attached;
  robostress_moment from = {};
  // Attach has checked the size; a caller's memory may have another by now.
  std::memcpy(&from, attached.moment, std::min(attached.moment->size, sizeof(from)));
  robostress_moment at = MomentIn(*errors, attached.arrays, from);
  at.time = static_cast<double>(errors->sub_steps) * at.step;
  const int n = errors->chain.joints();
  if (Doubtful(*errors, at, attached.asked)) {
    RS_RETURN_IF_ERROR(CheckBegun(*errors));
    RS_RETURN_IF_ERROR(CheckMoment(*errors, at));
    RS_RETURN_IF_ERROR(CheckArray("asked", attached.asked, n, true));
  }
  ActIn(attached.arrays, *errors, at, attached.asked);
  ++errors->sub_steps;
  if (attached.row >= attached.rows) return absl::OkStatus();
  double* row = attached.record + 2 * n * static_cast<ptrdiff_t>(attached.row++);
  std::copy_n(attached.asked, n, row);
  std::copy_n(errors->own.data() + 7 * n, n, row + n);
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress

using robostress::AtBoundary;

extern "C" {

robostress_code robostress_errors_act(robostress_errors* errors, const robostress_moment* moment,
                                      const robostress_arrays* arrays, const double* asked,
                                      double* applied, char* error, size_t error_size) {
  return AtBoundary(error, error_size,
                    [&] { return robostress::Act(errors, moment, arrays, asked, applied); });
}

robostress_code robostress_errors_attach(robostress_errors* errors, const robostress_moment* moment,
                                         const robostress_arrays* arrays, const double* asked,
                                         double* record, size_t rows, char* error,
                                         size_t error_size) {
  return AtBoundary(error, error_size, [&] {
    return robostress::Attach(errors, moment, arrays, asked, record, rows);
  });
}

size_t robostress_errors_recorded(const robostress_errors* errors) {
  return errors == nullptr ? 0 : errors->attached.row;
}

robostress_code robostress_errors_reset_attached(robostress_errors* errors, char* error,
                                                 size_t error_size) {
  return AtBoundary(error, error_size, [&] { return robostress::ResetAttached(errors); });
}

robostress_code robostress_errors_act_attached(robostress_errors* errors, char* error,
                                               size_t error_size) {
  return AtBoundary(error, error_size, [&] { return robostress::ActAttached(errors); });
}

}  // extern "C"
