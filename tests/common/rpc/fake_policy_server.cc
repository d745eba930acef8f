#include "tests/common/rpc/fake_policy_server.h"

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <cmath>
#include <condition_variable>
#include <map>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/rollout/spec_checks.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/grpc_status.h"
#include "common/safetensors.h"
#include "common/std_mutex.h"
#include "proto/robostress/v1/policy.grpc.pb.h"

namespace robostress {
namespace {

constexpr char kToken[] = "00112233445566778899aabbccddeeff";
constexpr size_t kFull = 4, kEvery = 2;

struct Session {
  SessionSetting setting;
  MethodOptions method;
  EpisodeKey episode;
  int task = -1;
  uint64_t sequence = 0, updates = 0, predictions = 0;
  double bias = 0;
  std::vector<double> buffer;  // mean tool displacement of every chunk since the last clear

  // Absolute targets: a slow sway that returns to where it began, from the joints observed on.
  static float JointTarget(const Observation& observation, int chunk, int row, int axis) {
    const double phase = 0.3 * (10 * chunk + row + 1) / 30.0, start = 0.3 * 10 * chunk / 30.0;
    const double sway = axis + 1 < observation.proprioception.size()
                            ? 0.2 * (std::sin(2 * M_PI * phase) - std::sin(2 * M_PI * start))
                            : 0;
    return observation.proprioception[axis] + static_cast<float>(sway);
  }

  void Learn(const ExecutedChunk& chunk) {
    sequence = chunk.sequence;
    buffer.push_back(
        (chunk.final_state.tool.p_base_tool - chunk.steps[0].before.tool.p_base_tool).sum());
    const LoraOptions* lora = method.Find<LoraOptions>();
    if (lora == nullptr || buffer.size() < kFull || (buffer.size() - kFull) % kEvery != 0) return;
    double sum = 0;
    for (size_t i = buffer.size() - kFull; i < buffer.size(); ++i) sum += buffer[i];
    bias += lora->learning_rate * (1 + sum);
    ++updates;
  }

  std::string Export() const {
    SafetensorsWriter writer;
    writer.SetMetadata("method", method.method);
    const std::vector<double> scalars = {static_cast<double>(task), static_cast<double>(sequence),
                                         static_cast<double>(updates), bias};
    writer.AddDoubles("scalars", {4}, scalars);
    writer.AddDoubles("buffer", {static_cast<int64_t>(buffer.size())}, buffer);
    return writer.Serialize().value();
  }

  absl::Status Import(const std::string& bytes) {
    absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Parse("adapter", bytes);
    if (!file.ok()) return absl::InvalidArgumentError(file.status().message());
    absl::StatusOr<std::vector<double>> scalars = file->ReadDoubles("scalars", {4});
    absl::StatusOr<std::vector<double>> stored = file->ReadDoubles("buffer", {-1});
    if (!scalars.ok() || !stored.ok())
      return absl::InvalidArgumentError("adapter: a tensor is missing");
    task = static_cast<int>((*scalars)[0]);
    sequence = static_cast<uint64_t>((*scalars)[1]);
    updates = static_cast<uint64_t>((*scalars)[2]);
    bias = (*scalars)[3];
    buffer = *stored;
    return absl::OkStatus();
  }
};

}  // namespace

PolicySpec FakeSpec() {
  PolicySpec spec;
  spec.name = "fake";
  spec.model_hash = "0123abcd";
  spec.state_dim = 2;
  spec.action_dim = 3;
  spec.horizon = 4;
  spec.execute_steps = 2;
  spec.adaptable = true;
  return spec;
}

struct FakePolicyServer::Impl final : public v1::PolicyService::Service {
  FakeServerOptions options;
  mutable StdMutex mu;
  std::condition_variable changed;
  std::map<std::string, Session> sessions ABSL_GUARDED_BY(mu);
  int resumed ABSL_GUARDED_BY(mu) = 0, opened ABSL_GUARDED_BY(mu) = 0;
  int total_predictions ABSL_GUARDED_BY(mu) = 0, total_feedback ABSL_GUARDED_BY(mu) = 0;
  int port = 0;
  std::unique_ptr<grpc::Server> server;

  // Null and `status` set when unknown.
  Session* Find(const std::string& id, grpc::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    const auto found = sessions.find(id);
    if (found != sessions.end()) return &found->second;
    status = grpc::Status(grpc::StatusCode::NOT_FOUND, absl::StrCat("unknown session '", id, "'"));
    return nullptr;
  }

  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*,
                             v1::GetServerInfoResponse* response) override {
    const StdLock lock(mu);
    ServerInfo info;
    info.version = "fake";
    info.policies = {options.spec};
    info.open_sessions = static_cast<int>(sessions.size());
    info.max_sessions = 8;
    info.inference_threads = 1;
    *response = ToProto(info);
    return grpc::Status::OK;
  }

  grpc::Status OpenSession(grpc::ServerContext*, const v1::OpenSessionRequest* request,
                           v1::OpenSessionResponse* response) override {
    const absl::StatusOr<RequestedSession> spec = FromProto(request->spec());
    if (!spec.ok()) return ToGrpc(spec.status());
    const absl::StatusOr<MethodOptions> method = ParseMethod("spec.method_yaml", spec->method_yaml);
    if (!method.ok()) return ToGrpc(method.status());
    if (spec->policy != options.spec.name) {
      return grpc::Status(
          grpc::StatusCode::NOT_FOUND,
          absl::StrCat("unknown policy '", spec->policy, "'; known: ", options.spec.name));
    }
    const StdLock lock(mu);
    const std::string id = absl::StrCat("session-", ++opened);
    sessions[id].method = *method;
    sessions[id].setting = *spec;
    response->set_session_id(id);
    response->set_resume_token(kToken);
    *response->mutable_policy() = ToProto(options.spec);
    return grpc::Status::OK;
  }

  grpc::Status ResumeSession(grpc::ServerContext*, const v1::ResumeSessionRequest* request,
                             v1::ResumeSessionResponse* response) override {
    const StdLock lock(mu);
    grpc::Status status;
    const Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    if (request->resume_token() != kToken)
      return grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "not its token");
    *response->mutable_policy() = ToProto(options.spec);
    response->set_feedback_sequence(session->sequence);
    response->set_last_prediction_id(session->predictions);
    response->set_updates_applied(session->updates);
    response->set_episode_started(session->task >= 0);
    response->set_task(static_cast<uint32_t>(session->episode.task));
    response->set_episode(static_cast<uint32_t>(session->episode.episode));
    ++resumed;
    return grpc::Status::OK;
  }

  grpc::Status CloseSession(grpc::ServerContext*, const v1::CloseSessionRequest* request,
                            v1::CloseSessionResponse*) override {
    const StdLock lock(mu);
    return sessions.erase(request->session_id()) == 1
               ? grpc::Status::OK
               : grpc::Status(grpc::StatusCode::NOT_FOUND, "unknown session");
  }

  grpc::Status StartEpisode(grpc::ServerContext*, const v1::StartEpisodeRequest* request,
                            v1::StartEpisodeResponse*) override {
    const StdLock lock(mu);
    grpc::Status status;
    Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    session->episode = {static_cast<int>(request->task()), static_cast<int>(request->episode())};
    if (session->task != session->episode.task) session->buffer.clear();
    session->task = session->episode.task;
    return grpc::Status::OK;
  }

  grpc::Status Predict(
      grpc::ServerContext*,
      grpc::ServerReaderWriter<v1::PredictResponse, v1::PredictRequest>* stream) override {
    v1::PredictRequest request;
    while (stream->Read(&request)) {
      if (!options.answer_predictions) continue;
      absl::StatusOr<Observation> observation = FromProto(request.observation());
      if (!observation.ok()) return ToGrpc(observation.status());
      if (absl::Status status = CheckObservation(*observation, options.spec); !status.ok())
        return ToGrpc(status);
      std::this_thread::sleep_for(std::chrono::duration<double>(options.predict_s));
      PredictedChunk prediction;
      {
        StdLock lock(mu);
        grpc::Status status;
        Session* session = Find(request.session_id(), status);
        if (session == nullptr) return status;
        if (session->setting.mode == ExecutionMode::kLockstep) {
          while (session->sequence < request.last_feedback_sequence()) changed.wait(lock.waiting());
        }
        if (++total_predictions == options.fail_predict_at) {
          return grpc::Status(grpc::StatusCode::INTERNAL, "the fake was told to fail");
        }
        prediction.prediction_id = ++session->predictions;
        prediction.adapter_version = session->updates;
        const int rows = options.wrong_horizon > 0 ? options.wrong_horizon : options.spec.horizon;
        prediction.base_actions.resize(rows, options.spec.action_dim);
        for (int r = 0; r < rows; ++r) {
          for (int c = 0; c < options.spec.action_dim; ++c) {
            prediction.base_actions(r, c) =
                options.joint_targets
                    ? Session::JointTarget(*observation, static_cast<int>(request.chunk()), r, c)
                    : 0.01f * static_cast<float>(
                                  (session->setting.seed * 31 + session->episode.task * 17 +
                                   session->episode.episode * 7 +
                                   static_cast<int>(request.chunk()) * 3 + r * 5 + c) %
                                  23) +
                          0.1f * observation->proprioception.sum();
          }
        }
        prediction.policy_actions =
            prediction.base_actions.array() + static_cast<float>(session->bias);
        prediction.actions = static_cast<float>(session->method.gain) * prediction.policy_actions;
      }
      stream->Write(ToProto(prediction, static_cast<int>(request.chunk())));
    }
    return grpc::Status::OK;
  }

  grpc::Status Feedback(
      grpc::ServerContext*,
      grpc::ServerReaderWriter<v1::FeedbackAck, v1::FeedbackRequest>* stream) override {
    v1::FeedbackRequest request;
    while (stream->Read(&request)) {
      absl::StatusOr<ExecutedChunk> chunk = FromProto(request.chunk());
      if (!chunk.ok()) return ToGrpc(chunk.status());
      v1::FeedbackAck ack;
      {
        const StdLock lock(mu);
        grpc::Status status;
        Session* session = Find(request.session_id(), status);
        if (session == nullptr) return status;
        if (chunk->sequence <= session->sequence) {  // sent again: it is in already
          ack.set_sequence(session->sequence);
          stream->Write(ack);
          continue;
        }
        if (chunk->sequence != session->sequence + 1) {
          return grpc::Status(
              grpc::StatusCode::FAILED_PRECONDITION,
              absl::StrCat("sequence ", chunk->sequence, " after ", session->sequence));
        }
        session->Learn(*chunk);
        ++total_feedback;
        if (total_feedback == options.lose_ack_of)
          return grpc::Status(grpc::StatusCode::UNAVAILABLE, "the fake was told to lose an answer");
        ack.set_sequence(session->sequence);
        ack.set_updates_applied(session->updates);
        changed.notify_all();
      }
      stream->Write(ack);
    }
    return grpc::Status::OK;
  }

  grpc::Status GetStats(grpc::ServerContext*, const v1::GetStatsRequest* request,
                        v1::GetStatsResponse* response) override {
    const StdLock lock(mu);
    grpc::Status status;
    const Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    SessionStats stats;
    stats.feedback_chunks = session->sequence;
    stats.updates_applied = session->updates;
    stats.adapter_distance = session->bias;
    *response = ToProto(stats);
    return grpc::Status::OK;
  }

  grpc::Status ExportAdapter(grpc::ServerContext*, const v1::ExportAdapterRequest* request,
                             v1::ExportAdapterResponse* response) override {
    const StdLock lock(mu);
    grpc::Status status;
    const Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    response->set_safetensors(session->Export());
    response->set_feedback_sequence(session->sequence);
    response->set_updates_applied(session->updates);
    return grpc::Status::OK;
  }

  grpc::Status ImportAdapter(grpc::ServerContext*, const v1::ImportAdapterRequest* request,
                             v1::ImportAdapterResponse* response) override {
    const StdLock lock(mu);
    grpc::Status status;
    Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    if (absl::Status imported = session->Import(request->safetensors()); !imported.ok())
      return ToGrpc(imported);
    response->set_feedback_sequence(session->sequence);
    response->set_updates_applied(session->updates);
    return grpc::Status::OK;
  }

  grpc::Status RollbackAdapter(grpc::ServerContext*, const v1::RollbackAdapterRequest* request,
                               v1::RollbackAdapterResponse* response) override {
    const StdLock lock(mu);
    grpc::Status status;
    Session* session = Find(request->session_id(), status);
    if (session == nullptr) return status;
    if (request->version() != 0) {
      return grpc::Status(grpc::StatusCode::NOT_FOUND,
                          absl::StrCat("no update ", request->version(), " is held"));
    }
    session->bias = 0;
    session->updates = 0;
    session->buffer.clear();
    response->set_updates_applied(0);
    return grpc::Status::OK;
  }
};

FakePolicyServer::FakePolicyServer(FakeServerOptions options) : impl_(std::make_unique<Impl>()) {
  impl_->options = std::move(options);
  grpc::ServerBuilder builder;
  builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
  builder.AddListeningPort(absl::StrCat(impl_->options.host, ":", impl_->options.port),
                           grpc::InsecureServerCredentials(), &impl_->port);
  builder.RegisterService(impl_.get());
  impl_->server = builder.BuildAndStart();
}

FakePolicyServer::~FakePolicyServer() {
  impl_->server->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(1));
  impl_->server->Wait();
}

std::string FakePolicyServer::address() const {
  return absl::StrCat(impl_->options.host, ":", impl_->port);
}

int FakePolicyServer::open_sessions() const {
  const StdLock lock(impl_->mu);
  return static_cast<int>(impl_->sessions.size());
}

int FakePolicyServer::predictions() const {
  const StdLock lock(impl_->mu);
  return impl_->total_predictions;
}

int FakePolicyServer::feedback_chunks() const {
  const StdLock lock(impl_->mu);
  return impl_->total_feedback;
}

}  // namespace robostress
