#include "calibration/model/arriving_commands.h"

#include <algorithm>
#include <cmath>

#include "calibration/model/joint_simulation.h"

namespace robostress::calibration {
namespace {

// On a cubic through four values, `s` of the way from `b` to `c`.
double Between(double a, double b, double c, double d, double s) {
  const double slope = 0.5 * (c - a), way = c - b, next = 0.5 * (d - b);
  const double c2 = 3 * way - 2 * slope - next, c3 = slope + next - 2 * way;
  return b + s * (slope + s * (c2 + s * c3));
}

// At `at` rows, on cubics through its rows; before and behind them as at their ends.
double Between(const std::vector<double>& rows, double at) {
  const int last = static_cast<int>(rows.size()) - 1;
  at = std::clamp(at, 0.0, static_cast<double>(last));
  const int row = static_cast<int>(at);
  const auto value = [&](int i) { return rows[std::clamp(i, 0, last)]; };
  return Between(value(row - 1), value(row), value(row + 1), value(row + 2), at - row);
}

// Of a sub-step, each of which a limit follows by itself: it leaves and meets a command within one.
constexpr int kLimitParts = 8;

// The command of every sub-step: held from `command_shift` rows after its row on, averaged over the
// sub-step, or as much later on cubics; through the effects of the command stage.
std::vector<double> ServoCommands(const JointTrack& track, const JointModel& model,
                                  EffectChain& chain, int steps) {
  const JointRecord& record = track.record();
  const std::vector<double>& given =
      model.input == JointInput::kPositionTarget ? record.command : record.tau;
  const absl::Span<const JointChain::Link> command_stage = chain.stage(EffectStage::kCommand);
  const size_t count = static_cast<size_t>(track.log->rows) * steps;
  std::vector<double> commands(count);
  const bool limits =
      std::any_of(command_stage.begin(), command_stage.end(),
                  [](const JointChain::Link& link) { return link.effect->CommandLimits(); });
  const int parts = limits ? kLimitParts : 1;
  JointMoment moment;
  moment.h = track.log->dt / (steps * parts);
  for (const JointChain::Link& link : command_stage) link.effect->Reset(moment);
  // At `at` rows, just before.
  const auto sent_at = [&](double at) {
    at -= model.command_shift;
    if (model.continuous_command) return Between(given, at);
    return given[static_cast<size_t>(
        std::clamp(std::ceil(at - 1e-9) - 1, 0.0, static_cast<double>(given.size() - 1)))];
  };
  std::vector<double> ended(command_stage.size());  // where each left the sub-step before
  std::vector<double> sums;                         // one more than rows
  const auto integral = [&](double at) {            // of the held commands from row 0 [rows]
    at = std::clamp(at, 0.0, static_cast<double>(given.size()));
    const size_t row = std::min(static_cast<size_t>(at), given.size() - 1);
    return sums[row] + (at - static_cast<double>(row)) * given[row];
  };
  const bool shifted = model.command_shift != 0 && !model.continuous_command;
  if (shifted) {
    sums.assign(given.size() + 1, 0);
    for (size_t i = 0; i < given.size(); ++i) sums[i + 1] = sums[i] + given[i];
  }
  double high = -model.command_shift, sum = shifted ? integral(high) : 0;
  for (size_t row = 0; row < given.size(); ++row) {
    for (int i = 0; i < steps; ++i) {
      double command = given[row];
      if (shifted) {
        const double low = high, before = sum;
        high = static_cast<double>(row) + static_cast<double>(i + 1) / steps - model.command_shift;
        sum = integral(high);
        const double within = std::clamp(high, 0.0, static_cast<double>(given.size())) -
                              std::clamp(low, 0.0, static_cast<double>(given.size()));
        if (within > 0) command = (sum - before) / within;
      } else if (model.continuous_command) {
        command =
            Between(given, static_cast<double>(row) + (i + 0.5) / steps - model.command_shift);
      }
      const size_t at = row * steps + i;
      for (int part = 0; part < parts; ++part) {
        const size_t step = at * parts + part;
        if (limits)
          command = sent_at(static_cast<double>(step + 1) / (static_cast<double>(steps) * parts));
        moment.t = static_cast<double>(step) * moment.h;
        for (size_t k = 0; k < command_stage.size(); ++k) {
          command = command_stage[k].effect->Command(command, moment);
          if (!command_stage[k].effect->CommandSlides()) continue;
          const double begun = step == 0 ? command : ended[k];
          ended[k] = command;
          command = 0.5 * (begun + command);
        }
        commands[at] += command / parts;
      }
    }
  }
  return commands;
}

// The motor's angle at every instant of `steps` to a row, on cubics through its readings, and
// what the channel between the encoders makes of it.
std::vector<double> MotorAngles(const JointTrack& track, EffectChain& chain, int steps) {
  const std::vector<double>& given = track.record().q_motor;
  const absl::Span<const JointChain::Link> channel = chain.stage(EffectStage::kCommand);
  const bool slides = std::any_of(channel.begin(), channel.end(), [](const JointChain::Link& link) {
    return link.effect->CommandSlides();
  });
  const int rows = track.log->rows;
  std::vector<double> commands(static_cast<size_t>(rows) * steps);
  JointMoment moment;
  moment.h = track.log->dt / steps;
  for (const JointChain::Link& link : channel) link.effect->Reset(moment);
  double before = given[0];
  for (int row = 0; row < rows; ++row) {
    for (int i = 0; i < steps; ++i) {
      const double s = static_cast<double>(i) / steps;
      const double angle = Between(given, row + s);
      // What slides is exact for a command that holds until the instant.
      double arrives = slides ? 0.5 * (before + angle) : angle;
      before = angle;
      moment.t = (row + s) * track.log->dt;
      for (const JointChain::Link& link : channel) arrives = link.effect->Command(arrives, moment);
      commands[static_cast<size_t>(row) * steps + i] = channel.empty() ? angle : arrives;
    }
  }
  return commands;
}

}  // namespace

std::vector<double> ArrivingCommands(const JointTrack& track, const JointModel& model,
                                     EffectChain& chain, int steps) {
  return model.input == JointInput::kTransmission ? MotorAngles(track, chain, steps)
                                                  : ServoCommands(track, model, chain, steps);
}

}  // namespace robostress::calibration
