#include "eval/episode_bootstrap.h"

#include <map>
#include <tuple>

namespace robostress {

std::vector<ClusteredValue> ClusterEpisodes(const std::vector<EpisodeValue>& values) {
  std::map<std::tuple<std::string, int, int>, int> numbers;
  for (const EpisodeValue& v : values)
    numbers.emplace(std::tuple(v.suite, v.task, v.initial_state), 0);
  int next = 0;
  for (auto& [cluster, number] : numbers) number = next++;
  std::vector<ClusteredValue> clustered;
  for (const EpisodeValue& v : values) {
    clustered.push_back({numbers.at({v.suite, v.task, v.initial_state}), v.stratum, v.value});
  }
  return clustered;
}

BootstrapResult BootstrapEpisodes(const std::vector<EpisodeValue>& values, int replicates,
                                  const std::string& label) {
  return ClusterBootstrap(ClusterEpisodes(values), replicates,
                          StreamKey("eval/bootstrap").With(label));
}

}  // namespace robostress
