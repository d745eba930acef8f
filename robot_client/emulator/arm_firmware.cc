#include "robot_client/emulator/arm_firmware.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress::piper {
namespace {

constexpr double kStep_s = PiperPlant::kStep_s;
constexpr uint64_t kFastSteps = 5;     // 200 Hz
constexpr uint64_t kDriverSteps = 25;  // 40 Hz
constexpr size_t kMaxDelayed = 4096;  // target frames on their way; more are lost, as on a full bus

// Gains of the joints' servos [Nm/rad], [Nm s/rad] and the time constant of the integral part. The
// feedback of a Piper of firmware S-V1.8-6 stays within 0.2 degrees of its targets while J2 carries
// 3.9 A, 4.6 Nm (piper_sdk issue 119); these gains do. kDirect has fixed gains without integral
// part: those of MuJoCo Menagerie's agilex_piper.
struct Gains {
  double kp, kd;
};
constexpr std::array<Gains, kJoints> kServo = {
    {{200, 12}, {200, 12}, {200, 8}, {60, 1.2}, {60, 1.2}, {60, 1}}};
constexpr std::array<Gains, kJoints> kImpedance = {
    {{80, 5}, {80, 5}, {80, 5}, {40, 1.2}, {10, 0.8}, {10, 0.8}}};
constexpr double kIntegralTime_s = 0.3;
constexpr double kIntegralShare = 0.3;  // of the torque limit, at most
// The damped stop: the motors brake like a viscous damper and the arm sinks [Nm s/rad].
constexpr JointVector kBrake = {40, 40, 40, 8, 8, 8};
// While the controller leads the tool along a way its servos are stiffer, and it makes up for the
// friction of an arm as delivered (wear_profile.cc): without both, every reversal of a joint bends
// a line by 2 mm.
constexpr double kPathStiffness = 3;
constexpr JointVector kKnownFriction = {0.30, 0.30, 0.30, 0.15, 0.15, 0.15};  // [Nm]
constexpr double kFrictionSpeed = 0.01;  // over which its sign changes [rad/s]
constexpr double kLeaderDamping = 0.05;  // of kBrake, in leader mode

// A motor that gives this share of its largest torque for this long without moving is stalled.
constexpr double kStallTorque = 0.95, kStallTime_s = 0.5, kStallSpeed = 0.05;
// The target counts as reached when the joint is this close [rad].
constexpr double kReached = 0.01;

// Finger drive: force per commanded torque [N/Nm] and its servo [N/m], [N s/m].
constexpr double kForcePerTorque = 10;
constexpr Gains kFinger = {2000, 60};

bool IsTarget(const CanFrame& frame) {
  return DecodeJointTargets(frame) || DecodeGripperTarget(frame) || DecodePoseTarget(frame) ||
         DecodeMitTarget(frame) || DecodeArcPoint(frame);
}

}  // namespace

ArmFirmware::ArmFirmware(const FirmwareOptions& options)
    : options_(options), settings_(options.gripper_range) {}

// Commands move to 0x16x or 0x17x with the arm's setting; 0x15x is then somebody else's.
void ArmFirmware::Take(const CanFrame& received) {
  CanFrame frame = received;
  const uint16_t offset = settings_.command_offset();
  if (frame.id >= kStopControl && frame.id < kStopControl + 0x30 && offset != 0) {
    if ((frame.id & 0x7F0) != (kStopControl & 0x7F0) + offset) return;
    frame.id = static_cast<uint16_t>(frame.id - offset);
  }
  if (limp() && frame.id >= kModeControl && frame.id <= kLastCommand) return;
  if (IsTarget(frame)) {
    if (delayed_.size() < kMaxDelayed) {
      const double lag_steps = std::round(options_.command_lag_s / kStep_s);
      delayed_.push_back({step_ + static_cast<uint64_t>(lag_steps), frame});
    }
  } else if (const auto stop = DecodeStop(frame)) {
    TakeStop(*stop);
  } else if (const auto mode = DecodeModeControl(frame)) {
    mode_ = *mode;
  } else if (const auto power = DecodeMotorPower(frame)) {
    TakePower(*power);
    replies_.push_back(EncodeWriteReply(frame.id, false));
  } else if (const auto limit_query = DecodeLimitQuery(frame)) {
    TakeLimitQuery(*limit_query);
  } else if (IsFirmwareQuery(frame)) {
    // Text over several frames, the version in the middle of it.
    const std::string text = absl::StrCat("H-V1.2-1", FirmwareName(options_.version));
    for (size_t at = 0; at < text.size(); at += 8)
      replies_.push_back(EncodeFirmwareText(std::string_view(text).substr(at, 8)));
  } else if (frame.id == kJointConfig && frame.size == 8) {
    TakeJointConfig(frame);
  } else {
    settings_.Take(frame, replies_);
  }
}

void ArmFirmware::TakeStop(Stop stop) {
  if (stop == Stop::kQuick) {
    stopped_ = true;
  } else if (stop == Stop::kReset) {
    stopped_ = false;
    latched_ = StatusCode::kNormal;
    mode_ = {};
    for (Power& power : power_) {
      power.enabled = false;
      power.deaf = 1;
      power.fault_bits = 0;
    }
    gripper_enabled_ = false;
    beyond_limit_.fill(false);
    pose_unreachable_ = false;
    mit_.fill(std::nullopt);
    delayed_.clear();
    path_.Stop();
    arc_waits_ = false;
    line_goal_.reset();
  }
}

void ArmFirmware::TakePower(const MotorPower& power) {
  for (int j = 0; j < kJoints; ++j) {
    if (power.motor != kAllMotors && power.motor != j + 1) continue;
    Power& motor = power_[j];
    if (!power.enable) {
      motor.enabled = false;
    } else if (motor.deaf > 0) {
      --motor.deaf;
    } else if (!motor.enabled && !stopped_ && motor.fault_bits == 0 && !motor.silent) {
      motor.enabled = true;
      motor.integral = 0;
      planners_[j].Reset(last_.q[j]);
    }
  }
  if (power.motor == kAllMotors) {
    if (power.enable && !gripper_enabled_) gripper_target_ = {last_.opening, 1.0, true};
    gripper_enabled_ = power.enable;
  }
}

void ArmFirmware::TakeLimitQuery(const LimitQuery& query) {
  const int joint = query.motor - 1;
  if (power_[joint].silent) return;
  replies_.push_back(query.acceleration
                         ? Encode(JointAcceleration{joint, settings_.acceleration(joint)})
                         : Encode(settings_.limit(joint)));
}

// Zero, acceleration and cleared errors of one motor, or of all.
void ArmFirmware::TakeJointConfig(const CanFrame& frame) {
  constexpr uint8_t kYes = 0xAE;
  const int motor = frame.data[0];
  if (motor < 1 || motor > kAllMotors) return;
  if (frame.data[5] == kYes) {
    for (int j = 0; j < kJoints; ++j) {
      if (motor == kAllMotors || motor == j + 1) power_[j].fault_bits = 0;
    }
  }
  const bool zero_set = frame.data[1] == kYes && SetZero(motor);
  std::vector<CanFrame> acknowledged;
  settings_.Take(frame, acknowledged);
  replies_.push_back(EncodeWriteReply(frame.id, zero_set));
}

// Refused while a motor holds: its target would jump with its zero.
bool ArmFirmware::SetZero(int motor) {
  for (int j = 0; j < kJoints; ++j) {
    if ((motor == kAllMotors || motor == j + 1) && power_[j].enabled) return false;
  }
  for (int j = 0; j < kJoints; ++j) {
    if (motor != kAllMotors && motor != j + 1) continue;
    zero_[j] += last_.q[j];
    last_.q[j] = 0;
    planners_[j].Reset(0);
  }
  return true;
}

PlantReading ArmFirmware::InOwnZeros(PlantReading reading) const {
  for (int j = 0; j < kJoints; ++j) reading.q[j] -= zero_[j];
  reading.opening -= gripper_zero_;
  return reading;
}

void ArmFirmware::ApplyTarget(const CanFrame& frame) {
  if (const auto gripper = DecodeGripperTarget(frame)) {
    gripper_enabled_ = gripper->enable;
    if (gripper->set_zero && !gripper->enable) {
      gripper_zero_ += last_.opening;
      last_.opening = 0;
    }
    gripper_target_ = *gripper;
    gripper_target_.opening = std::clamp(gripper->opening, 0.0, kGripperOpening);
  } else if (const auto pair = DecodeJointTargets(frame)) {
    ApplyJointTargets(*pair);
  } else if (const auto pose = DecodePoseTarget(frame)) {
    ApplyPoseTarget(*pose);
  } else if (const auto mit = DecodeMitTarget(frame)) {
    mit_[mit->joint] = *mit;
  } else if (const auto point = DecodeArcPoint(frame)) {
    ApplyArcPoint(*point);
  }
}

std::array<Range, kJoints> ArmFirmware::Limits() const {
  std::array<Range, kJoints> limits;
  for (int j = 0; j < kJoints; ++j)
    limits[j] = {settings_.limit(j).lower, settings_.limit(j).upper};
  return limits;
}

ToolTarget ArmFirmware::PlannedTool() const {
  JointVector q;
  for (int j = 0; j < kJoints; ++j) q[j] = planners_[j].position();
  const Eigen::Isometry3d T = ToolPose(q, ZeroOf(options_.version));
  return {T.translation(), Eigen::Quaterniond(T.linear())};
}

// A pose counts when its last frame is there: mode P goes there joint by joint, mode L leads the
// tool along a line, mode C keeps it until 0x158 says which point of the arc it is.
void ArmFirmware::ApplyPoseTarget(const JointPair& pair) {
  pose_target_[2 * pair.pair] = pair.first;
  pose_target_[2 * pair.pair + 1] = pair.second;
  const bool moves = mode_.move == MoveMode::kP || mode_.move == MoveMode::kL;
  if (pair.pair != 2 || mode_.control != ControlMode::kCan || !moves) return;
  const ToolTarget goal = {
      {pose_target_[0], pose_target_[1], pose_target_[2]},
      Eigen::Quaterniond(FromFixedAngles({pose_target_[3], pose_target_[4], pose_target_[5]}))};
  if (mode_.move == MoveMode::kL && line_goal_ && line_goal_->p == goal.p &&
      line_goal_->R.coeffs() == goal.R.coeffs())
    return;
  arc_waits_ = false;
  JointVector start;
  for (int j = 0; j < kJoints; ++j)
    start[j] = path_.active() ? planners_[j].position() : last_.q[j];
  const auto q =
      SolvePose(goal.p, goal.R.toRotationMatrix(), start, Limits(), ZeroOf(options_.version));
  pose_unreachable_ = !q.has_value();
  line_goal_.reset();
  if (mode_.move == MoveMode::kL && q) {
    path_.StartLine(PlannedTool(), goal, path_.velocity());
    line_goal_ = goal;
  } else {
    path_.Stop();
    for (int j = 0; j < kJoints && q; ++j) planners_[j].SetTarget((*q)[j]);
  }
}

// With the third point the joints bring the tool to the first; FollowPath then leads it on.
void ArmFirmware::ApplyArcPoint(int point) {
  if (mode_.control != ControlMode::kCan || mode_.move != MoveMode::kC) return;
  arc_points_[point - 1] = {
      {pose_target_[0], pose_target_[1], pose_target_[2]},
      Eigen::Quaterniond(FromFixedAngles({pose_target_[3], pose_target_[4], pose_target_[5]}))};
  const bool complete = point == 3 && last_arc_point_ == 2;
  last_arc_point_ = point == last_arc_point_ + 1 || point == 1 ? point : 0;
  if (!complete) return;
  last_arc_point_ = 0;
  path_.Stop();
  line_goal_.reset();
  const auto q = SolvePose(arc_points_[0].p, arc_points_[0].R.toRotationMatrix(), last_.q, Limits(),
                           ZeroOf(options_.version));
  pose_unreachable_ = !q.has_value();
  for (int j = 0; j < kJoints && q; ++j) planners_[j].SetTarget((*q)[j]);
  arc_waits_ = q.has_value();
}

// The joints' references from the tool's. Where they would have to be faster than they may, the
// tool waits for them; where the way leaves what they reach, the arm stops and says so.
void ArmFirmware::FollowPath() {
  if (arc_waits_ && std::all_of(planners_.begin(), planners_.end(),
                                [](const JointPlanner& p) { return p.at_target(); })) {
    arc_waits_ = false;
    pose_unreachable_ = !path_.StartArc(arc_points_[0], arc_points_[1], arc_points_[2]);
  }
  if (!path_.active()) return;
  JointVector before;
  for (int j = 0; j < kJoints; ++j) before[j] = planners_[j].position();
  path_.Step(settings_.tool(), mode_.speed_percent, kStep_s);
  std::optional<JointVector> q;
  for (int attempt = 0; attempt < 2; ++attempt) {
    const ToolTarget tool = path_.target();
    q = SolvePose(tool.p, tool.R.toRotationMatrix(), before, Limits(), ZeroOf(options_.version),
                  1e-9);
    if (!q) break;
    double excess = 1;
    for (int j = 0; j < kJoints; ++j)
      excess = std::max(excess, std::abs((*q)[j] - before[j]) / (MaxSpeed(j) * kStep_s));
    if (excess <= 1) break;
    path_.SlowDown(1 / excess);
  }
  if (!q) {
    path_.Stop();
    pose_unreachable_ = true;
    return;
  }
  const bool ends = path_.at_end();
  for (int j = 0; j < kJoints; ++j)
    planners_[j].Follow((*q)[j], ends ? 0 : ((*q)[j] - before[j]) / kStep_s);
  if (ends) path_.Stop();
}

// A target beyond a limit is not clamped: the arm reports it and no joint follows until the targets
// are within the limits again (piper_sdk issue 94).
void ArmFirmware::ApplyJointTargets(const JointPair& pair) {
  if (mode_.control != ControlMode::kCan || mode_.move != MoveMode::kJ) return;
  path_.Stop();
  arc_waits_ = false;
  line_goal_.reset();
  constexpr double kResolution = 1e-5;  // [rad], half of the wire's
  for (const auto& [joint, target] :
       {std::pair{2 * pair.pair, pair.first}, std::pair{2 * pair.pair + 1, pair.second}}) {
    beyond_limit_[joint] = target < settings_.limit(joint).lower - kResolution ||
                           target > settings_.limit(joint).upper + kResolution;
    if (!beyond_limit_[joint]) planners_[joint].SetTarget(target);
  }
}

double ArmFirmware::ServoTorque(int joint, const PlantReading& reading) {
  Power& power = power_[joint];
  if (!power.enabled) return 0;
  if (stopped_) return -kBrake[joint] * reading.dq[joint];
  if (limp()) {  // a person leads it
    power.integral = 0;
    return options_.gravity_feedforward[joint] * reading.gravity[joint] -
           kLeaderDamping * kBrake[joint] * reading.dq[joint];
  }
  if (mode_.move == MoveMode::kM && mit_[joint]) {
    const MitTarget& mit = *mit_[joint];
    power.integral = 0;
    const double torque = mit.kp * (mit.position - reading.q[joint]) +
                          mit.kd * (mit.velocity - reading.dq[joint]) +
                          CurrentScale(options_.version, joint) * mit.feedforward;
    return std::clamp(torque, -TorqueLimit(joint), TorqueLimit(joint));
  }
  const bool direct = mode_.follow == Follow::kDirect;
  const JointPlanner& planner = planners_[joint];
  Gains gains = direct ? kImpedance[joint] : kServo[joint];
  if (path_.active()) gains = {kPathStiffness * gains.kp, std::sqrt(kPathStiffness) * gains.kd};
  const double error = planner.position() - reading.q[joint];
  if (direct) {
    power.integral = 0;
  } else {
    const double most = kIntegralShare * TorqueLimit(joint);
    power.integral =
        std::clamp(power.integral + gains.kp * error * kStep_s / kIntegralTime_s, -most, most);
  }
  const double friction =
      path_.active() ? kKnownFriction[joint] * std::tanh(planner.velocity() / kFrictionSpeed) : 0;
  const double torque = gains.kp * error + gains.kd * (planner.velocity() - reading.dq[joint]) +
                        power.integral + friction +
                        options_.gravity_feedforward[joint] * reading.gravity[joint];
  return std::clamp(torque, -TorqueLimit(joint), TorqueLimit(joint));
}

void ArmFirmware::WatchStall(int joint, double torque, const PlantReading& reading) {
  Power& power = power_[joint];
  const bool strained = std::abs(torque) >= kStallTorque * TorqueLimit(joint) &&
                        std::abs(reading.dq[joint]) < kStallSpeed;
  power.stalled_s = strained ? power.stalled_s + kStep_s : 0;
  if (power.stalled_s >= kStallTime_s) {
    RaiseDriverFault(joint, kStall);
    RaiseStatus(StatusCode::kJointStatus);
  }
}

double ArmFirmware::FingerForce(const PlantReading& reading) const {
  if (!gripper_enabled_ || limp()) return 0;
  const double most = kForcePerTorque * gripper_target_.effort;
  const double force = kFinger.kp * 0.5 * (gripper_target_.opening - reading.opening) -
                       kFinger.kd * 0.5 * reading.opening_speed;
  return std::clamp(force, -most, most);
}

double ArmFirmware::MaxSpeed(int joint) const {
  return std::min(settings_.limit(joint).max_speed, kMaxJointSpeed);
}

ArmFirmware::Torques ArmFirmware::Step(const PlantReading& plant) {
  last_ = InOwnZeros(plant);
  while (!delayed_.empty() && delayed_.front().due_step <= step_) {
    ApplyTarget(delayed_.front().frame);
    delayed_.pop_front();
  }
  const PlantReading reading = last_;
  const bool refused = std::count(beyond_limit_.begin(), beyond_limit_.end(), true) > 0;
  // A latched fault freezes the arm where it is; it holds until the reset.
  const bool frozen = refused || pose_unreachable_ || latched_ != StatusCode::kNormal;
  const bool powered =
      std::all_of(power_.begin(), power_.end(), [](const Power& power) { return power.enabled; });
  if (!powered || stopped_ || frozen) {
    path_.Stop();
    arc_waits_ = false;
    line_goal_.reset();
  }
  FollowPath();
  Torques torques;
  for (int j = 0; j < kJoints; ++j) {
    JointPlanner& planner = planners_[j];
    const bool torque_mode = mode_.move == MoveMode::kM && mit_[j].has_value();
    if (!power_[j].enabled || stopped_ || torque_mode || limp()) {
      planner.Reset(reading.q[j]);
    } else if (frozen) {
      planner.Brake(settings_.acceleration(j), kStep_s);
    } else if (path_.active()) {
      // FollowPath has moved it.
    } else if (mode_.follow == Follow::kDirect) {
      planner.Jump();
    } else {
      planner.Step(MaxSpeed(j) * mode_.speed_percent / 100, settings_.acceleration(j), kStep_s);
    }
    torques.motor[j] = ServoTorque(j, reading);
    WatchStall(j, torques.motor[j], reading);
  }
  torques.finger_force = FingerForce(reading);
  UpdateStatus(reading);
  ++step_;
  return torques;
}

void ArmFirmware::UpdateStatus(const PlantReading& reading) {
  status_.control = teaching_ ? ControlMode::kTeach : mode_.control;
  status_.move = mode_.move;
  status_.joint_limit = status_.joint_bus = 0;
  status_.moving = false;
  for (int j = 0; j < kJoints; ++j) {
    const auto bit = static_cast<uint8_t>(1 << j);
    if (beyond_limit_[j]) status_.joint_limit |= bit;
    if (power_[j].silent) status_.joint_bus |= bit;
    status_.moving =
        status_.moving ||
        (power_[j].enabled &&
         (!planners_[j].at_target() || std::abs(planners_[j].target() - reading.q[j]) > kReached));
  }
  if (stopped_) {
    status_.code = StatusCode::kEmergencyStop;
  } else if (latched_ != StatusCode::kNormal) {
    status_.code = latched_;
  } else if (pose_unreachable_) {
    status_.code = StatusCode::kNoSolution;
  } else if (status_.joint_bus != 0) {
    status_.code = StatusCode::kJointBus;
  } else {
    status_.code = status_.joint_limit != 0 ? StatusCode::kTargetLimit : StatusCode::kNormal;
  }
}

void ArmFirmware::TakeReports(const PlantReading& plant, std::vector<CanFrame>& frames) {
  frames.clear();
  frames.swap(replies_);
  if (step_ % kFastSteps == 0) {
    const PlantReading reading = InOwnZeros(plant);
    ReportFast(reading, frames);
    if (settings_.leader()) {
      CommandFollower(reading, frames);
    } else {
      ReportState(reading, frames);
    }
  }
  if (step_ % kDriverSteps == 0) ReportDrivers(frames);
  if (silent_) frames.clear();
}

void ArmFirmware::ReportFast(const PlantReading& reading, std::vector<CanFrame>& frames) const {
  for (int j = 0; j < kJoints; ++j) {
    if (power_[j].silent) continue;
    const double current =
        reading.torque[j] / (TorquePerAmpere(j) * CurrentScale(options_.version, j));
    frames.push_back(Encode(JointSpeed{j, reading.dq[j], current}));
  }
}

void ArmFirmware::ReportState(const PlantReading& reading, std::vector<CanFrame>& frames) const {
  const size_t first = frames.size();
  frames.push_back(Encode(status_));
  JointVector q;
  for (int j = 0; j < kJoints; ++j) q[j] = RoundToWire(reading.q[j]);
  const Eigen::Isometry3d T_base_tool = ToolPose(q, ZeroOf(options_.version));
  const Eigen::Vector3d p = T_base_tool.translation(), rpy = FixedAngles(T_base_tool.linear());
  frames.push_back(EncodeEndPose(0, p.x(), p.y()));
  frames.push_back(EncodeEndPose(1, p.z(), rpy[0]));
  frames.push_back(EncodeEndPose(2, rpy[1], rpy[2]));
  for (int pair = 0; pair < kJoints / 2; ++pair)
    frames.push_back(EncodeJointAngles({pair, q[2 * pair], q[2 * pair + 1]}));
  GripperStatus gripper;
  // A gripper whose range was never set reports no opening (the SDK's Q&A, 1).
  gripper.opening = settings_.gripper_range() > 0 ? reading.opening : 0;
  gripper.effort = reading.grip_force / kForcePerTorque;
  gripper.enabled = gripper_enabled_;
  gripper.homed = true;
  frames.push_back(Encode(gripper));
  for (size_t i = first; i < frames.size(); ++i)
    frames[i].id = static_cast<uint16_t>(frames[i].id + settings_.feedback_offset());
}

// A leader sends what its follower obeys, where it stands as the target.
void ArmFirmware::CommandFollower(const PlantReading& reading,
                                  std::vector<CanFrame>& frames) const {
  const size_t first = frames.size();
  frames.push_back(Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 100, Follow::kDirect}));
  for (int pair = 0; pair < kJoints / 2; ++pair)
    frames.push_back(EncodeJointTargets({pair, reading.q[2 * pair], reading.q[2 * pair + 1]}));
  GripperTarget gripper;
  gripper.opening = reading.opening;
  gripper.effort = 1;
  frames.push_back(Encode(gripper));
  for (size_t i = first; i < frames.size(); ++i)
    frames[i].id = static_cast<uint16_t>(frames[i].id + settings_.leader_offset());
}

void ArmFirmware::ReportDrivers(std::vector<CanFrame>& frames) const {
  for (int j = 0; j < kJoints; ++j) {
    if (power_[j].silent) continue;
    DriverStatus driver;
    driver.joint = j;
    driver.supply_V = 24;
    driver.driver_temperature = 35;
    driver.motor_temperature = 30;
    driver.bits = power_[j].fault_bits;
    if (power_[j].enabled) driver.bits |= kEnabled;
    driver.bus_current = 0.1;
    frames.push_back(Encode(driver));
  }
}

void ArmFirmware::RaiseDriverFault(int joint, DriverBit bit) { power_[joint].fault_bits |= bit; }

void ArmFirmware::SetTeaching(bool teaching) {
  if (teaching == teaching_) return;
  teaching_ = teaching;
  mode_ = {};
  mit_.fill(std::nullopt);
  delayed_.clear();
  path_.Stop();
  for (int j = 0; j < kJoints; ++j) {
    power_[j].enabled = power_[j].fault_bits == 0;
    power_[j].integral = 0;
    planners_[j].Reset(last_.q[j]);
  }
  gripper_target_ = {last_.opening, 1.0, true};
  gripper_enabled_ = true;
}

void ArmFirmware::SetLeader() {
  settings_.SetLeader(true);
  for (Power& power : power_) power.enabled = true;
}

void ArmFirmware::RaiseStatus(StatusCode code) {
  if (latched_ == StatusCode::kNormal) latched_ = code;
}

void ArmFirmware::SetJointSilent(int joint, bool silent) { power_[joint].silent = silent; }

}  // namespace robostress::piper
