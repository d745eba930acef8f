// A stand-in for robostress-worker that speaks its command line and writes its files without a
// simulator: outcomes are drawn from streams keyed by the episode, so they are the same in every
// order of dispatch.
//   FAKE_FAIL_SCENARIO=name  exits with code 3 in units of that scenario
//   FAKE_KILL_SCENARIO=name  is killed in units of that scenario
//   FAKE_EPISODE_MS=n        takes that long per episode
//   FAKE_WORKER_GATE=file    waits before its second episode until that file is there
// Unlike the real worker it begins a unit that was interrupted from its first episode.

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/image.h"
#include "common/joint_errors/scenario_file.h"
#include "common/random.h"
#include "common/records/episode_row.h"
#include "common/records/json_record.h"
#include "common/records/server_row.h"
#include "common/unit_config.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

struct WorkerArguments {
  std::string program, unit, out, server, episodes;
  bool lag = false;
};

std::string Episode(const UnitConfig& config, int task, int episode, int index, bool lag) {
  const int initial_state = config.first_initial_state + episode;
  const StreamKey key = StreamKey("fake").With(config.suite).With(task).With(initial_state);
  RandomStream difficulty(key),
      chance(
          key.With(ScenarioLabel(config.scenario)).With(config.method->method).With(config.seed));
  const bool clean = config.scenario == "clean";
  const int updates = config.method->adapts() ? std::max(0, (index * 20 - 32) / 8) : 0;
  const double gain = config.method->adapts() ? 0.1 * std::min(1.0, updates / 20.0) : 0;
  const bool success = difficulty.Uniform() + 0.2 * chance.Normal() < (clean ? 0.92 : 0.5 + gain);
  const bool desired = config.sim.goal_reference == GoalReference::kDesired;
  const double residual = (desired ? 2 : 1) * ((clean ? 0.21 : 0.45) + 0.03 * chance.Normal());
  const double a_sq = 20 + 5 * chance.Uniform();
  EpisodeRow row;
  row.success = success;
  row.steps = success ? 110 : 300;
  row.chunks = success ? 22 : 60;
  row.updates = updates;
  row.residual = residual;
  row.eta_sq = row.intent_eta_sq = residual * residual * a_sq;
  row.a_sq = row.intent_a_sq = a_sq;
  row.intent = residual * 1.02;
  row.residual_tracking = residual * 0.6;
  row.mean_abs_action = 0.21;
  row.clipped_share = 0.01;
  row.adapter_distance = 0.01 * std::sqrt(updates);
  if (lag) row.lag_residual = (clean ? 1 : 0.5) * residual;
  return EpisodeLine({.suite = config.suite,
                      .scenario = ScenarioLabel(config.scenario),
                      .policy = config.policy,
                      .method = config.method->method,
                      .severity = config.severity,
                      .seed = config.seed,
                      .task = task,
                      .episode = episode,
                      .initial_state = initial_state},
                     row);
}

absl::Status Film(const std::string& out, int task, int episode) {
  std::vector<Image> frames(4);
  for (size_t f = 0; f < frames.size(); ++f) {
    frames[f].width = 96, frames[f].height = 64;
    frames[f].data.assign(96 * 64 * 3, static_cast<uint8_t>(60 * f + 20));
  }
  const absl::StatusOr<std::string> film = EncodeAnimatedWebp(frames, 0.2, 70);
  if (!film.ok()) return film.status();
  return WriteFileAtomically(
      out + "/videos/task" + std::to_string(task) + "_episode" + std::to_string(episode) + ".webp",
      *film);
}

void WaitForGate() {
  const char* gate = std::getenv("FAKE_WORKER_GATE");
  while (gate != nullptr && access(gate, F_OK) != 0) poll(nullptr, 0, 20);
}

int Run(const WorkerArguments& options) {
  const std::string& out = options.out;
  const absl::StatusOr<UnitConfig> config = LoadConfig<UnitConfig>(options.unit);
  if (!config.ok()) {
    std::fprintf(stderr, "%s\n", std::string(config.status().message()).c_str());
    return 2;
  }
  const char* fail = std::getenv("FAKE_FAIL_SCENARIO");
  if (fail != nullptr && config->scenario == fail) {
    std::fprintf(stderr, "fake worker: no simulator for scenario %s\n", fail);
    return 3;
  }
  const char* killed = std::getenv("FAKE_KILL_SCENARIO");
  if (killed != nullptr && config->scenario == killed) raise(SIGKILL);
  const char* episode_ms = std::getenv("FAKE_EPISODE_MS");
  int first = 0, last = static_cast<int>(config->tasks.size()) * config->episodes - 1;
  if (!options.episodes.empty() &&
      std::sscanf(options.episodes.c_str(), "%d-%d", &first, &last) != 2)
    return 2;
  absl::Status status = MakeDirectories(out + "/videos");
  // One worker at a time, as with the real one; the lock goes with the process.
  flock(open(out.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC), LOCK_EX);
  // As the real one: whoever waited for the lock may find that all is done.
  if (access((out + "/DONE").c_str(), F_OK) == 0) return 0;
  if (status.ok()) status = WriteFileAtomically(out + "/config.yaml", DumpConfig(*config));
  if (status.ok()) {
    const nlohmann::json provenance = {
        {"policy", config->policy}, {"model_hash", "fake"}, {"version", "0"}};
    status = WriteFileAtomically(out + "/provenance.json", provenance.dump() + "\n");
  }
  if (status.ok() && config->remote.used()) {
    ServerRow served;
    served.url = options.server;
    served.metadata_sha256 = Sha256Hex("{}");
    served.reconnections = 1;
    status = AppendLine(out + "/servers.jsonl", RecordJson(served).dump());
  }
  for (const char* file : {"/episodes.jsonl", "/timing.jsonl"}) {
    if (status.ok()) status = WriteFileAtomically(out + file, "");
  }
  if (status.ok()) status = AppendLine(out + "/starts.txt", options.program);
  if (status.ok()) status = AppendLine(out + "/server.txt", options.server);
  int index = 0;
  std::string rows;
  for (const int task : config->tasks) {
    for (int episode = 0; episode < config->episodes && status.ok(); ++episode, ++index) {
      if (index < first || index > last) continue;
      if (index > first) WaitForGate();
      if (episode_ms != nullptr) poll(nullptr, 0, std::atoi(episode_ms));
      const std::string row = Episode(*config, task, episode, index, options.lag);
      rows += row + "\n";
      status = AppendLine(out + "/episodes.jsonl", row);
      if (status.ok()) status = AppendLine(out + "/timing.jsonl", TimingLine({task, episode, 0.5}));
      if (status.ok() && episode < config->videos) status = Film(out, task, episode);
    }
  }
  if (status.ok()) {
    const nlohmann::json done = {{"episodes", last - first + 1},
                                 {"episodes_sha256", Sha256Hex(rows)}};
    status = WriteFileAtomically(out + "/DONE", done.dump() + "\n");
  }
  if (!status.ok()) std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::WorkerArguments options;
  options.program = argv[0];
  for (int i = 1; i < argc; ++i) {
    const std::string flag = argv[i];
    if (flag == "--lag") options.lag = true;
    if (i + 1 == argc) break;
    if (flag == "--unit") options.unit = argv[i + 1];
    if (flag == "--out") options.out = argv[i + 1];
    if (flag == "--server") options.server = argv[i + 1];
    if (flag == "--episodes") options.episodes = argv[i + 1];
  }
  return robostress::Run(options);
}
