#pragma once

#include <string>
#include <vector>

#include "common/statistics.h"

namespace robostress {

// Which episodes of a suite share what chance decides, and so are drawn together. kTask where a
// session is carried from one initial state to the next: there the states of a task are no
// independent draws. Scenarios and seeds never make clusters of their own.
enum class Clustering { kInitialState, kTask };

// "initial states", "tasks".
const char* ClusterNoun(Clustering clustering);

// A number that one episode gave.
struct EpisodeValue {
  std::string suite;
  int task = 0, initial_state = 0;
  int stratum = 0;  // scenario
  double value = 0;
};

// Episodes of equal suite, task and (kInitialState) initial state are one cluster; clusters are
// numbered in the order of their names.
std::vector<ClusteredValue> ClusterEpisodes(const std::vector<EpisodeValue>& values,
                                            Clustering clustering = Clustering::kInitialState);

// ClusterBootstrap with a stream keyed by `label`, the cell of the table: a number does not depend
// on what else is in the report.
BootstrapResult BootstrapEpisodes(const std::vector<EpisodeValue>& values, int replicates,
                                  const std::string& label,
                                  Clustering clustering = Clustering::kInitialState);

// Mean of `values` minus mean of `others`, two samples that share nothing: clusters of each are
// resampled apart, and the interval is of the differences of their replicates.
BootstrapResult BootstrapUnpaired(const std::vector<EpisodeValue>& values,
                                  const std::vector<EpisodeValue>& others, int replicates,
                                  const std::string& label,
                                  Clustering clustering = Clustering::kInitialState);

}  // namespace robostress
