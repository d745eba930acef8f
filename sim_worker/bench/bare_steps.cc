#include "sim_worker/bench/bare_steps.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/check.h"
#include "common/statistics.h"
#include "sim_worker/bench/timing.h"

namespace robostress {

BareSteps::BareSteps(const mjModel& model) : model_(model), data_(mj_makeData(&model)) {
  RS_CHECK(data_ != nullptr);
}

BareSteps::SubStep BareSteps::StateOf(const mjData& data) const {
  const mjModel& m = model_;
  return {{data.qpos, data.qpos + m.nq},
          {data.qvel, data.qvel + m.nv},
          {data.qacc_warmstart, data.qacc_warmstart + m.nv},
          {}};
}

void BareSteps::Record(PandaSim& sim, const std::function<void()>& step) {
  std::vector<SubStep> sub_steps;
  SubStep next = StateOf(sim.data());
  sim.OnSubStep([&] {
    next.ctrl.assign(sim.data().ctrl, sim.data().ctrl + model_.nu);
    sub_steps.push_back(std::exchange(next, StateOf(sim.data())));
  });
  step();
  sim.OnSubStep(nullptr);
  steps_.push_back(std::move(sub_steps));
  reached_.push_back(std::move(next.qpos));
}

void BareSteps::Run(int index) {
  mjData& d = *data_;
  for (const SubStep& s : steps_[index]) {
    std::copy(s.qpos.begin(), s.qpos.end(), d.qpos);
    std::copy(s.qvel.begin(), s.qvel.end(), d.qvel);
    std::copy(s.warmstart.begin(), s.warmstart.end(), d.qacc_warmstart);
    std::copy(s.ctrl.begin(), s.ctrl.end(), d.ctrl);
    mj_step(&model_, &d);
  }
}

void BareSteps::Compare(int index) {
  for (size_t i = 0; i < reached_[index].size(); ++i) {
    largest_difference_ =
        std::max(largest_difference_, std::abs(data_->qpos[i] - reached_[index][i]));
  }
}

StepCost MeasureSteps(const TimedEpisode& episode, int steps, int repeats) {
  BareSteps bare(episode.sim->model());
  StepCost cost;
  episode.reset();
  for (int t = 0; t < steps; ++t) {
    bare.Record(*episode.sim, [&] { episode.step(t); });
    cost.contacts += static_cast<double>(episode.sim->data().ncon) / steps;
    bare.Run(t);
    bare.Compare(t);
  }
  cost.replay_difference = bare.largest_difference();
  std::vector<std::vector<double>> ours(steps), theirs(steps);
  for (int repeat = 0; repeat < repeats; ++repeat) {
    episode.reset();
    for (int t = 0; t < steps; ++t) {
      ours[t].push_back(TimeOf([&] { episode.step(t); }));
      theirs[t].push_back(TimeOf([&] { bare.Run(t); }));
    }
  }
  for (int t = 0; t < steps; ++t) {
    cost.ours_s += UpperMedian(ours[t]) / steps;
    cost.bare_s += UpperMedian(theirs[t]) / steps;
  }
  return cost;
}

Eigen::VectorXf CircleCommand(int step) {
  Eigen::VectorXf command = Eigen::VectorXf::Zero(7);
  command[0] = 0.5f * std::cos(0.1f * step);
  command[1] = 0.5f * std::sin(0.1f * step);
  command[5] = 0.2f * std::sin(0.05f * step);
  command[6] = step / 40 % 2 ? 1 : -1;
  return command;
}

}  // namespace robostress
