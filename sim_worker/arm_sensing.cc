#include "sim_worker/arm_sensing.h"

#include <utility>

#include "common/joint_errors/joint_chain.h"
#include "common/status_macros.h"

namespace robostress {

struct ArmSensing::Kinematics {
  explicit Kinematics(const mjModel& model) : data(mj_makeData(&model)) {}
  ~Kinematics() { mj_deleteData(data); }
  Kinematics(const Kinematics&) = delete;
  Kinematics& operator=(const Kinematics&) = delete;
  mjData* const data;
};

ArmSensing::ArmSensing(SharedModel model, const SensingOptions& options, const PandaModel& panda)
    : model_(std::move(model)),
      options_(options),
      panda_(panda),
      kinematics_(std::make_unique<Kinematics>(*model_)),
      noise_(StreamKey("sim/sensing")) {}

ArmSensing::~ArmSensing() = default;

absl::StatusOr<std::unique_ptr<ArmSensing>> ArmSensing::Create(SharedModel model,
                                                               const SensingOptions& options) {
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(*model));
  std::unique_ptr<ArmSensing> sensing(new ArmSensing(std::move(model), options, panda));
  if (sensing->kinematics_->data == nullptr)
    return absl::ResourceExhaustedError("no memory for mjData; lower njmax of the scene");
  return sensing;
}

void ArmSensing::StartEpisode(int initial_state) {
  noise_ = RandomStream(StreamKey("sim/sensing").With(initial_state));
  seen_.clear();
}

RobotState ArmSensing::Sense(const PandaSim& sim) {
  RobotState state = sim.Measure();
  if (options_.encoders == Encoders::kLink && options_.noise == 0) return state;
  for (int i = 0; i < 7; ++i) {
    if (options_.encoders == Encoders::kMotor)
      state.q[i] = sim.joint_chain().MotorAngle(i, state.q[i]);
    state.q[i] += options_.noise * noise_.Normal();
  }
  mjData* d = kinematics_->data;
  for (int i = 0; i < 7; ++i) d->qpos[panda_.qpos[i]] = state.q[i];
  mj_kinematics(model_.get(), d);
  using Map3 = Eigen::Map<const Eigen::Vector3d>;
  state.tool.p_base_tool =
      Map3(d->site_xpos + 3 * panda_.grip_site) - Map3(d->xpos + 3 * panda_.base_body);
  const double* q = d->xquat + 4 * panda_.hand_body;
  state.tool.q_base_tool = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  return state;
}

RobotState ArmSensing::Measure(const PandaSim& sim) {
  seen_.push_back(Sense(sim));
  if (seen_.size() > static_cast<size_t>(options_.delay) + 1) seen_.pop_front();
  return seen_.front();
}

}  // namespace robostress
