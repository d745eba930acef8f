#include "eval/statistics/episode_bootstrap.h"

#include <algorithm>
#include <limits>
#include <map>
#include <tuple>

#include "common/bootstrap_replicates.h"

namespace robostress {

const char* ClusterNoun(Clustering clustering) {
  return clustering == Clustering::kTask ? "tasks" : "initial states";
}

std::vector<ClusteredValue> ClusterEpisodes(const std::vector<EpisodeValue>& values,
                                            Clustering clustering) {
  const auto name = [clustering](const EpisodeValue& v) {
    return std::tuple(v.suite, v.task, clustering == Clustering::kTask ? 0 : v.initial_state);
  };
  std::map<std::tuple<std::string, int, int>, int> numbers;
  for (const EpisodeValue& v : values) numbers.emplace(name(v), 0);
  int next = 0;
  for (auto& [cluster, number] : numbers) number = next++;
  std::vector<ClusteredValue> clustered;
  for (const EpisodeValue& v : values)
    clustered.push_back({numbers.at(name(v)), v.stratum, v.value});
  return clustered;
}

BootstrapResult BootstrapEpisodes(const std::vector<EpisodeValue>& values, int replicates,
                                  const std::string& label, Clustering clustering) {
  return ClusterBootstrap(ClusterEpisodes(values, clustering), replicates,
                          StreamKey("eval/bootstrap").With(label));
}

BootstrapResult BootstrapUnpaired(const std::vector<EpisodeValue>& values,
                                  const std::vector<EpisodeValue>& others, int replicates,
                                  const std::string& label, Clustering clustering) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  const std::vector<ClusteredValue> a = ClusterEpisodes(values, clustering),
                                    b = ClusterEpisodes(others, clustering);
  const StreamKey key = StreamKey("eval/bootstrap").With(label);
  BootstrapResult result = ClusterBootstrap(a, 0, key);
  const BootstrapResult other = ClusterBootstrap(b, 0, key);
  result.estimate -= other.estimate;
  result.clusters += other.clusters;
  result.interval = {kNaN, kNaN};
  std::vector<double> differences = ClusterReplicates(a, replicates, key.With("first"));
  const std::vector<double> second = ClusterReplicates(b, replicates, key.With("second"));
  if (differences.empty() || second.empty()) return result;
  for (size_t i = 0; i < differences.size(); ++i) differences[i] -= second[i];
  std::sort(differences.begin(), differences.end());
  result.interval = {Quantile(differences, 0.025), Quantile(differences, 0.975)};
  return result;
}

}  // namespace robostress
