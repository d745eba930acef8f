#include "sim_worker/worker/model_inversion.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "adapter/nominal_arm.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/panda_model.h"

namespace robostress {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;

// Displacement in normalised actions.
Vector6 Motion(const RobotState& from, const RobotState& to) {
  Vector6 motion;
  motion.head<3>() = (to.tool.p_base_tool - from.tool.p_base_tool) / OscController::kPositionScale;
  motion.tail<3>() =
      RotationBetween(from.tool.q_base_tool, to.tool.q_base_tool) / OscController::kRotationScale;
  return motion;
}

// The scene of an arm that touches nothing.
absl::StatusOr<SharedModel> WithoutContacts(const mjModel& scene) {
  mjModel* copy = mj_copyModel(nullptr, &scene);
  if (copy == nullptr) return absl::ResourceExhaustedError("no memory for a model of the arm");
  copy->opt.disableflags |= mjDSBL_CONTACT;
  return SharedModel(copy, mj_deleteModel);
}

}  // namespace

absl::StatusOr<std::unique_ptr<ModelInversion>> ModelInversion::OfModel(const PandaSim& arm,
                                                                        const SimOptions& sim,
                                                                        const Scenario& identified,
                                                                        int horizon) {
  RS_ASSIGN_OR_RETURN(const SharedModel bare, WithoutContacts(arm.model()));
  return Create(nullptr, bare, sim, identified, horizon);
}

absl::StatusOr<std::unique_ptr<ModelInversion>> ModelInversion::OfTruth(const PandaSim& arm,
                                                                        const SimOptions& sim,
                                                                        const Scenario& scenario,
                                                                        int horizon) {
  return Create(&arm, arm.shared_model(), sim, scenario, horizon);
}

absl::StatusOr<std::unique_ptr<ModelInversion>> ModelInversion::Create(const PandaSim* truth,
                                                                       const SharedModel& scene,
                                                                       const SimOptions& sim,
                                                                       const Scenario& scenario,
                                                                       int horizon) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<PandaSim> model, PandaSim::Create(scene, sim));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<PandaSim> errorless, PandaSim::Create(scene, sim));
  model->SetScenario(scenario, horizon);
  std::unique_ptr<ModelInversion> result(
      new ModelInversion(truth, std::move(model), std::move(errorless)));
  NominalArmOptions nominal;
  nominal.goal_reference = sim.goal_reference;
  NominalArm arm(nominal);
  double way = 0;
  for (int k = 0; k < result->options_.look_ahead; ++k) {
    way += arm.Step(Vector6::Ones())[0];
    result->response_.push_back(way);
  }
  return result;
}

ModelInversion::ModelInversion(const PandaSim* truth, std::unique_ptr<PandaSim> model,
                               std::unique_ptr<PandaSim> errorless)
    : truth_(truth),
      panda_(*PandaModel::Find(model->model())),
      model_(std::move(model)),
      errorless_(std::move(errorless)) {}

double ModelInversion::confidence() const {
  if (truth_ != nullptr) return 1;
  const double floor = options_.confidence_floor * options_.confidence_floor;
  return std::clamp((errorless_error_ - model_error_) / (errorless_error_ + floor), 0.0, 1.0);
}

void ModelInversion::SetArm(PandaSim& sim, const Eigen::VectorXd* q,
                            const Eigen::VectorXd& dq) const {
  mjData& data = sim.mutable_data();
  for (int i = 0; i < 7; ++i) {
    if (q != nullptr) data.qpos[panda_.qpos[i]] = (*q)[i];
    data.qvel[panda_.dof[i]] = dq[i];
  }
}

absl::Status ModelInversion::Start(const RobotState& now) {
  if (truth_ == nullptr) {
    const mjModel& m = model_->model();
    std::vector<double> qpos(m.qpos0, m.qpos0 + m.nq);
    for (int i = 0; i < 7; ++i) qpos[panda_.qpos[i]] = now.q[i];
    RS_RETURN_IF_ERROR(model_->Reset(qpos, now.q));
    after_ = model_->Save();
  }
  shortfall_.setZero();
  added_.setZero();
  errorless_error_ = model_error_ = 0;
  nominal_velocity_ = now.dq;
  running_ = true;
  return absl::OkStatus();
}

void ModelInversion::Learn(const RobotState& now) {
  const Vector6 done = Motion(before_, now);
  shortfall_ = (1 - 1 / options_.memory) * shortfall_ + wanted_ - done;
  const double share = 1 / options_.confidence_memory;
  const auto error = [&](const Vector6& m) { return (m - done).head<3>().squaredNorm(); };
  model_error_ += share * (error(predicted_) - model_error_);
  errorless_error_ += share * (error(unexplained_) - errorless_error_);
}

void ModelInversion::Synchronise(const RobotState& now) {
  model_->Restore(truth_ != nullptr ? *truth_->Save() : *after_);
  if (truth_ == nullptr) SetArm(*model_, &now.q, now.dq);
}

absl::Status ModelInversion::Play(PandaSim& sim, const Eigen::MatrixXf& rows, const Vector6& d,
                                  int steps, AfterRow after) {
  const RobotState from = sim.Measure();
  for (int k = 0; k < steps; ++k) {
    Vector7 command = rows.row(k).transpose().cast<double>();
    command.head<6>() = (command.head<6>() + d).cwiseMax(-1.0).cwiseMin(1.0);
    RS_RETURN_IF_ERROR(sim.StepExact(command));
    if (!after(k, Motion(from, sim.Measure()))) break;
  }
  return absl::OkStatus();
}

absl::StatusOr<ModelInversion::Vector6> ModelInversion::FirstMotion(PandaSim& sim,
                                                                    const Eigen::MatrixXf& rows) {
  Vector6 first;
  RS_RETURN_IF_ERROR(Play(sim, rows, Vector6::Zero(), 1, [&](int, const Vector6& motion) {
    first = motion;
    return false;
  }));
  return first;
}

absl::StatusOr<Eigen::VectorXf> ModelInversion::Command(const Eigen::MatrixXf& rows,
                                                        const RobotState& now) {
  const int steps = std::min<int>(options_.look_ahead, static_cast<int>(rows.rows()));
  if (running_) Learn(now);
  if (!running_) RS_RETURN_IF_ERROR(Start(now));
  Synchronise(now);
  const std::shared_ptr<const PandaSim::Snapshot> here = model_->Save();

  errorless_->RestoreMotion(*here);
  SetArm(*errorless_, nullptr, nominal_velocity_);
  std::vector<Vector6> wanted;
  RS_RETURN_IF_ERROR(
      Play(*errorless_, rows, Vector6::Zero(), steps, [&](int k, const Vector6& motion) {
        if (k == 0) nominal_velocity_ = errorless_->Measure().dq;
        wanted.push_back(motion);
        return true;
      }));
  wanted_ = wanted[0];

  double squares = 0;
  for (int k = 0; k < steps; ++k) squares += response_[k] * response_[k];
  Vector6 d = added_, best = Vector6::Zero(), best_change = Vector6::Zero();
  double least = std::numeric_limits<double>::infinity(), stride = 1;
  for (int i = 0; i < options_.tries; ++i) {
    model_->Restore(*here);
    Vector6 change = Vector6::Zero();
    double cost = 0;
    RS_RETURN_IF_ERROR(Play(*model_, rows, d, steps, [&](int k, const Vector6& motion) {
      const Vector6 missing = wanted[k] + shortfall_ - motion;
      cost += missing.squaredNorm();
      change += response_[k] / squares * missing;
      return cost < least;
    }));
    if (cost < least) {
      least = cost;
      best = d;
      best_change = change;
    } else {
      stride /= 2;
    }
    d = (best + stride * best_change).cwiseMax(-options_.limit).cwiseMin(options_.limit);
  }
  added_ = best;

  Eigen::VectorXf sent = rows.row(0).transpose();
  sent.head<6>() = (sent.head<6>() + (confidence() * best).cast<float>()).cwiseMax(-1).cwiseMin(1);
  before_ = now;
  if (truth_ != nullptr) return sent;
  const Eigen::MatrixXf one = sent.transpose();
  errorless_->RestoreMotion(*here);
  RS_ASSIGN_OR_RETURN(unexplained_, FirstMotion(*errorless_, one));
  model_->Restore(*here);
  RS_ASSIGN_OR_RETURN(predicted_, FirstMotion(*model_, one));
  after_ = model_->Save();
  return sent;
}

}  // namespace robostress
