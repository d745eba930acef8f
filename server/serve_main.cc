#include <pthread.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <memory>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "server/policy_service.h"
#include "server/torch_threads.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robostress serve                                        # nano on a free port of this machine
  robostress serve --policy nano --listen 0.0.0.0:50051   # for workers on other machines
  robostress serve --state-dir /var/lib/robostress        # sessions survive the server
  robostress serve --policy my_nano.safetensors --port-file /tmp/port
  robostress serve --policy pi05_libero --policy-options transform=libero tokenizer=paligemma_tokenizer.model
  robostress-worker --unit UNIT.yaml --out DIR --server 127.0.0.1:50051

SIGTERM and SIGINT stop it: it refuses new messages, answers those under way (at most --grace seconds) and exits.
The transport is neither encrypted nor authenticated: listen on a trusted network only.)";

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "robostress serve: %s\n", std::string(status.message()).c_str());
  return 1;
}

int Main(int argc, char** argv) {
  CLI::App app{"Serves a policy with online self-compensation over gRPC.", "robostress serve"};
  app.footer(kExamples);
  PolicyServerOptions options;
  options.threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  std::string policy_name = "nano", port_file;
  std::vector<std::string> policy_options;
  double grace_s = 10, expiry_s = 0, batch_window_ms = 0;
  app.add_option("--policy", policy_name,
                 "nano, nano:random, a weights file (.safetensors), or the folder of a pi0 or "
                 "pi0.5 checkpoint")
      ->capture_default_str();
  app.add_option("--policy-options", policy_options,
                 "KEY=VALUE ... over those of robostress_policy.yaml; `robostress policy inspect "
                 "--help` lists them");
  app.add_option("--listen", options.listen, "HOST:PORT; port 0 takes a free one")
      ->capture_default_str();
  app.add_option("--port-file", port_file, "write the bound port to this file");
  app.add_option("--threads", options.threads,
                 "batches of predictions computed at once, and as many update threads")
      ->capture_default_str();
  app.add_option("--max-batch", options.max_batch,
                 "predictions computed in one pass, each with its own adapter; 1: none is batched")
      ->capture_default_str();
  app.add_option("--batch-window-ms", batch_window_ms,
                 "how long a batch that is not full waits for more; 0: it takes what has come")
      ->capture_default_str();
  app.add_option("--queue-capacity", options.queue_capacity,
                 "predictions that may wait; more are refused and told when to come back")
      ->capture_default_str();
  app.add_option(
         "--update-share", options.update_share,
         "of its thread's time that an update keeps while predictions need the cores, above "
         "0 to 1 (updates never yield)")
      ->capture_default_str();
  app.add_option("--cores", options.cores,
                 "that predictions and updates share; updates yield beyond it. 1: whenever a "
                 "prediction is under way; 0: all of this machine")
      ->capture_default_str();
  app.add_option("--update-nice", options.update_nice,
                 "added to the nice value of the threads on which asynchronous sessions learn")
      ->capture_default_str();
  app.add_option("--max-sessions", options.max_sessions, "sessions open at once")
      ->capture_default_str();
  app.add_option("--prefix-budget-mib", options.prefix_budget_mib,
                 "memory for the prefixes that adapters learn from, all sessions together; what "
                 "exceeds it is dropped and encoded again when an update needs it")
      ->capture_default_str();
  app.add_option(
      "--state-dir", options.state_dir,
      "folder where sessions are kept: feedback is acknowledged when it is on this disk, "
      "and sessions are resumed after a restart; without it they live in memory");
  app.add_option("--session-expiry", expiry_s,
                 "seconds after which an unused session is closed, on disk too; 0: never")
      ->capture_default_str();
  app.add_option("--snapshot-mib", options.snapshot_mib,
                 "journal of a session after which its state is written anew")
      ->capture_default_str();
  app.add_option("--snapshot-records", options.snapshot_records, "the same in records")
      ->capture_default_str();
  app.add_flag("--sync-predictions", options.sync_predictions,
               "predictions are on the disk before they are answered: none is lost with the power");
  app.add_flag("--guard", options.guard.enabled,
               "refuse updates whose candidate is worse on chunks that they did not sample; for "
               "sessions that ask for no guard of their own");
  app.add_option("--guard-ratio", options.guard.max_loss_ratio,
                 "largest loss of a candidate over the published adapter's")
      ->check(CLI::Range(1e-6, 1e6))
      ->capture_default_str();
  app.add_option("--guard-distance", options.guard.max_distance,
                 "largest ||phi - phi_0|| of a candidate; 0: no bound")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  app.add_option("--grace", grace_s, "seconds to answer what is under way when stopped")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  options.batch_window = absl::Milliseconds(batch_window_ms);
  if (expiry_s > 0) options.expire_after = absl::Seconds(expiry_s);

  // Blocked before any thread starts, so that every thread inherits it and sigwait below is the
  // only receiver.
  sigset_t stop_signals;
  sigemptyset(&stop_signals);
  sigaddset(&stop_signals, SIGTERM);
  sigaddset(&stop_signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &stop_signals, nullptr);

  UseOneTorchThread();
  absl::StatusOr<std::unique_ptr<FlowPolicy>> policy = LoadFlowPolicy(policy_name, policy_options);
  if (!policy.ok()) return Fail(policy.status());
  const PolicySpec spec = (*policy)->spec();
  const bool exact_rows = (*policy)->exact_rows();
  absl::StatusOr<std::unique_ptr<PolicyServer>> server =
      PolicyServer::Start(options, {*std::move(policy)});
  if (!server.ok()) return Fail(server.status());
  if (!port_file.empty()) {
    const absl::Status written =
        WriteFileAtomically(port_file, absl::StrCat((*server)->port(), "\n"));
    if (!written.ok()) return Fail(written);
  }
  const std::string host = options.listen.substr(0, options.listen.rfind(':'));
  std::printf("serving %s (%s) on %s:%d with %d threads\n", spec.name.c_str(),
              spec.model_hash.c_str(), host.c_str(), (*server)->port(), options.threads);
  std::printf("batches of at most %d; lockstep predictions are %s\n", options.max_batch,
              exact_rows ? "batched too: this policy's rows have the bits of batches of one"
                         : "computed alone: this policy's rows agree to rounding only");
  std::fflush(stdout);

  int signal = 0;
  sigwait(&stop_signals, &signal);
  std::printf("stopping\n");
  std::fflush(stdout);
  (*server)->Stop(absl::Seconds(grace_s));
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
