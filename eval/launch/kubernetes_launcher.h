#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "eval/launch/launcher.h"
#include "eval/launch/submission.h"

namespace robostress {

// Writes RUN/submissions/NUMBER/kubernetes.yaml and leaves applying it to the person: an indexed
// Job of server pods per policy, an indexed Job of worker pods, and a Job that merges. All mount
// the persistent volume claim that holds the run directory, and find each other through it. A
// pod that is evicted or preempted is replaced and goes on where its files end; that does not count
// as a failure.
class KubernetesLauncher : public Launcher {
 public:
  absl::StatusOr<LaunchResult> Launch(const LaunchRequest& request) override;
};

// The manifest; InvalidArgument when the run directory does not lie under cluster.claim_mount.
absl::StatusOr<std::string> KubernetesManifest(const Submission& submission,
                                               const LaunchOptions& options);

}  // namespace robostress
