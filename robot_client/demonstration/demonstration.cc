#include "robot_client/demonstration/demonstration.h"

namespace robostress {
namespace {

using Values = ArmVector DemonstrationTick::*;

std::vector<float> Column(const DemonstrationEpisode& episode, Values values) {
  std::vector<float> column;
  for (const DemonstrationTick& tick : episode.ticks)
    for (const double v : tick.*values) column.push_back(static_cast<float>(v));
  return column;
}

}  // namespace

LerobotSchema LerobotSchemaOf(const std::string& robot, double rate_hz,
                              const std::vector<std::string>& cameras) {
  const std::vector<std::string> axes = {"J1", "J2", "J3", "J4", "J5", "J6", "gripper"};
  return {robot, rate_hz, {{"observation.state", axes}, {"action", axes}}, cameras};
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
