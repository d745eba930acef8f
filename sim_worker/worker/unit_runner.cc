#include "sim_worker/worker/unit_runner.h"

#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/image.h"
#include "common/joint_errors/scenario_file.h"
#include "common/rollout/replay_chunks.h"
#include "common/rollout/replay_policy.h"
#include "common/rollout/rollout.h"
#include "common/rpc/policy_client.h"
#include "common/status_macros.h"
#include "sim_worker/worker/episode_row.h"
#include "sim_worker/worker/unit_directory.h"
#include "sim_worker/worker/unit_plan.h"

namespace robostress {
namespace {

constexpr int kFilmEvery = 2;     // control steps: 10 frames per second
constexpr double kFrameS = 0.1;   // [s]
constexpr int kFilmHeight = 160;  // [px]
constexpr float kFilmQuality = 60;

// Collects the frames of one episode.
class Film {
 public:
  explicit Film(const UnitTask& task) : task_(task) {}

  void OnStep(int step) {
    last_step_ = step;
    if (step % kFilmEvery == 0) Take();
  }

  absl::StatusOr<std::string> Encode() {
    if (last_step_ % kFilmEvery != 0) Take();  // how it ended
    RS_RETURN_IF_ERROR(status_);
    return EncodeAnimatedWebp(frames_, kFrameS, kFilmQuality);
  }

 private:
  void Take() {
    if (!status_.ok()) return;
    absl::StatusOr<Image> frame = task_.film(kFilmHeight);
    status_ = frame.status();
    if (frame.ok()) frames_.push_back(*std::move(frame));
  }

  const UnitTask& task_;
  int last_step_ = 0;
  std::vector<Image> frames_;
  absl::Status status_;
};

class UnitRun {
 public:
  UnitRun(UnitConfig unit, std::vector<PlannedEpisode> plan, const UnitRunOptions& options,
          const TaskFactory& make_task)
      : unit_(std::move(unit)),
        plan_(std::move(plan)),
        options_(options),
        make_task_(make_task),
        adapts_(unit_.method.adapt) {}

  absl::Status Run() {
    RS_RETURN_IF_ERROR(CheckServerIsGiven());
    RS_ASSIGN_OR_RETURN(directory_, UnitDirectory::Open(options_.out, unit_, plan_));
    if (directory_->done()) {
      Say(absl::StrCat("already complete: ", plan_.size(), " episodes in ", options_.out));
      return absl::OkStatus();
    }
    RS_RETURN_IF_ERROR(OpenPolicy());
    RS_RETURN_IF_ERROR(Resume());
    while (directory_->episodes() < plan_.size())
      RS_RETURN_IF_ERROR(RunOne(directory_->episodes()));
    if (!adapts_) return directory_->Finish(nullptr);
    RS_ASSIGN_OR_RETURN(const AdapterState adapter, client_->ExportAdapter());
    return directory_->Finish(&adapter.safetensors);
  }

 private:
  absl::Status CheckServerIsGiven() const {
    if (RunsLocally(unit_.policy) || !options_.server.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("policy '", unit_.policy,
                     "' runs in a policy server; start one with `robostress serve --policy ",
                     unit_.policy, "` and pass its address with --server HOST:PORT"));
  }

  // Opens what outlives a task: the session, or the replay. The expert is made with its task.
  absl::Status OpenPolicy() {
    if (unit_.policy == "expert") return directory_->CheckModel(unit_.policy, "");
    if (unit_.policy == "replay") {
      RS_ASSIGN_OR_RETURN(local_, MakeReplayPolicy(unit_.replay_file));
      return directory_->CheckModel(unit_.policy, local_->spec().model_hash);
    }
    PolicyClientOptions client;
    client.address = options_.server;
    client.connect_timeout_s = options_.connect_timeout_s;
    client.call_timeout_s = options_.call_timeout_s;
    RS_ASSIGN_OR_RETURN(client_, GrpcPolicyClient::Connect(client, SessionSpecOf(unit_)));
    if (adapts_ && !client_->spec().adaptable) {
      return absl::InvalidArgumentError(
          absl::StrCat("policy '", unit_.policy, "' cannot be adapted, method '",
                       unit_.method.method, "' needs that; use method base"));
    }
    return directory_->CheckModel(unit_.policy, client_->spec().model_hash);
  }

  absl::Status Resume() {
    if (adapts_) {
      const absl::StatusOr<std::string> state = directory_->LoadAdapterState();
      if (state.ok()) {
        RS_ASSIGN_OR_RETURN(sequence_, client_->ImportAdapter(*state));
      } else if (!absl::IsNotFound(state.status())) {
        return state.status();
      } else if (directory_->episodes() > 0) {
        Say(absl::StrCat("starting over: ", state.status().message()));
        RS_RETURN_IF_ERROR(directory_->Restart());
      }
    }
    if (directory_->episodes() > 0) {
      Say(absl::StrCat("continuing after ", directory_->episodes(), " of ", plan_.size(),
                       " episodes"));
    }
    return absl::OkStatus();
  }

  absl::Status OpenTask(int task) {
    if (task_index_ == task) return absl::OkStatus();
    if (unit_.policy == "expert") local_.reset();  // it reads the task that goes
    RS_ASSIGN_OR_RETURN(task_, make_task_(unit_, task));
    if (options_.measure_lag) {
      UnitConfig clean = unit_;
      clean.scenario = "clean";
      RS_ASSIGN_OR_RETURN(clean_task_, make_task_(clean, task));
    }
    task_index_ = task;
    if (options_.record_joints && !task_.listen_to_joints)
      return absl::UnimplementedError("this robot keeps no record of its joints");
    if (unit_.policy == "expert") {
      RS_ASSIGN_OR_RETURN(local_, task_.make_expert());
    }
    return absl::OkStatus();
  }

  void DescribeEpisode(const PlannedEpisode& planned, const EpisodeRecord& record,
                       JointLog& log) const {
    log.suite = unit_.suite;
    log.scenario = ScenarioLabel(unit_.scenario);
    log.policy = unit_.policy;
    log.severity = unit_.severity;
    log.task = planned.task;
    log.episode = planned.episode;
    log.initial_state = planned.initial_state;
    log.success = record.success;
    for (const ExecutedChunk& chunk : record.chunks) {
      for (const ExecutedStep& step : chunk.steps) {
        log.states.push_back(step.before);
        log.actions.push_back(step.sent_command);
      }
    }
    if (!record.chunks.empty()) log.states.push_back(record.chunks.back().final_state);
  }

  absl::Status RunOne(size_t index) {
    const PlannedEpisode& planned = plan_[index];
    const auto start = std::chrono::steady_clock::now();
    RS_RETURN_IF_ERROR(OpenTask(planned.task));
    PolicyEndpoint& policy = client_ != nullptr ? static_cast<PolicyEndpoint&>(*client_) : *local_;
    Film film(task_);
    RolloutOptions rollout;
    rollout.initial_state = planned.initial_state;
    if (planned.film) rollout.on_step = [&](int step) { film.OnStep(step); };
    JointLog joints;
    if (options_.record_joints)
      task_.listen_to_joints([&](const JointSample& sample) { joints.samples.push_back(sample); });
    RS_ASSIGN_OR_RETURN(
        const EpisodeRecord record,
        RunEpisode({planned.task, planned.episode}, rollout, *task_.robot, policy, sequence_));
    if (options_.record_joints) {
      task_.listen_to_joints(nullptr);
      DescribeEpisode(planned, record, joints);
      RS_RETURN_IF_ERROR(directory_->WriteJoints(planned, joints));
    }
    RS_ASSIGN_OR_RETURN(const SessionStats stats, policy.Stats());
    if (planned.film) {
      RS_ASSIGN_OR_RETURN(const std::string webp, film.Encode());
      RS_RETURN_IF_ERROR(directory_->WriteVideo(planned, webp));
    }
    std::optional<AdapterState> adapter;
    if (adapts_) {
      RS_ASSIGN_OR_RETURN(adapter, client_->ExportAdapter());
    }
    const double wall_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::optional<std::vector<ExecutedChunk>> in_clean;
    if (options_.measure_lag) {
      RS_ASSIGN_OR_RETURN(in_clean,
                          ReplayChunks(record.chunks, planned.initial_state, *clean_task_.robot));
    }
    const EpisodeRow row = MakeEpisodeRow(unit_, planned, record, stats, in_clean);
    RS_RETURN_IF_ERROR(directory_->Append(EpisodeLine(IdentityOf(unit_, planned), row),
                                          TimingLine(MakeTimingRow(planned, record, wall_s)),
                                          adapter ? &adapter->safetensors : nullptr));
    Say(ProgressLine(index, plan_.size(), row, wall_s));
    return absl::OkStatus();
  }

  void Say(std::string_view line) const {
    if (options_.progress) options_.progress(line);
  }

  const UnitConfig unit_;  // resolved
  const std::vector<PlannedEpisode> plan_;
  const UnitRunOptions& options_;
  const TaskFactory& make_task_;
  const bool adapts_;
  std::unique_ptr<UnitDirectory> directory_;
  int task_index_ = -1;
  UnitTask task_;
  UnitTask clean_task_;  // the same task without joint errors; with measure_lag only
  std::unique_ptr<PolicyEndpoint> local_;  // expert (reads task_), replay
  std::unique_ptr<GrpcPolicyClient> client_;
  uint64_t sequence_ = 0;  // of the last feedback sent
};

}  // namespace

absl::Status RunUnit(const UnitConfig& unit, const UnitRunOptions& options,
                     const TaskFactory& make_task) {
  RS_ASSIGN_OR_RETURN(UnitConfig resolved, ResolveUnit(unit));
  RS_ASSIGN_OR_RETURN(std::vector<PlannedEpisode> plan, PlanRange(resolved, options.episodes));
  return UnitRun(std::move(resolved), std::move(plan), options, make_task).Run();
}

}  // namespace robostress
