#include "robot_client/demonstration/demonstration.h"

namespace robostress {
namespace {

using Values = ArmVector DemonstrationTick::*;

std::vector<float> Column(const DemonstrationEpisode& episode, Values values) {
  std::vector<float> column;
  for (const DemonstrationTick& tick : episode.ticks)
    for (int axis = 0; axis < episode.axes.count(); ++axis)
      column.push_back(static_cast<float>((tick.*values)[axis]));
  return column;
}

}  // namespace

LerobotSchema LerobotSchemaOf(const std::string& robot, const ArmAxes& axes, double rate_hz,
                              const std::vector<std::string>& cameras) {
  const std::vector<std::string> names = axes.names();
  return {robot, rate_hz, {{"observation.state", names}, {"action", names}}, cameras};
}

LerobotEpisode ToLerobot(const DemonstrationEpisode& episode) {
  LerobotEpisode result;
  result.instruction = episode.instruction;
  result.success = episode.success;
  result.steps = episode.ticks.size();
  result.vectors = {Column(episode, &DemonstrationTick::state),
                    Column(episode, &DemonstrationTick::action)};
  result.pictures = episode.jpegs;
  result.picture_ending = "jpg";
  result.width = episode.width;
  result.height = episode.height;
  result.small = episode.small;
  return result;
}

}  // namespace robostress
