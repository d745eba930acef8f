#include "eval/launch/kubernetes_launcher.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr int kBackoffLimitPerIndex = 6;

// A text as a YAML scalar that is always a string.
std::string Scalar(const std::string& text) {
  YAML::Emitter emitter;
  emitter << YAML::DoubleQuoted << text;
  return emitter.c_str();
}

// A name that Kubernetes accepts: RFC 1123 label, at most 63 characters.
std::string Label(const std::string& text) {
  std::string label;
  for (const char c : absl::AsciiStrToLower(text)) label += absl::ascii_isalnum(c) ? c : '-';
  label = label.substr(0, 63);
  while (!label.empty() && label.back() == '-') label.pop_back();
  return label;
}

struct JobText {
  std::string name, component;
  int completions = 1, parallelism = 1, cores = 1;
  std::vector<std::string> arguments;
  bool publishes_address = false;
};

std::string Render(const JobText& job, const std::string& run_label, const ClusterOptions& cluster,
                   const std::string& mount) {
  std::vector<std::string> arguments;
  for (const std::string& argument : job.arguments) arguments.push_back(Scalar(argument));
  std::string environment =
      "            - {name: OMP_NUM_THREADS, value: \"1\"}\n"
      "            - {name: OPENBLAS_NUM_THREADS, value: \"1\"}\n";
  if (job.publishes_address) {
    environment +=
        "            - name: POD_IP\n"
        "              valueFrom: {fieldRef: {fieldPath: status.podIP}}\n";
  }
  return absl::StrCat(
      "---\napiVersion: batch/v1\nkind: Job\nmetadata:\n  name: ", job.name,
      "\n  namespace: ", Scalar(cluster.k8s_namespace),
      "\n  labels: {app.kubernetes.io/name: robostress, app.kubernetes.io/component: ",
      job.component, ", robostress/run: ", run_label, "}\nspec:\n  completionMode: Indexed\n",
      "  completions: ", job.completions, "\n  parallelism: ", job.parallelism,
      "\n  backoffLimitPerIndex: ", kBackoffLimitPerIndex,
      "\n  maxFailedIndexes: ", job.completions,
      "\n  podFailurePolicy:\n    rules:\n"
      "      # An eviction or a preemption says nothing about the work.\n"
      "      - action: Ignore\n        onPodConditions: [{type: DisruptionTarget}]\n"
      "      # 2: the command itself is wrong, and would be again.\n"
      "      - action: FailIndex\n        onExitCodes: {operator: In, values: [2]}\n"
      "  template:\n    metadata:\n"
      "      labels: {app.kubernetes.io/name: robostress, app.kubernetes.io/component: ",
      job.component, ", robostress/run: ", run_label,
      "}\n    spec:\n      restartPolicy: Never\n      automountServiceAccountToken: false\n"
      "      terminationGracePeriodSeconds: 30\n"
      "      securityContext: {runAsNonRoot: true, runAsUser: 65532, runAsGroup: 65532, fsGroup: "
      "65532, seccompProfile: {type: RuntimeDefault}}\n"
      "      containers:\n        - name: ",
      job.component, "\n          image: ", Scalar(cluster.image),
      "\n          command: [robostress-grid-job]\n          args: [",
      absl::StrJoin(arguments, ", "), "]\n          env:\n", environment,
      "          resources:\n            requests: {cpu: \"", job.cores,
      "\", memory: 2Gi}\n          securityContext: {allowPrivilegeEscalation: false, "
      "capabilities: {drop: [ALL]}}\n"
      "          volumeMounts: [{name: runs, mountPath: ",
      Scalar(mount),
      "}]\n      volumes:\n        - name: runs\n          persistentVolumeClaim: "
      "{claimName: ",
      Scalar(cluster.claim), "}\n");
}

}  // namespace

absl::StatusOr<std::string> KubernetesManifest(const Submission& submission,
                                               const LaunchOptions& options) {
  const ClusterOptions& cluster = options.cluster;
  const fs::path run = submission.run().path();
  const fs::path mount =
      cluster.claim_mount.empty() ? run.parent_path() : fs::path(cluster.claim_mount);
  if (!absl::StartsWith(run.string() + "/", (mount / "").string())) {
    return absl::InvalidArgumentError(
        absl::StrCat("the run directory ", run.string(), " is not under --claim-mount ",
                     mount.string(), ", where pods see the volume claim ", cluster.claim));
  }
  const std::string base =
      absl::StrCat("rs-", Sha256Hex(run.string()).substr(0, 10), "-", submission.name());
  std::string text = absl::StrCat(
      "# Written by `robostress sweep --launcher kubernetes` for ", run.string(),
      ".\n# Kubernetes 1.29 or later (backoffLimitPerIndex). The claim ", cluster.claim,
      " must be ReadWriteMany, and the image\n# must hold every program of robostress on its "
      "PATH.\n",
      "# kubectl apply -f THIS; kubectl delete -f THIS when it is done.\n");
  for (const std::string& policy : submission.ServedPolicies()) {
    JobText job;
    job.name = Label(absl::StrCat(base, "-serve-", PolicyLabel(policy)));
    job.component = "serve";
    job.completions = job.parallelism = submission.servers();
    job.cores = submission.server_threads();
    job.publishes_address = true;
    job.arguments = {"serve",    "--submission", submission.folder(),       "--policy",
                     policy,     "--index",      "$(JOB_COMPLETION_INDEX)", "--host",
                     "$(POD_IP)"};
    text += Render(job, base, cluster, mount.string());
  }
  JobText work;
  work.name = base + "-work";
  work.component = "work";
  work.completions = submission.tasks();
  work.parallelism = std::min(submission.tasks(), std::max(1, options.workers));
  work.cores = submission.pool().workers;
  work.arguments = {"work",
                    "--submission",
                    submission.folder(),
                    "--index",
                    "$(JOB_COMPLETION_INDEX)",
                    "--tries",
                    absl::StrCat(kBackoffLimitPerIndex + 1)};
  text += Render(work, base, cluster, mount.string());
  JobText merge;
  merge.name = base + "-merge";
  merge.component = "merge";
  merge.arguments = {"merge", "--submission", submission.folder(), "--wait"};
  return text + Render(merge, base, cluster, mount.string());
}

absl::StatusOr<LaunchResult> KubernetesLauncher::Launch(const LaunchRequest& request) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Submission> submission, Submission::Create(request));
  RS_ASSIGN_OR_RETURN(const std::string manifest, KubernetesManifest(*submission, request.options));
  const std::string file = submission->folder() + "/kubernetes.yaml";
  RS_RETURN_IF_ERROR(WriteFileAtomically(file, manifest));
  LaunchResult result;
  result.submitted = true;
  result.hint = absl::StrCat("nothing runs yet: `kubectl apply -f ", file,
                             "` starts it, and the report comes by itself");
  return result;
}

}  // namespace robostress
