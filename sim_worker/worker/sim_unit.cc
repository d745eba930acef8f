#include "sim_worker/worker/sim_unit.h"

#include <algorithm>
#include <chrono>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/image.h"
#include "common/joint_errors/scenario_file.h"
#include "common/robot_description.h"
#include "common/rollout/replay_chunks.h"
#include "common/rollout/replay_policy.h"
#include "common/rollout/rollout.h"
#include "common/rpc/policy_client.h"
#include "common/status_macros.h"
#include "common/wire/remote_policy.h"
#include "sim_worker/worker/sim_episode_row.h"

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

// Collects a recording of one episode.
class Recorder {
 public:
  Recorder(const UnitTask& task, int side) : task_(task), side_(side) {}

  // Before a step, and after the last one.
  void OnStep() {
    if (!status_.ok()) return;
    absl::StatusOr<RecordedMoment> moment = task_.moment(side_);
    status_ = moment.status();
    if (!moment.ok()) return;
    std::vector<std::string> pictures;
    for (const CameraView& view : moment->observation.views) {
      absl::StatusOr<std::string> png = EncodePng(view.image);
      status_.Update(png.status());
      if (!png.ok()) return;
      pictures.push_back(*std::move(png));
      if (moments_.empty()) recording_.cameras.push_back(view.camera);
    }
    pictures_.push_back(std::move(pictures));
    moment->observation.views.clear();
    moments_.push_back(*std::move(moment));
  }

  // With what was executed.
  absl::StatusOr<EpisodeRecording> Finish(const EpisodeRecord& record) {
    RS_RETURN_IF_ERROR(status_);
    const ResidualOptions scales;  // of the simulated arm's commands
    for (const ExecutedChunk& chunk : record.chunks) {
      for (size_t i = 0; i < chunk.steps.size(); ++i) {
        const ExecutedStep& executed = chunk.steps[i];
        RecordedMoment& moment = moments_[recording_.steps.size()];
        EpisodeRecording::Step& step = recording_.steps.emplace_back();
        step.before = executed.before;
        step.commanded = executed.policy_command;
        step.sent = executed.sent_command;
        step.measured = executed.sent_command;
        step.measured.head<6>() =
            AchievedDelta(executed.before, StateAfter(chunk, i), scales).cast<float>();
        step.proprioception = moment.observation.proprioception;
        step.simulator = std::move(moment.simulator);
      }
    }
    recording_.pictures.resize(recording_.cameras.size());
    for (size_t i = 0; i < recording_.steps.size(); ++i)
      for (size_t c = 0; c < recording_.cameras.size(); ++c)
        recording_.pictures[c].push_back(std::move(pictures_[i][c]));
    recording_.instruction = moments_[0].observation.instruction;
    recording_.success = record.success;
    recording_.rate_hz = 1 / kPanda.control_period_s;
    recording_.task_name = task_.name;
    recording_.problem = task_.problem;
    recording_.model_file = task_.mjcf();
    return std::move(recording_);
  }

 private:
  const UnitTask& task_;
  const int side_;
  std::vector<RecordedMoment> moments_;
  std::vector<std::vector<std::string>> pictures_;  // [moment][camera]
  EpisodeRecording recording_;
  absl::Status status_;
};

// What a server is asked for where the worker corrects.
MethodOptions WithoutCorrection(MethodOptions method) {
  method.method = method.adapts() ? "ours" : "base";
  const auto lora = std::get<std::optional<LoraOptions>>(method.ways);
  method.ways = {};
  std::get<std::optional<LoraOptions>>(method.ways) = lora;
  method.gain = 1;
  method.every_step = false;
  method.smoothing = 0;
  method.panda_dynamics = false;
  method.execute_steps = 0;
  method.arm_model.clear();
  return method;
}

// A policy whose commands are chosen by the task's model of the arm.
class InvertedPolicy : public PolicyEndpoint {
 public:
  // `smoothing`: what `policy` does to the row that is due; those after it are shown so too.
  InvertedPolicy(std::unique_ptr<PolicyEndpoint> policy, double smoothing, const UnitTask* task)
      : policy_(std::move(policy)), smoothing_(smoothing), task_(*task) {}

  const PolicySpec& spec() const override { return policy_->spec(); }
  absl::Status StartEpisode(const EpisodeKey& key) override {
    task_.inversion->StartEpisode();
    return policy_->StartEpisode(key);
  }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override {
    return policy_->Predict(observation, chunk);
  }
  absl::StatusOr<PredictedChunk> PredictAfter(const Observation& observation, int chunk,
                                              const RunningRows& running) override {
    return policy_->PredictAfter(observation, chunk, running);
  }
  absl::StatusOr<Eigen::VectorXf> NextCommand(const PredictedChunk& predicted,
                                              const ExecutedChunk& so_far) override {
    RS_ASSIGN_OR_RETURN(const Eigen::VectorXf due, policy_->NextCommand(predicted, so_far));
    const auto row = static_cast<Eigen::Index>(so_far.steps.size());
    Eigen::MatrixXf rows =
        predicted.policy_actions.bottomRows(predicted.policy_actions.rows() - row);
    rows.row(0) = due.transpose();
    for (Eigen::Index i = 1; i < rows.rows(); ++i) {
      Eigen::VectorXf next = rows.row(i).transpose();
      SmoothCommand(smoothing_, rows.row(i - 1).transpose(), next);
      rows.row(i) = next.transpose();
    }
    return task_.inversion->Command(rows, so_far.final_state);
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    return policy_->SendFeedback(std::move(executed));
  }
  absl::StatusOr<SessionStats> Stats() override { return policy_->Stats(); }

 private:
  const std::unique_ptr<PolicyEndpoint> policy_;
  const double smoothing_;
  const UnitTask& task_;  // the open one
};

class SimPlayer : public UnitPlayer {
 public:
  SimPlayer(const UnitConfig& unit, const SimUnitOptions& options, const TaskFactory& make_task)
      : unit_(unit), options_(options), make_task_(make_task) {}

  // Opens what outlives a task: the session, or the replay. The expert is made with its task.
  absl::StatusOr<std::string> Open() override {
    if (unit_.policy == "expert") return "";
    if (unit_.policy == "replay") {
      RS_ASSIGN_OR_RETURN(local_, MakeReplayPolicy(unit_.replay_file));
      return local_->spec().model_hash;
    }
    if (unit_.remote.used()) return OpenRemote();
    PolicyClientOptions client;
    client.address = options_.server;
    client.connect_timeout_s = options_.connect_timeout_s;
    client.call_timeout_s = options_.call_timeout_s;
    RequestedSession session = SessionOf(unit_);
    if (unit_.method->every_step)
      session.method_yaml = DumpConfig(WithoutCorrection(*unit_.method));
    RS_ASSIGN_OR_RETURN(client_, GrpcPolicyClient::Connect(client, session));
    if (unit_.method->every_step) {
      RS_ASSIGN_OR_RETURN(local_, BesideTheArm(client_.get(), session));
    }
    if (unit_.latency.late() && unit_.latency.mode == LateChunks::kRtc && !client_->spec().inpaints)
      return InpaintingError(unit_.policy);
    if (unit_.method->adapts() && !client_->spec().adaptable) {
      return absl::InvalidArgumentError(
          absl::StrCat("policy '", unit_.policy, "' cannot be adapted, method '",
                       unit_.method->method, "' needs that; use method base"));
    }
    return client_->spec().model_hash;
  }

  std::map<std::string, std::string> Provenance() const override {
    std::map<std::string, std::string> notes = options_.notes;
    if (remote_ != nullptr) {
      notes["metadata"] = remote_->metadata();
      notes["noise_paired"] = remote_->pairs_noise() ? "true" : "false";
    }
    return notes;
  }

  std::optional<PolicyServer> Server() const override {
    if (remote_ == nullptr) return std::nullopt;
    const std::string address = remote_->address();
    return PolicyServer{address.substr(0, address.find('?')), remote_->metadata(),
                        remote_->reconnections()};
  }

  absl::StatusOr<std::optional<std::string>> Export() override {
    RS_ASSIGN_OR_RETURN(AdapterState adapter, client_->ExportAdapter());
    return std::move(adapter.safetensors);
  }

  absl::Status Import(const std::string& state) override {
    RS_ASSIGN_OR_RETURN(sequence_, client_->ImportAdapter(state));
    return absl::OkStatus();
  }

  absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode& planned,
                                     UnitDirectory& directory) override {
    const auto start = std::chrono::steady_clock::now();
    RS_RETURN_IF_ERROR(OpenTask(planned.task));
    PolicyEndpoint& policy = local_ != nullptr ? *local_ : static_cast<PolicyEndpoint&>(*client_);
    Film film(task_);
    RolloutOptions rollout;
    rollout.initial_state = planned.initial_state;
    rollout.execute_steps = unit_.method->execute_steps;
    rollout.late = LatePlayOf(unit_.latency, kPanda.control_period_s);
    Recorder recorder(task_, options_.record_views);
    const bool records = options_.record_views > 0;
    if (planned.film || records) {
      rollout.on_step = [&](int step) {
        if (planned.film) film.OnStep(step);
        if (records) recorder.OnStep();
      };
    }
    JointLog joints;
    if (options_.record_joints)
      task_.listen_to_joints([&](const JointSample& sample) { joints.samples.push_back(sample); });
    RS_ASSIGN_OR_RETURN(
        const EpisodeRecord record,
        RunEpisode({planned.task, planned.episode}, rollout, *task_.robot, policy, sequence_));
    if (options_.record_joints) {
      task_.listen_to_joints(nullptr);
      DescribeEpisode(planned, joints);
      AddMotion(record, joints);
      RS_ASSIGN_OR_RETURN(const std::string file,
                          directory.EpisodeFile("joints", planned, ".safetensors"));
      RS_RETURN_IF_ERROR(WriteJointLog(joints, file));
    }
    if (records && record.steps > 0) {
      RS_ASSIGN_OR_RETURN(EpisodeRecording recording, recorder.Finish(record));
      DescribeEpisode(planned, recording);
      RS_ASSIGN_OR_RETURN(const std::string file,
                          directory.EpisodeFile("episodes", planned, ".safetensors"));
      RS_RETURN_IF_ERROR(WriteEpisodeRecording(recording, file));
    }
    RS_ASSIGN_OR_RETURN(const SessionStats stats, policy.Stats());
    if (planned.film) {
      RS_ASSIGN_OR_RETURN(const std::string webp, film.Encode());
      RS_ASSIGN_OR_RETURN(const std::string file,
                          directory.EpisodeFile("videos", planned, ".webp"));
      RS_RETURN_IF_ERROR(WriteFileAtomically(file, webp));
    }
    const double wall_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::optional<std::vector<ExecutedChunk>> in_clean;
    if (options_.measure_lag) {
      RS_ASSIGN_OR_RETURN(in_clean,
                          ReplayChunks(record.chunks, planned.initial_state, *clean_task_.robot));
    }
    return PlayedEpisode{MakeEpisodeRow(unit_, record, stats, in_clean),
                         MakeTimingRow(record, wall_s)};
  }

 private:
  absl::StatusOr<std::string> OpenRemote() {
    const RequestedSession session = SessionOf(unit_);
    RemotePolicyConnection connection;
    RS_ASSIGN_OR_RETURN(connection.wire.socket.secrets, ClientSecretsFromEnvironment());
    connection.wire.socket.connect_timeout = absl::Seconds(options_.connect_timeout_s);
    connection.answer_timeout = absl::Seconds(options_.call_timeout_s);
    connection.first_answer_timeout =
        std::max(connection.first_answer_timeout, connection.answer_timeout);
    RS_ASSIGN_OR_RETURN(remote_, RemotePolicy::Connect(options_.server, unit_.remote, session,
                                                       unit_.method->noise_stream, connection));
    if (unit_.method->adapts()) RS_RETURN_IF_ERROR(CheckWithoutWeights(session, *unit_.method));
    RS_ASSIGN_OR_RETURN(local_, BesideTheArm(remote_.get(), session));
    return remote_->spec().model_hash;
  }

  // A policy with what the method does beside the arm.
  absl::StatusOr<std::unique_ptr<PolicyEndpoint>> BesideTheArm(PolicyEndpoint* policy,
                                                               const SessionSetting& setting) {
    MethodOptions method = *unit_.method;
    const bool inverts = !method.arm_model.empty();
    method.arm_model.clear();
    std::get<std::optional<LoraOptions>>(method.ways).reset();  // the server's
    if (inverts && method.smoothing == 0) method.every_step = false;
    RS_ASSIGN_OR_RETURN(std::unique_ptr<PolicyEndpoint> corrected,
                        CompensatedPolicy::Create(policy, setting, method));
    if (!inverts) return corrected;
    return std::make_unique<InvertedPolicy>(std::move(corrected), method.smoothing, &task_);
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

  // A joint log or a recording.
  template <class Log>
  void DescribeEpisode(const PlannedEpisode& planned, Log& log) const {
    log.suite = unit_.suite;
    log.scenario = ScenarioLabel(unit_.scenario);
    log.policy = unit_.policy;
    log.severity = unit_.severity;
    log.task = planned.task;
    log.episode = planned.episode;
    log.initial_state = planned.initial_state;
    if constexpr (requires { log.method; }) {
      log.method = unit_.method->method;
      log.seed = unit_.seed;
    }
  }

  static void AddMotion(const EpisodeRecord& record, JointLog& log) {
    log.success = record.success;
    for (const ExecutedChunk& chunk : record.chunks) {
      for (const ExecutedStep& step : chunk.steps) {
        log.states.push_back(step.before);
        log.actions.push_back(step.sent_command);
      }
    }
    if (!record.chunks.empty()) log.states.push_back(record.chunks.back().final_state);
  }

  const UnitConfig& unit_;  // resolved
  const SimUnitOptions& options_;
  const TaskFactory& make_task_;
  int task_index_ = -1;
  UnitTask task_;
  UnitTask clean_task_;  // the same task without joint errors; with measure_lag only
  std::unique_ptr<RemotePolicy> remote_;
  std::unique_ptr<GrpcPolicyClient> client_;
  std::unique_ptr<PolicyEndpoint> local_;  // expert (reads task_), replay, one of the two corrected
  uint64_t sequence_ = 0;                  // of the last feedback sent
};

}  // namespace

absl::Status RunSimUnit(const UnitConfig& unit, const SimUnitOptions& options,
                        const TaskFactory& make_task) {
  RS_ASSIGN_OR_RETURN(const UnitConfig resolved, ResolveUnit(unit));
  if (!RunsInWorker(resolved.policy) && options.server.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("policy '", resolved.policy,
                     "' runs in a policy server; start one with `robostress serve --policy ",
                     resolved.policy, "` and pass its address with --server HOST:PORT"));
  }
  const bool records = options.record_joints || options.record_views > 0;
  if (resolved.latency.late() && (options.measure_lag || records)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "latency.ms is ", resolved.latency.ms, ": ",
        options.measure_lag     ? "--lag plays commands"
        : options.record_joints ? "--record-joints records states"
                                : "--record-episodes records commands",
        " of every step of an episode, and no chunk commands the steps before its first answer; "
        "leave one of the two out"));
  }
  SimPlayer player(resolved, options, make_task);
  return RunUnit(resolved, options.run, player);
}

RequestedSession SessionOf(const UnitConfig& resolved) {
  RequestedSession spec;
  spec.suite = resolved.suite;
  spec.scenario = ScenarioLabel(resolved.scenario);
  spec.severity = resolved.severity;
  spec.policy = resolved.policy;
  spec.seed = resolved.seed;
  spec.mode = ExecutionMode::kLockstep;
  spec.control_space = kPanda.control_space;
  spec.control_period_s = kPanda.control_period_s;
  spec.goal_reference = resolved.sim.goal_reference;
  spec.method_yaml = DumpConfig(*resolved.method);
  return spec;
}

}  // namespace robostress
