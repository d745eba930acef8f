#pragma once

#include <vector>

#include "common/statistics.h"

namespace robostress {

// The replicates behind ClusterBootstrap, in the order they were drawn: each the mean over strata
// of the means within, of as many clusters as there are, drawn with replacement. Empty with fewer
// than two clusters. For statistics of several samples, such as a difference of two that are
// resampled apart.
std::vector<double> ClusterReplicates(const std::vector<ClusteredValue>& values, int replicates,
                                      const StreamKey& key);

}  // namespace robostress
