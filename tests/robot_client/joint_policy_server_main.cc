// joint_policy_server: a policy server without a policy. It speaks robostress.v1 and answers with
// joint targets that sway about where the arm is: for rehearsals, for measuring the client's
// timing, and for tests that end a server in mid-motion.

#include <csignal>
#include <cstdio>

#include "common/command_line.h"
#include "common/run_main.h"
#include "tests/common/rpc/fake_policy_server.h"

int main(int argc, char** argv) {
  robostress::cli::App app("Answers with joint targets that sway about the arm's.",
                           "joint_policy_server");
  robostress::FakeServerOptions options;
  options.joint_targets = true;
  app.add_option("--host", options.host, "address to listen on")->capture_default_str();
  app.add_option("--port", options.port, "0: a free one, which is printed");
  app.add_option("--predict-s", options.predict_s, "time of a prediction [s]");
  int axes = 7;
  app.add_option("--axes", axes, "numbers of a state and of an action")
      ->check(robostress::cli::Range(1, 8));
  int cameras = 2;
  app.add_option("--cameras", cameras, "views it wants: base, wrist")
      ->check(robostress::cli::Range(0, 2));
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  options.spec.name = "sway";
  options.spec.cameras = {"base", "wrist"};
  options.spec.cameras.resize(static_cast<size_t>(cameras));
  options.spec.state_dim = options.spec.action_dim = axes;
  options.spec.horizon = 50;
  options.spec.execute_steps = 10;
  options.spec.adaptable = true;
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigprocmask(SIG_BLOCK, &signals, nullptr);
  const robostress::FakePolicyServer server(options);
  std::printf("joint_policy_server: %s\n", server.address().c_str());
  std::fflush(stdout);
  int signal = 0;
  sigwait(&signals, &signal);
  return 0;
}
