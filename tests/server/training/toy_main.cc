#include <ATen/Parallel.h>
#include <torch/types.h>

#include <cstdio>
#include <cstdlib>
#include <string>

#include "server/policies/policy.h"
#include "tests/server/training/toy_world.h"

// toy_world write DIR EPISODES STRIDE SEED | toy_world play WEIGHTS EPISODES: demonstrations for
// robostress-train, and the success of what it trained, in a world without physics.
int main(int argc, char** argv) {
  using namespace robostress;
  const std::string mode = argc > 1 ? argv[1] : "";
  if (mode == "write" && argc == 6) {
    const absl::Status status =
        WriteToyDemonstrations(argv[2], std::atoi(argv[3]), std::atoi(argv[4]), std::atoi(argv[5]));
    std::printf("%s\n", status.ToString().c_str());
    return status.ok() ? 0 : 1;
  }
  if (mode != "play" || argc != 4) {
    std::fprintf(
        stderr,
        "usage: toy_world write DIR EPISODES STRIDE SEED | toy_world play WEIGHTS EPISODES\n");
    return 1;
  }
  at::set_num_threads(1);
  auto policy = LoadFlowPolicy(argv[2]);
  if (!policy.ok()) {
    std::fprintf(stderr, "%s\n", policy.status().ToString().c_str());
    return 1;
  }
  const int episodes = std::atoi(argv[3]);
  int successes = 0, expert_successes = 0;
  for (int episode = 0; episode < episodes; ++episode) {
    const StreamKey key = StreamKey("toy-play").With(episode);
    ToyWorld expert{RandomStream(key)}, world{RandomStream(key)};
    for (int step = 0; step < 150 && !expert.success(); ++step)
      expert.Step(expert.ExpertChunk().row(0).transpose());
    expert_successes += expert.success();
    for (int chunk = 0; chunk < 40 && !world.success(); ++chunk) {
      const PolicyContext context = (*policy)->Encode(world.Observe()).value();
      torch::manual_seed(episode * 1000 + chunk);
      const torch::Tensor noise =
          torch::randn({1, (*policy)->horizon(), (*policy)->model_action_dim()});
      const Eigen::MatrixXf actions =
          (*policy)->ToEnvironment((*policy)->Sample(context, noise, nullptr)[0], context.state);
      for (int k = 0; k < (*policy)->spec().execute_steps && !world.success(); ++k) {
        world.Step(actions.row(k).transpose());
      }
    }
    successes += world.success();
  }
  std::printf("expert %d/%d, policy %d/%d\n", expert_successes, episodes, successes, episodes);
  return 0;
}
