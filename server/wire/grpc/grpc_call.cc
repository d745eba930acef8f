#include "server/wire/grpc/grpc_call.h"

#include <google/protobuf/descriptor.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/support/proto_buffer_reader.h>
#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/monotonic_wait.h"
#include "common/rollout/refusal.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "server/wire/grpc/grpc_access.h"

namespace robostress {
namespace {

using google::protobuf::Message;
using Steady = std::chrono::steady_clock;

// A stream that serves more sessions than a client may have is not counted among the later ones'
// connections.
constexpr size_t kMaxServed = 256;

absl::Status Parse(const std::string& method, grpc::ByteBuffer& bytes, size_t most,
                   Message& message) {
  if (bytes.Length() > most) {
    return absl::ResourceExhaustedError(
        absl::StrCat(method, ": the message has ", bytes.Length(),
                     " bytes; the policies served here need at most ", most));
  }
  grpc::ProtoBufferReader reader(&bytes);
  if (reader.status().ok() && message.ParseFromZeroCopyStream(&reader) && reader.status().ok())
    return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(method, ": ", bytes.Length(), " bytes are not a ",
                                                 message.GetDescriptor()->full_name(),
                                                 "; it is damaged, or of another schema"));
}

grpc::ByteBuffer Serialize(const Message& message) {
  const std::string bytes = message.SerializeAsString();
  const grpc::Slice slice(bytes);
  return grpc::ByteBuffer(&slice, 1);
}

absl::Status ReplacedError() {
  return Refusal(
      absl::AbortedError("a newer observation of the session came before this one was computed"));
}

}  // namespace

struct GrpcService::Registered {
  GrpcMethod method;
  std::string path;
  const Message* request = nullptr;  // prototypes
  const Message* response = nullptr;
  const google::protobuf::FieldDescriptor* session_id = nullptr;  // of the request; null: has none
};

// One call from its headers to its end. gRPC's reactions and the executor's thread meet under
// `mu_`; a thread that may end the call holds a reference until it has let go of the lock.
class GrpcService::Call final : public grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>,
                                public GrpcCallView,
                                public std::enable_shared_from_this<GrpcService::Call> {
 public:
  Call(GrpcService* service, const Registered* registered, grpc::CallbackServerContext* context)
      : service_(*service), registered_(*registered), context_(context), peer_(context->peer()) {}

  void Begin() {
    self_ = shared_from_this();
    const absl::Status status = Admit();
    const std::shared_ptr<Call> self = self_;
    absl::MutexLock lock(&mu_);
    if (!status.ok()) {
      service_.refused_->Increment();
      End(status);
      return;
    }
    Read();
  }

  // ------------------------------------------------------------------------------------ reactions
  void OnReadDone(bool ok) override {
    const std::shared_ptr<Call> self = self_;
    absl::MutexLock lock(&mu_);
    reading_ = false;
    service_.meter_.End(peer_, registered_.method.largest_request, ok ? incoming_.Length() : 0);
    if (ended_) return;
    if (ok) {
      Take();
    } else {
      closed_ = true;
      if (!streams() && received_ == 0 && end_.ok()) {
        end_ = absl::InvalidArgumentError(
            absl::StrCat(registered_.method.name, ": the call ended before its message"));
      }
    }
    Advance();
  }

  void OnWriteDone(bool ok) override {
    const std::shared_ptr<Call> self = self_;
    absl::MutexLock lock(&mu_);
    busy_ = false;
    if (ended_) return;
    Touch();
    if (!ok || cancelled_) {
      End(absl::CancelledError("the client is gone"));
      return;
    }
    Advance();
  }

  void OnCancel() override {
    const std::shared_ptr<Call> self = self_;
    cancelled_ = true;
    absl::MutexLock lock(&mu_);
    // While a request is answered or written, that ends it.
    if (!busy_) End(absl::CancelledError("the client is gone"));
  }

  void OnDone() override {
    std::set<std::string> served;
    {
      absl::MutexLock lock(&mu_);
      served.swap(served_);
    }
    if (service_.options_.detach) {
      for (const std::string& session : served) service_.options_.detach(session);
    }
    service_.Leave(this, entered_ ? caller_.client() : std::string(), registered_.method);
    self_.reset();  // may end `this`
  }

  // Ends a call on which nothing happens.
  void EndIfIdle(Steady::time_point now) {
    const std::shared_ptr<Call> self = shared_from_this();
    absl::MutexLock lock(&mu_);
    if (ended_ || answering_) return;
    const GrpcServiceOptions& options = service_.options_;
    const absl::Duration limit = streams() ? options.idle_timeout : options.message_timeout;
    if (absl::FromChrono(now - touched_) < limit) return;
    service_.idled_->Increment();
    if (busy_) {  // a response that the client does not take
      context_->TryCancel();
      return;
    }
    End(absl::DeadlineExceededError(absl::StrCat(registered_.method.name, ": nothing came for ",
                                                 absl::FormatDuration(limit),
                                                 "; open the call again when there is something")));
  }

  // Ends a call whose connection brings more than its messages may be long.
  void EndIfOver(const std::set<std::string>& peers) {
    if (peers.count(peer_) == 0) return;
    const std::shared_ptr<Call> self = shared_from_this();
    absl::MutexLock lock(&mu_);
    if (ended_ || !reading_) return;
    service_.refused_->Increment();
    if (busy_) {
      context_->TryCancel();
      return;
    }
    End(absl::ResourceExhaustedError(
        absl::StrCat(registered_.method.name, ": more bytes came than the policies served here ",
                     "need; a message may have at most ", registered_.method.largest_request)));
  }

  // ---------------------------------------------------------------------------------- GrpcCallView
  const Caller& caller() const override { return caller_; }
  std::string peer() const override { return peer_; }
  bool cancelled() const override {
    if (cancelled_) return true;
    absl::MutexLock lock(&mu_);
    return read_ahead_ && HasNewer(answered_session_);
  }
  void AddTrailingMetadata(const std::string& key, const std::string& value) override {
    context_->AddTrailingMetadata(key, value);
  }
  void Serves(const std::string& session_id) override {
    {
      absl::MutexLock lock(&mu_);
      if (served_.size() >= kMaxServed || !served_.insert(session_id).second) return;
    }
    if (service_.options_.attach) service_.options_.attach(session_id);
  }

 private:
  struct Request {
    std::unique_ptr<Message> message;
    std::string session;
  };

  bool streams() const { return registered_.method.streams; }

  // What the caller shows, before anything of his is read.
  absl::Status Admit() {
    const auto& metadata = context_->client_metadata();
    if (const auto found = metadata.find("authorization"); found != metadata.end())
      authorization_.assign(found->second.data(), found->second.size());
    RS_RETURN_IF_ERROR(Authorize());
    RS_RETURN_IF_ERROR(service_.Enter(shared_from_this(), caller_.client(), registered_.method));
    entered_ = true;
    return absl::OkStatus();
  }

  absl::Status Authorize() {
    generation_ = service_.tokens_->generation();
    RS_ASSIGN_OR_RETURN(Caller caller, Allow(*service_.tokens_->Get(), authorization_,
                                             service_.options_.wire, registered_.method.name));
    caller.host = HostOfPeer(peer_);
    if (caller.owner.empty()) caller.owner = PeerCertificateOwner(*context_->auth_context());
    if (entered_ && caller.owner != caller_.owner)
      return absl::PermissionDeniedError("the token has another name now; open the call again");
    if (!entered_) caller_ = std::move(caller);
    return absl::OkStatus();
  }

  void Touch() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { touched_ = Steady::now(); }

  void Read() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    reading_ = true;
    service_.meter_.Begin(peer_, registered_.method.largest_request);
    incoming_.Clear();
    StartRead(&incoming_);
  }

  // The message that came.
  void Take() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    Touch();
    ++received_;
    absl::Status status;
    if (service_.tokens_->generation() != generation_) status = Authorize();
    Request request;
    request.message.reset(registered_.request->New());
    if (status.ok()) {
      status = Parse(registered_.method.name, incoming_, registered_.method.largest_request,
                     *request.message);
    }
    incoming_.Clear();
    if (!status.ok()) {  // what came before it is answered first
      end_ = status;
      closed_ = true;
      return;
    }
    if (registered_.session_id != nullptr) {
      request.session =
          request.message->GetReflection()->GetString(*request.message, registered_.session_id);
    }
    if (received_ == 1 && registered_.method.reads_ahead)
      read_ahead_ = registered_.method.reads_ahead(request.session);
    waiting_.push_back(std::move(request));
    if (!streams()) closed_ = true;
  }

  // Starts what can be started: an answer, a read, the end.
  void Advance() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (!busy_ && !waiting_.empty()) {
      busy_ = answering_ = true;
      registered_.method.executor->Post(caller_.client(), waiting_.front().session,
                                        [self = shared_from_this()] { self->Answer(); });
    }
    if (!busy_ && closed_) {
      End(end_);
      return;
    }
    const size_t most = read_ahead_ ? kReadAhead : 1;
    const bool wanted = read_ahead_ ? waiting_.size() < most : !busy_;
    if (!closed_ && !reading_ && wanted) Read();
  }

  bool HasNewer(const std::string& session) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return std::any_of(waiting_.begin(), waiting_.end(),
                       [&](const Request& r) { return r.session == session; });
  }

  // On the executor's thread: one request.
  void Answer() {
    const std::shared_ptr<Call> self = self_;
    Request request;
    bool read_ahead = false, replaced = false;
    {
      absl::MutexLock lock(&mu_);
      if (cancelled_) {
        answering_ = busy_ = false;
        End(absl::CancelledError("the client is gone"));
        return;
      }
      request = std::move(waiting_.front());
      waiting_.pop_front();
      read_ahead = read_ahead_;
      answered_session_ = request.session;
      replaced = read_ahead && HasNewer(request.session);
      if (!closed_ && !reading_ && read_ahead) Read();
    }
    const std::unique_ptr<Message> response(registered_.response->New());
    absl::Status status = replaced ? ReplacedError() : Handle(*request.message, *response);
    absl::MutexLock lock(&mu_);
    answering_ = false;
    if (absl::IsCancelled(status) && !cancelled_ && read_ahead && HasNewer(request.session))
      status = ReplacedError();
    if (cancelled_) {
      busy_ = false;
      End(absl::CancelledError("the client is gone"));
      return;
    }
    if (!status.ok()) {
      response->Clear();
      if (!registered_.method.as_answer ||
          !registered_.method.as_answer(*request.message, status, read_ahead, *response)) {
        busy_ = false;
        End(status);
        return;
      }
    }
    outgoing_ = Serialize(*response);
    Touch();
    if (streams()) {
      StartWrite(&outgoing_);
    } else {
      ended_ = true;
      StartWriteAndFinish(&outgoing_, grpc::WriteOptions(), grpc::Status::OK);
    }
  }

  // What a handler throws ends its call, and nothing else.
  absl::Status Handle(const Message& request, Message& response) {
    try {
      return registered_.method.answer(*this, request, response);
    } catch (const std::exception& error) {
      return absl::InternalError(absl::StrCat(registered_.method.name, ": ", error.what()));
    }
  }

  void End(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (std::exchange(ended_, true)) return;
    waiting_.clear();
    Finish(ToGrpc(status));
  }

  GrpcService& service_;
  const Registered& registered_;
  grpc::CallbackServerContext* const context_;
  const std::string peer_;
  std::shared_ptr<Call> self_;  // until OnDone
  std::atomic<bool> cancelled_{false};

  // Of Begin, then under mu_ or read only.
  Caller caller_;
  std::string authorization_;  // a secret, never to be logged
  bool entered_ = false;

  mutable absl::Mutex mu_;
  uint64_t generation_ = 0;  // of the tokens that let it in
  bool reading_ ABSL_GUARDED_BY(mu_) = false;
  bool busy_ ABSL_GUARDED_BY(mu_) = false;       // a request is answered or its response written
  bool answering_ ABSL_GUARDED_BY(mu_) = false;  // by a thread, or waits for one
  bool closed_ ABSL_GUARDED_BY(mu_) = false;     // nothing more is read
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  bool read_ahead_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t received_ ABSL_GUARDED_BY(mu_) = 0;
  absl::Status end_ ABSL_GUARDED_BY(mu_);  // of the call, when everything before it is answered
  std::string answered_session_ ABSL_GUARDED_BY(mu_);
  std::deque<Request> waiting_ ABSL_GUARDED_BY(mu_);
  std::set<std::string> served_ ABSL_GUARDED_BY(mu_);
  Steady::time_point touched_ ABSL_GUARDED_BY(mu_) = Steady::now();
  grpc::ByteBuffer incoming_, outgoing_;  // of the read and the write under way
};

GrpcService::GrpcService(const std::string& full_name, std::vector<GrpcMethod> methods,
                         const GrpcServiceOptions& options,
                         std::shared_ptr<const TokenStore> tokens, Metrics* metrics)
    : options_(options),
      tokens_(std::move(tokens)),
      open_calls_(
          metrics->AddGauge("robostress_calls", "gRPC calls open now.", {{"service", full_name}})),
      refused_(
          metrics->AddCounter("robostress_calls_refused_total",
                              "gRPC calls refused before a message was read: rights or limits.",
                              {{"service", full_name}})),
      idled_(metrics->AddCounter("robostress_calls_idle_total",
                                 "gRPC calls ended because nothing came or was taken.",
                                 {{"service", full_name}})) {
  const auto* pool = google::protobuf::DescriptorPool::generated_pool();
  auto* factory = google::protobuf::MessageFactory::generated_factory();
  const google::protobuf::ServiceDescriptor* service = pool->FindServiceByName(full_name);
  RS_CHECK(service != nullptr && service->method_count() == static_cast<int>(methods.size()));
  for (GrpcMethod& method : methods) {
    const google::protobuf::MethodDescriptor* descriptor = service->FindMethodByName(method.name);
    RS_CHECK(descriptor != nullptr && FindRule(options.wire, method.name) != nullptr);
    auto registered = std::make_unique<Registered>();
    registered->path = absl::StrCat("/", full_name, "/", method.name);
    registered->request = factory->GetPrototype(descriptor->input_type());
    registered->response = factory->GetPrototype(descriptor->output_type());
    registered->session_id = descriptor->input_type()->FindFieldByName("session_id");
    registered->method = std::move(method);
    const Registered* raw = registered.get();
    const int index = static_cast<int>(methods_.size());
    // The handler comes with MarkMethodRawCallback.
    AddMethod(new grpc::internal::RpcServiceMethod(
        raw->path.c_str(), grpc::internal::RpcMethod::BIDI_STREAMING, nullptr));
    MarkMethodRawCallback(
        index,
        new grpc::internal::CallbackBidiHandler<grpc::ByteBuffer, grpc::ByteBuffer>(
            [this, raw](grpc::CallbackServerContext* context) { return Begin(raw, context); }));
    methods_.push_back(std::move(registered));
  }
  watcher_ = std::thread([this] { Watch(); });
}

GrpcService::~GrpcService() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  watcher_.join();
}

grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* GrpcService::Begin(
    const Registered* method, grpc::CallbackServerContext* context) {
  const auto call = std::make_shared<Call>(this, method, context);
  call->Begin();
  return call.get();
}

absl::Status GrpcService::Enter(const std::shared_ptr<Call>& call, const std::string& client,
                                const GrpcMethod& method) {
  absl::MutexLock lock(&mu_);
  int& open = clients_[client];
  if (open >= options_.calls_per_client) {
    return absl::ResourceExhaustedError(absl::StrCat(
        open, " calls of this client are open, which is the limit; end some, or start ",
        "the server with more --calls-per-client"));
  }
  if (method.at_once > 0) {
    int& same = methods_of_clients_[{client, method.name}];
    if (same >= method.at_once) {
      return absl::ResourceExhaustedError(
          absl::StrCat(method.name, ": ", same, " of this client are under way, which is the ",
                       "limit; wait for one of them"));
    }
    ++same;
  }
  ++open;
  calls_.emplace(call.get(), call);
  open_calls_->Increment();
  return absl::OkStatus();
}

void GrpcService::Leave(const Call* call, const std::string& client, const GrpcMethod& method) {
  absl::MutexLock lock(&mu_);
  if (calls_.erase(call) == 0) return;
  open_calls_->Decrement();
  const auto found = clients_.find(client);
  if (--found->second == 0) clients_.erase(found);
  if (method.at_once == 0) return;
  const auto same = methods_of_clients_.find({client, method.name});
  if (--same->second == 0) methods_of_clients_.erase(same);
}

int GrpcService::calls() const {
  absl::MutexLock lock(&mu_);
  return static_cast<int>(calls_.size());
}

size_t GrpcService::largest_request() const {
  size_t most = 0;
  for (const auto& registered : methods_) most = std::max(most, registered->method.largest_request);
  return most;
}

void LimitConnections(grpc::ServerBuilder& builder, const GrpcConnectionLimits& limits) {
  const auto milliseconds = [&builder](const char* key, absl::Duration duration) {
    builder.AddChannelArgument(key, static_cast<int>(absl::ToInt64Milliseconds(duration)));
  };
  milliseconds(GRPC_ARG_KEEPALIVE_TIME_MS, limits.ping_after);
  milliseconds(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, limits.ping_timeout);
  milliseconds(GRPC_ARG_MAX_CONNECTION_IDLE_MS, limits.idle);
  milliseconds(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, limits.handshake);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, limits.calls);
  // A compressed message is held to its limit before it is unpacked, and could become anything.
  builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_DEFLATE, false);
  builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_GZIP, false);
}

void GrpcService::Watch() {
  pthread_setname_np(pthread_self(), "calls");
  constexpr absl::Duration kPeriod = absl::Milliseconds(50);  // what is too much is held so long
  const absl::Duration idle_period =
      std::min(std::min(options_.idle_timeout, options_.message_timeout) / 8, absl::Seconds(1));
  Steady::time_point swept = Steady::now();
  while (true) {
    const std::vector<std::string> peers = meter_.Over();
    const std::set<std::string> over(peers.begin(), peers.end());
    const Steady::time_point now = Steady::now();
    const bool sweeps = absl::FromChrono(now - swept) >= idle_period;
    std::vector<std::shared_ptr<Call>> open;
    if (sweeps) swept = now;
    {
      absl::MutexLock lock(&mu_);
      if (sweeps || !over.empty()) {
        for (const auto& [key, weak] : calls_)
          if (auto call = weak.lock()) open.push_back(std::move(call));
      }
    }
    for (const auto& call : open) {
      call->EndIfOver(over);
      if (sweeps) call->EndIfIdle(now);
    }
    open.clear();
    absl::MutexLock lock(&mu_);
    const auto stopped = [this] {
      mu_.AssertHeld();
      return stopped_;
    };
    if (AwaitFor(mu_, stopped, std::min(kPeriod, idle_period))) return;
  }
}

}  // namespace robostress
