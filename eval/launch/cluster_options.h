#pragma once

#include <string>
#include <vector>

#include "common/version.h"

namespace robostress {

// What launchers need to know of a cluster. Every job sees the run directory under one path, on a
// shared file system.
struct ClusterOptions {
  int servers = 1;         // server jobs per policy
  int server_threads = 0;  // of each; 0: as many as workers that use it
  std::string
      server_host;       // name or address that servers publish; empty: of the machine they run on
  int max_tasks = 1000;  // of the worker array; Slurm's MaxArraySize is 1001 by default
  int workers_per_task = 1;
  bool wait = false;  // stay and show the progress until everything has left the queue
  int poll_s = 5;     // between questions to the queue
  // Further arguments of sbatch, such as --partition=gpu, for servers, workers and the merge.
  std::vector<std::string> slurm_server, slurm_worker, slurm_merge;
  // Container image with every program.
  std::string image = std::string("robostress:") + BuildVersion();
  std::string claim = "robostress-runs";  // persistent volume claim that holds the run directory
  std::string claim_mount;                // where it is mounted; empty: the run directory's parent
  std::string k8s_namespace = "default";
};

}  // namespace robostress
