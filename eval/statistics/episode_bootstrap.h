#pragma once

#include <string>
#include <vector>

#include "common/statistics.h"

namespace robostress {

// A number that one episode gave; episodes of equal suite, task and initial state are one cluster.
struct EpisodeValue {
  std::string suite;
  int task = 0, initial_state = 0;
  int stratum = 0;  // scenario
  double value = 0;
};

// Numbers the clusters in the order of their names.
std::vector<ClusteredValue> ClusterEpisodes(const std::vector<EpisodeValue>& values);

// ClusterBootstrap with a stream keyed by `label`, the cell of the table: a number does not depend
// on what else is in the report.
BootstrapResult BootstrapEpisodes(const std::vector<EpisodeValue>& values, int replicates,
                                  const std::string& label);

// Mean of `values` minus mean of `others`, two samples that share nothing: clusters of each are
// resampled apart, and the interval is of the differences of their replicates.
BootstrapResult BootstrapUnpaired(const std::vector<EpisodeValue>& values,
                                  const std::vector<EpisodeValue>& others, int replicates,
                                  const std::string& label);

}  // namespace robostress
