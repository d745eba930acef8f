#include <mujoco/mujoco.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "tests/calibration/generator/spatial_arm.h"

namespace robostress::generator {
namespace {

using Vector = Eigen::VectorXd;

constexpr double kStep = 2.5e-4;  // [s]
constexpr int kFrictionPasses = 3;

// Where a joint is asked to be at t.
double Reference(const SpatialLink& link, size_t index, double t, double speed) {
  const double slow = 2 * M_PI * (0.13 + 0.027 * static_cast<double>(index)) * speed;
  const double fast = 2 * M_PI * (0.55 + 0.031 * static_cast<double>(index)) * speed;
  const double phase = static_cast<double>(index);
  return link.centre +
         link.amplitude * (0.75 * std::sin(slow * t + phase) + 0.25 * std::sin(fast * t));
}

class Simulation {
 public:
  explicit Simulation(const SpatialArm& arm) : arm_(arm) {
    const std::string xml = MjcfOf(arm, false);
    const auto files = std::make_unique<mjVFS>();
    mj_defaultVFS(files.get());
    mj_makeEmptyFileVFS(files.get(), "arm.xml", static_cast<int>(xml.size()));
    std::copy(xml.begin(), xml.end(),
              static_cast<char*>(files->filedata[mj_findFileVFS(files.get(), "arm.xml")]));
    char error[500] = "";
    model_.reset(mj_loadXML("arm.xml", files.get(), error, sizeof error));
    mj_deleteVFS(files.get());
    if (model_ == nullptr) std::fprintf(stderr, "%s\n", error);
    for (size_t i = 0; i < arm.links.size(); ++i) model_->dof_armature[i] = arm.links[i].armature;
    data_.reset(mj_makeData(model_.get()));
  }
  double& q(size_t joint) { return data_->qpos[joint]; }
  double v(size_t joint) const { return data_->qvel[joint]; }

  // One step under `torque` of the drives [Nm]; `dry`: limits of dry friction [Nm].
  void Step(const Vector& torque, const Vector& dry) {
    const int n = model_->nv;
    mjModel* m = model_.get();
    mjData* d = data_.get();
    mj_kinematics(m, d);
    mj_comPos(m, d);
    mj_crb(m, d);
    mj_comVel(m, d);
    Vector bias(n);
    mj_rne(m, d, 0, bias.data());
    Eigen::MatrixXd M(n, n);
    mj_fullM(m, M.data(), d->qM);
    const Eigen::MatrixXd inverse = M.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
    Eigen::Map<Vector> velocity(d->qvel, n);
    const Vector before = velocity;
    Vector after = before + kStep * (inverse * (torque - bias));
    Vector impulse = Vector::Zero(n);
    for (int pass = 0; pass < kFrictionPasses; ++pass)
      for (int j = 0; j < n; ++j) {
        const double wanted = impulse[j] - after[j] / inverse(j, j);
        const double given = std::clamp(wanted, -kStep * dry[j], kStep * dry[j]);
        after += inverse.col(j) * (given - impulse[j]);
        impulse[j] = given;
      }
    velocity = after;
    for (int j = 0; j < n; ++j) d->qpos[j] += kStep * 0.5 * (before[j] + after[j]);
  }

 private:
  struct Deleter {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
    void operator()(mjData* data) const { mj_deleteData(data); }
  };
  const SpatialArm& arm_;
  std::unique_ptr<mjModel, Deleter> model_;
  std::unique_ptr<mjData, Deleter> data_;
};

}  // namespace

std::string SimulatedLog(const SpatialArm& arm, const SpatialFault& fault, double seconds,
                         double rate_hz, double speed, RandomStream random) {
  const size_t n = arm.links.size();
  Simulation simulation(arm);
  std::string text = "t";
  for (const SpatialLink& link : arm.links)
    absl::StrAppend(&text, ",q_cmd_", link.joint, ",q_", link.joint);
  text += "\n";
  constexpr double kSettle = 1;  // [s] before the log begins
  const double row_s = 1 / rate_hz;
  const auto command = [&](size_t joint, double t) {
    return Reference(arm.links[joint], joint, std::floor(t / row_s + 1e-9) * row_s, speed);
  };
  for (size_t j = 0; j < n; ++j) simulation.q(j) = command(j, -kSettle);
  const int before = static_cast<int>(std::lround(kSettle / kStep));
  const int per_row = static_cast<int>(std::lround(row_s / kStep));
  const int steps = static_cast<int>(std::lround(seconds / kStep));
  Vector torque(n), dry(n);
  std::vector<double> link_angle(n);  // behind the gap, where the motor pushed it
  for (size_t j = 0; j < n; ++j) link_angle[j] = simulation.q(j);
  for (int k = -before; k < steps; ++k) {
    const double t = k * kStep;
    for (size_t j = 0; j < n; ++j) {
      const double gap = static_cast<int>(j) == fault.joint ? fault.backlash : 0;
      link_angle[j] = std::clamp(link_angle[j], simulation.q(j) - gap, simulation.q(j) + gap);
    }
    if (k >= 0 && k % per_row == 0) {
      absl::StrAppendFormat(&text, "%.9g", t);
      for (size_t j = 0; j < n; ++j)
        absl::StrAppendFormat(&text, ",%.10g,%.10g", Reference(arm.links[j], j, t, speed),
                              link_angle[j] + arm.noise * random.Normal());
      text += "\n";
    }
    for (size_t j = 0; j < n; ++j) {
      const SpatialLink& link = arm.links[j];
      const double q = simulation.q(j), v = simulation.v(j);
      const auto i = static_cast<Eigen::Index>(j);
      torque[i] = std::clamp(link.kp * (command(j, t) - link_angle[j]) - link.kd * v, -link.effort,
                             link.effort) -
                  link.damping * v;
      dry[i] = link.friction;
      if (static_cast<int>(j) != fault.joint) continue;
      if (fault.torque) torque[i] += fault.torque(q, v);
      if (fault.dry_friction) dry[i] = fault.dry_friction(q, v);
    }
    simulation.Step(torque, dry);
  }
  return text;
}

absl::Status WriteSpatialRig(const SpatialArm& arm, const SpatialFault& fault,
                             const std::string& format, const std::vector<std::string>& fit,
                             const std::string& folder) {
  constexpr double kSeconds = 4.5, kRate = 80;
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  const std::string model = absl::StrCat(arm.name, ".", format == "urdf" ? "urdf" : "xml");
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/" + model,
                                         format == "urdf" ? UrdfOf(arm) : MjcfOf(arm, true)));
  std::string rig =
      absl::StrFormat("name: %s\nmodel: %s\nrate_hz: %g\njoints:\n", arm.name, model, kRate);
  for (const SpatialLink& link : arm.links)
    absl::StrAppendFormat(&rig,
                          "  - name: %s\n    input: position_target\n    servo: {kp: %.10g, kd: "
                          "%.10g}\n    fit: [%s]\n",
                          link.joint, link.kp, link.kd, absl::StrJoin(fit, ", "));
  rig += "logs:\n";
  const double speeds[] = {1.6, 1, 1.3};
  for (int i = 0; i < 3; ++i) {
    absl::StrAppendFormat(&rig, "  - {file: log_%d.csv, role: %s}\n", i,
                          i < 2 ? "fit" : "held_out");
    RS_RETURN_IF_ERROR(WriteFileAtomically(
        absl::StrCat(folder, "/log_", i, ".csv"),
        SimulatedLog(arm, fault, kSeconds, kRate, speeds[i],
                     RandomStream(StreamKey("spatial arm").With(arm.name).With(i)))));
  }
  return WriteFileAtomically(folder + "/rig.yaml", rig + "metric: {window_s: 0.5, unit: rad}\n");
}

}  // namespace robostress::generator
