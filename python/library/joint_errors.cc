#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <new>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/sub_step.h"
#include "common/status_macros.h"
#include "python/library/boundary.h"
#include "python/library/errors_object.h"
#include "python/library/robostress.h"
#include "python/library/scenario_chain.h"

namespace robostress {
namespace {

// Beyond any drive, and far from where a quotient overflows to a torque that is no number.
constexpr double kLeastDivisor = 1e-9, kMostValue = 1e12;

absl::Status CheckEffect(const JointChain& chain, int joint, const EffectInfo& effect,
                         const double* values, size_t count, int coupled) {
  if (joint < 0 || joint >= chain.joints()) {
    return absl::InvalidArgumentError(
        absl::StrCat("joint is ", joint, ", must be 0 to ", chain.joints() - 1));
  }
  if (count != effect.parameters.size() || (count > 0 && values == nullptr)) {
    std::string names;
    for (const EffectParameter& parameter : effect.parameters)
      absl::StrAppend(&names, names.empty() ? "" : ", ", parameter.name, " [", parameter.unit, "]");
    return absl::InvalidArgumentError(absl::StrCat("values has ", values == nullptr ? 0 : count,
                                                   " numbers, ", effect.type, " takes ",
                                                   effect.parameters.size(), ": ", names));
  }
  if (effect.of_position) {
    return absl::InvalidArgumentError(
        absl::StrCat(effect.type, " limits the position command of a servo [",
                     effect.parameters[0].unit, "], these errors bend torques; leave it out"));
  }
  const int other = chain.coupled(joint);
  if (effect.coupled != (coupled >= 0) || coupled >= chain.joints() ||
      (coupled >= 0 && (coupled == joint || (other >= 0 && coupled != other)))) {
    const std::string joints =
        other >= 0 ? absl::StrCat(other, " as of the joint's other effects")
                   : absl::StrCat("another joint than ", joint, ", 0 to ", chain.joints() - 1);
    return absl::InvalidArgumentError(
        absl::StrCat("coupled is ", coupled, ", must be ", effect.coupled ? joints : "-1"));
  }
  for (size_t i = 0; i < count; ++i) {
    const EffectParameter& parameter = effect.parameters[i];
    const bool amplitude = std::find(effect.amplitudes.begin(), effect.amplitudes.end(),
                                     static_cast<int>(i)) != effect.amplitudes.end();
    const bool signless = parameter.inverse || parameter.lower >= 0;
    const bool divided = parameter.inverse || (signless && !amplitude);
    const double least = divided ? kLeastDivisor : signless ? 0 : -kMostValue;
    if (values[i] >= least && values[i] <= kMostValue) continue;
    return absl::InvalidArgumentError(absl::StrCat(effect.type, ".", parameter.name, " is ",
                                                   values[i], " ", parameter.unit, ", must be ",
                                                   least, " to ", kMostValue));
  }
  return absl::OkStatus();
}

}  // namespace

unsigned Reads(const robostress_errors& errors) {
  const JointChain& chain = errors.chain;
  unsigned reads = 0;
  if (chain.reads() & kGravityField) reads |= ROBOSTRESS_READS_GRAVITY;
  if (chain.reads() & kPayloadFields) reads |= ROBOSTRESS_READS_PAYLOAD;
  if (chain.reads() & kTiltField) reads |= ROBOSTRESS_READS_TILT;
  // Whether an effect adds dry friction or inertia shows only in motion.
  if (chain.severity().scenario().profile == SeverityProfile::kWhileGrasping)
    reads |= ROBOSTRESS_READS_GRASP;
  if (errors.sticks || !chain.effects(EffectStage::kJoint).empty())
    reads |= ROBOSTRESS_READS_MASSES;
  for (int i = 0; i < chain.joints(); ++i)
    if (chain.coupled(i) >= 0) reads |= ROBOSTRESS_READS_ACCELERATION;
  return reads;
}

absl::Status CheckArray(const char* name, const double* values, int count, bool needed) {
  if (values == nullptr) {
    if (!needed) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat(name, " is NULL, and these errors read it; see robostress_errors_reads"));
  }
  for (int i = 0; i < count; ++i) {
    if (!std::isfinite(values[i])) {
      return absl::InvalidArgumentError(
          absl::StrCat(name, "[", i, "] is ", values[i], ", must be finite"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckMoment(const robostress_errors& errors, const robostress_moment& m) {
  const int n = errors.chain.joints();
  const unsigned reads = Reads(errors);
  if (!std::isfinite(m.time))
    return absl::InvalidArgumentError(absl::StrCat("time is ", m.time, " s, must be finite"));
  if (!(m.step > 0 && m.step <= 1)) {
    return absl::InvalidArgumentError(
        absl::StrCat("step is ", m.step, " s, must be above 0 and at most 1"));
  }
  const bool payload = reads & ROBOSTRESS_READS_PAYLOAD, masses = reads & ROBOSTRESS_READS_MASSES;
  RS_RETURN_IF_ERROR(CheckArray("q", m.q, n, true));
  RS_RETURN_IF_ERROR(CheckArray("dq", m.dq, n, true));
  RS_RETURN_IF_ERROR(CheckArray("gravity", m.gravity, n, reads & ROBOSTRESS_READS_GRAVITY));
  RS_RETURN_IF_ERROR(CheckArray("payload_gravity", m.payload_gravity, n, payload));
  RS_RETURN_IF_ERROR(CheckArray("payload_inertia", m.payload_inertia, n, payload));
  RS_RETURN_IF_ERROR(
      CheckArray("tilt_gravity", m.tilt_gravity, 2 * n, reads & ROBOSTRESS_READS_TILT));
  RS_RETURN_IF_ERROR(CheckArray("mass_matrix", m.mass_matrix, n * n, masses));
  RS_RETURN_IF_ERROR(CheckArray("ddq", m.ddq, n, reads & ROBOSTRESS_READS_ACCELERATION));
  RS_RETURN_IF_ERROR(CheckArray("temperature", m.temperature, n, false));
  RS_RETURN_IF_ERROR(CheckArray("other_torque", m.other_torque, n, masses));
  for (int i = 0; i < n && masses; ++i) {
    if (m.mass_matrix[i * n + i] > 0) continue;
    return absl::InvalidArgumentError(absl::StrCat("mass_matrix[", i, "][", i, "] is ",
                                                   m.mass_matrix[i * n + i], ", must be above 0"));
  }
  for (int i = 0; i < n; ++i) {
    const double low = m.torque_low == nullptr ? 0 : m.torque_low[i];
    const double high = m.torque_high == nullptr ? 0 : m.torque_high[i];
    if (low <= 0 && high >= 0) continue;
    return absl::InvalidArgumentError(absl::StrCat("torque_low[", i, "] is ", low, ", torque_high[",
                                                   i, "] ", high, " Nm, must have 0 between them"));
  }
  return absl::OkStatus();
}

namespace {

// As PandaSim describes its joints.
void Describe(const JointChain& chain, const robostress_moment& from,
              std::vector<JointMoment>& moments) {
  for (int i = 0; i < chain.joints(); ++i) {
    JointMoment& m = moments[static_cast<size_t>(i)] = {};
    m.t = from.time;
    m.h = from.step;
    m.q = chain.MotorAngle(i, from.q[i]);
    m.dq = from.dq[i];
    if (const int other = chain.coupled(i); other >= 0) {
      m.coupled_q = from.q[other];
      m.coupled_dq = from.dq[other];
      m.coupled_ddq = from.ddq[other];
    }
    if (from.temperature != nullptr) m.temperature = from.temperature[i];
    if (from.gravity != nullptr) m.gravity = from.gravity[i];
    if (from.payload_gravity != nullptr) m.payload_gravity = from.payload_gravity[i];
    if (from.payload_inertia != nullptr) m.payload_inertia = from.payload_inertia[i];
    for (int axis = 0; axis < 2 && from.tilt_gravity != nullptr; ++axis)
      m.tilt_gravity[axis] = from.tilt_gravity[2 * i + axis];
  }
}

// The arm as the caller describes it. n is 7, whose arithmetic is then PandaSim's, or dynamic.
template <int n>
struct GivenPlant {
  using Vector = Eigen::Matrix<double, n, 1>;
  using Mass = Eigen::Matrix<double, n, n>;
  using Inverse = Mass;
  const robostress_moment& moment;
  Eigen::Index joints;
  double rest = 0, h = moment.step;

  Vector Limited(const Vector& torque) const {
    Vector limited = torque;
    if (moment.torque_low != nullptr)
      limited = limited.cwiseMax(Eigen::Map<const Vector>(moment.torque_low, joints));
    if (moment.torque_high != nullptr)
      limited = limited.cwiseMin(Eigen::Map<const Vector>(moment.torque_high, joints));
    return limited;
  }
  Vector Net(const Vector& torque) const {
    return torque + Eigen::Map<const Vector>(moment.other_torque, joints);
  }
  Mass MassMatrix() const { return Eigen::Map<const Mass>(moment.mass_matrix, joints, joints); }
  Vector Velocities() const { return Eigen::Map<const Vector>(moment.dq, joints); }
};

template <int n>
void ApplyTorque(robostress_errors& errors, const robostress_moment& moment, const double* asked,
                 double* applied) {
  using Plant = GivenPlant<n>;
  using Vector = typename Plant::Vector;
  const Eigen::Index joints = errors.chain.joints();
  const Vector wished = Eigen::Map<const Vector>(asked, joints);
  const Vector none = Vector::Zero(joints);
  Eigen::Map<Vector>(applied, joints) = SubStepTorque(errors.chain, absl::MakeSpan(errors.moments),
                                                      wished, none, Plant{moment, joints});
}

}  // namespace

absl::Status Reset(robostress_errors& errors, const robostress_moment& at, const double* holding) {
  RS_RETURN_IF_ERROR(CheckMoment(errors, at));
  const int joints = errors.chain.joints();
  RS_RETURN_IF_ERROR(CheckArray("holding", holding, joints, false));
  Describe(errors.chain, at, errors.moments);
  for (int i = 0; i < joints; ++i) {
    errors.moments[static_cast<size_t>(i)].q = at.q[i];
    if (holding != nullptr) errors.moments[static_cast<size_t>(i)].drive = holding[i];
  }
  errors.chain.Reset(errors.moments);
  errors.begun = true;
  errors.asked = false;
  return absl::OkStatus();
}

void ApplyErrors(robostress_errors& errors, const robostress_moment& at, const double* asked,
                 double* applied) {
  const int joints = errors.chain.joints();
  errors.chain.BeginSubStep(at.step);
  std::copy_n(at.q, joints, errors.q.begin());
  Describe(errors.chain, at, errors.moments);
  joints == 7 ? ApplyTorque<7>(errors, at, asked, applied)
              : ApplyTorque<Eigen::Dynamic>(errors, at, asked, applied);
}

void MoveOffsets(robostress_errors& errors, const double* applied, double* change) {
  const auto joints = static_cast<size_t>(errors.chain.joints());
  for (JointMoment& m : errors.moments) m.q += m.h * m.dq;
  std::fill_n(change, joints, 0.0);
  errors.chain.MoveErrors(errors.q, {applied, joints}, errors.moments[0].h, {change, joints});
  errors.chain.MoveEffects(errors.moments, {change, joints});
}

absl::Status CheckBegun(const robostress_errors& errors) {
  return errors.begun ? absl::OkStatus()
                      : absl::FailedPreconditionError(
                            "no episode has begun: call robostress_errors_reset first");
}

namespace {

absl::Status Torque(robostress_errors* errors, const robostress_moment* moment, const double* asked,
                    double* applied) {
  RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
  RS_RETURN_IF_ERROR(CheckHandle("asked", asked));
  RS_RETURN_IF_ERROR(CheckHandle("applied", applied));
  RS_RETURN_IF_ERROR(CheckBegun(*errors));
  robostress_moment given = {};
  RS_RETURN_IF_ERROR(ReadStructure("moment", moment, given));
  RS_RETURN_IF_ERROR(CheckMoment(*errors, given));
  RS_RETURN_IF_ERROR(CheckArray("asked", asked, errors->chain.joints(), true));
  ApplyErrors(*errors, given, asked, applied);
  errors->asked = true;
  return absl::OkStatus();
}

absl::Status OffsetChange(robostress_errors* errors, const double* applied, double* change) {
  RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
  RS_RETURN_IF_ERROR(CheckHandle("change", change));
  RS_RETURN_IF_ERROR(CheckArray("applied", applied, errors->chain.joints(), true));
  if (!errors->asked) {
    return absl::FailedPreconditionError(
        "the sub-step has not begun: call robostress_errors_torque before each call");
  }
  errors->asked = false;
  MoveOffsets(*errors, applied, change);
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress

using robostress::AtBoundary;
using robostress::CheckHandle;

extern "C" {

void robostress_options_default(robostress_options* options) {
  robostress_options defaults = {sizeof(defaults), 5, 300, "sgn", 0.01, "zero", "literal", nullptr};
  if (options != nullptr) robostress::CopyStructure(defaults, *options);
}

robostress_code robostress_errors_new(const char* scenario, int joints,
                                      const robostress_options* options,
                                      robostress_errors** created, char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("created", created));
    robostress_options given;
    given.size = sizeof(given);
    robostress_options_default(&given);
    if (options != nullptr)
      RS_RETURN_IF_ERROR(robostress::ReadStructure("options", options, given));
    RS_ASSIGN_OR_RETURN(const robostress::JointChain chain,
                        robostress::MakeChain(scenario, joints, given));
    const bool sticks =
        std::string_view(given.friction_law) == "stick" && chain.severity().scenario().friction_on;
    *created = new robostress_errors(chain, sticks);
    return absl::OkStatus();
  });
}

robostress_code robostress_errors_add_effect(robostress_errors* errors, int joint, const char* type,
                                             const double* values, size_t count, int coupled,
                                             char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
    RS_RETURN_IF_ERROR(CheckHandle("type", type));
    RS_ASSIGN_OR_RETURN(const robostress::EffectInfo* effect, robostress::FindEffect(type));
    RS_RETURN_IF_ERROR(
        robostress::CheckEffect(errors->chain, joint, *effect, values, count, coupled));
    errors->chain.Add(joint, *effect, {values, count}, coupled);
    errors->begun = errors->asked = false;
    return absl::OkStatus();
  });
}

void robostress_errors_free(robostress_errors* errors) { delete errors; }

robostress_code robostress_errors_copy(const robostress_errors* from, robostress_errors** created,
                                       char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("from", from));
    RS_RETURN_IF_ERROR(CheckHandle("created", created));
    *created = new robostress_errors(*from);
    (*created)->attached = {};
    return absl::OkStatus();
  });
}

robostress_code robostress_errors_restore(robostress_errors* to, const robostress_errors* from,
                                          char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("to", to));
    RS_RETURN_IF_ERROR(CheckHandle("from", from));
    robostress_errors copy(*from);  // whatever fails, fails here
    copy.attached = to->attached;
    *to = std::move(copy);
    return absl::OkStatus();
  });
}

int robostress_errors_joints(const robostress_errors* errors) {
  return errors == nullptr ? 0 : errors->chain.joints();
}

unsigned robostress_errors_reads(const robostress_errors* errors) {
  return errors == nullptr ? 0 : robostress::Reads(*errors);
}

robostress_code robostress_errors_reset(robostress_errors* errors, const robostress_moment* moment,
                                        const double* holding, char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("errors", errors));
    robostress_moment given = {};
    RS_RETURN_IF_ERROR(robostress::ReadStructure("moment", moment, given));
    return robostress::Reset(*errors, given, holding);
  });
}

void robostress_errors_begin_control_step(robostress_errors* errors, int steps_done, int held) {
  if (errors == nullptr) return;
  errors->chain.BeginControlStep(std::max(0, steps_done), held != 0);
  errors->attached.row = 0;
}

robostress_code robostress_errors_torque(robostress_errors* errors, const robostress_moment* moment,
                                         const double* asked, double* applied, char* error,
                                         size_t error_size) {
  return AtBoundary(error, error_size,
                    [&] { return robostress::Torque(errors, moment, asked, applied); });
}

robostress_code robostress_errors_offset_change(robostress_errors* errors, const double* applied,
                                                double* change, char* error, size_t error_size) {
  return AtBoundary(error, error_size,
                    [&] { return robostress::OffsetChange(errors, applied, change); });
}

robostress_code robostress_errors_sub_step(robostress_errors* errors,
                                           const robostress_moment* moment, const double* asked,
                                           double* applied, double* change, char* error,
                                           size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("change", change));
    RS_RETURN_IF_ERROR(robostress::Torque(errors, moment, asked, applied));
    return robostress::OffsetChange(errors, applied, change);
  });
}

void robostress_errors_offset(const robostress_errors* errors, double* offset) {
  for (int i = 0; i < robostress_errors_joints(errors) && offset != nullptr; ++i)
    offset[i] = errors->chain.offset(i);
}

void robostress_errors_reading(const robostress_errors* errors, const double* q, const double* dq,
                               double* reading, double* rate) {
  for (int i = 0; i < robostress_errors_joints(errors); ++i) {
    if (q != nullptr && reading != nullptr) reading[i] = errors->chain.Reading(i, q[i]);
    if (q != nullptr && dq != nullptr && rate != nullptr)
      rate[i] = errors->chain.ReadingSlope(i, q[i]) * dq[i];
  }
}

}  // extern "C"
